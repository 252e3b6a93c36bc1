//! The promise of the fuzz target `c_interface` holds for every file of its corpus.
#![allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::cast_sign_loss)]

#[path = "../../fuzz/src/c_interface.rs"]
mod target;

use std::fs;

#[test]
fn the_c_interface_keeps_its_promise_on_every_file_of_the_corpus_and_on_no_bytes_at_all() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz/corpus/c_interface");
    let mut files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(files.len() >= 3, "{folder} holds {} files", files.len());
    files.sort();
    let mut found = 0;
    for file in files {
        let faces = target::c_interface(&fs::read(&file).unwrap());
        let shows_one = file.file_name().unwrap().to_string_lossy().starts_with("face");
        assert!(faces == 1 || !shows_one, "{}: {faces}", file.display());
        found += faces;
    }
    assert!(found >= 3, "the corpus shows too few faces: {found}");
    target::c_interface(&[]);
}
