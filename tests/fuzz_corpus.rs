//! The promises of the fuzz targets hold for every file of the corpus, including inputs that once broke one.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing, clippy::float_cmp, clippy::type_complexity)]

#[path = "../fuzz/src/lib.rs"]
mod targets;

use std::fs;

const TARGETS: [(&str, fn(&[u8])); 13] = [
    ("packet", targets::packet),
    ("cobs_stream", targets::cobs_stream),
    ("configuration", targets::configuration),
    ("frame_intake", targets::frame_intake),
    ("model_file", targets::model_file),
    ("profile_file", targets::profile_file),
    ("recording", targets::recording),
    ("receiver", targets::receiver),
    ("network_file", targets::network_file),
    ("network", targets::network),
    ("y4m", targets::y4m),
    ("avi", targets::avi),
    ("subscription", targets::subscription),
];

#[test]
fn every_target_keeps_its_promise_on_every_file_of_its_folder_and_on_no_bytes_at_all() {
    for (name, target) in TARGETS {
        let folder = format!("{}/fuzz/corpus/{name}", env!("CARGO_MANIFEST_DIR"));
        let mut files: Vec<_> = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
        assert!(files.len() >= 3, "{folder} holds {} files", files.len());
        files.sort();
        for file in files {
            println!("{}", file.display());
            target(&fs::read(file).unwrap());
        }
        target(&[]);
    }
}
