//! Libraries of `tests/hooks` that a test preloads into the program.

use std::fs;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::NamedTempFile;

use super::project;

/// Builds the library from its source, unless a test has built it from the same source before, and returns its path.
pub fn hook(name: &str) -> PathBuf {
    let source = project("tests/hooks").join(name).with_extension("c");
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let library = folder.join(format!("{name}-{:016x}.so", fingerprint()));
    if !library.exists() {
        // Tests run in parallel, and none must find an unfinished library.
        let unfinished = NamedTempFile::new_in(folder).unwrap().into_temp_path();
        let mut compiler = Command::new("cc");
        compiler.args(["-O1", "-Wall", "-Wextra", "-shared", "-fPIC", "-o"]).args([&*unfinished, &source]).arg("-ldl");
        assert!(compiler.status().unwrap().success());
        unfinished.persist(&library).unwrap();
    }
    library
}

/// A hash of all files in `tests/hooks`.
fn fingerprint() -> u64 {
    let mut files: Vec<PathBuf> = fs::read_dir(project("tests/hooks")).unwrap().map(|it| it.unwrap().path()).collect();
    files.sort();
    let mut hasher = DefaultHasher::new();
    files.iter().for_each(|file| fs::read(file).unwrap().hash(&mut hasher));
    hasher.finish()
}
