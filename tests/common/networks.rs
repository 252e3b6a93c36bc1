//! Folders of networks with missing or damaged files.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use facewire_face::stages::NetworkFolder;
use tempfile::TempDir;

/// A copy of the installed networks.
pub struct Networks(TempDir);

impl Networks {
    /// # Panics
    /// Panics with the program's own error if the networks are not installed.
    pub fn copy() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let installed = installed();
        for file in fs::read_dir(&installed).unwrap() {
            let name = file.unwrap().file_name();
            symlink(installed.join(&name), folder.path().join(&name)).unwrap();
        }
        Self(folder)
    }

    /// Removes a file.
    pub fn without(self, name: &str) -> Self {
        fs::remove_file(self.0.path().join(name)).unwrap();
        self
    }

    /// Replaces the content of a file.
    pub fn with(self, name: &str, content: &[u8]) -> Self {
        let copy = self.without(name);
        fs::write(copy.0.path().join(name), content).unwrap();
        copy
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

/// Returns the content of an installed file.
pub fn content(name: &str) -> Vec<u8> {
    fs::read(installed().join(name)).unwrap()
}

pub fn installed() -> PathBuf {
    let folder = NetworkFolder::find("").unwrap_or_else(|error| panic!("{error}"));
    folder.path().canonicalize().unwrap()
}
