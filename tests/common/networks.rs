//! Folders of networks in which something is wrong.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};

use facewire::infer::NetworkFolder;
use tempfile::TempDir;

/// A copy of the installed networks.
pub struct Networks(TempDir);

impl Networks {
    /// # Panics
    /// With the sentence of the program, when `scripts/setup` has not put them there.
    pub fn copy() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let installed = installed();
        for file in fs::read_dir(&installed).unwrap() {
            let name = file.unwrap().file_name();
            symlink(installed.join(&name), folder.path().join(&name)).unwrap();
        }
        Self(folder)
    }

    /// Without this file.
    pub fn without(self, name: &str) -> Self {
        fs::remove_file(self.0.path().join(name)).unwrap();
        self
    }

    /// With other content in this file.
    pub fn with(self, name: &str, content: &[u8]) -> Self {
        let copy = self.without(name);
        fs::write(copy.0.path().join(name), content).unwrap();
        copy
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }
}

/// The content of an installed file.
pub fn content(name: &str) -> Vec<u8> {
    fs::read(installed().join(name)).unwrap()
}

pub fn installed() -> PathBuf {
    let folder = NetworkFolder::find("").unwrap_or_else(|error| panic!("{error}"));
    folder.path().canonicalize().unwrap()
}
