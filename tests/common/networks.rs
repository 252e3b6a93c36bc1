//! The installed networks, and folders in which one of them is missing or damaged.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::PathBuf;

use facewire_face::stages::NetworkFolder;
use tempfile::TempDir;

/// # Panics
/// Panics with the program's own error if the networks are not installed.
pub fn installed() -> PathBuf {
    let folder = NetworkFolder::find("").unwrap_or_else(|error| panic!("{error}"));
    folder.path().canonicalize().unwrap()
}

/// Returns a copy of the installed networks in which a file is missing, or has this content.
pub fn with(name: &str, content: Option<&[u8]>) -> TempDir {
    let (folder, installed) = (tempfile::tempdir().unwrap(), installed());
    for file in fs::read_dir(&installed).unwrap() {
        let file = file.unwrap().file_name();
        if file != name {
            symlink(installed.join(&file), folder.path().join(&file)).unwrap();
        }
    }
    if let Some(content) = content {
        fs::write(folder.path().join(name), content).unwrap();
    }
    folder
}
