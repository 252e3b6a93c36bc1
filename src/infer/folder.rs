//! Finds the folder that holds the networks and the libraries of the engines.

use std::fs::File;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::{env, fs};

use super::InferError;

/// The environment variable that names the folder and replaces the search.
const VARIABLE: &str = "FACEWIRE_NETWORKS";
/// The folder that a package installs.
const INSTALLED: &str = "/usr/lib/facewire/networks";

/// The folder that `scripts/setup` or a package fills.
#[derive(Debug, Clone)]
pub struct NetworkFolder(PathBuf);

impl NetworkFolder {
    /// Returns the folder that `setting` names. If `setting` is empty, returns the folder that `$FACEWIRE_NETWORKS`
    /// names. If that is not set either, returns the first that exists of `facewire/networks` in the user's cache,
    /// which `scripts/setup` fills, and the folder of an installed package.
    ///
    /// # Errors
    /// [`InferError::NoFolder`] with every folder tried; if this user has no right to look at one of them,
    /// [`InferError::Unreadable`] with the first such folder.
    pub fn find(setting: &str) -> Result<Self, InferError> {
        let tried = candidates(setting);
        let mut refused = None;
        for folder in &tried {
            match fs::metadata(folder) {
                Ok(found) if found.is_dir() => return Ok(Self(folder.clone())),
                Err(error) if error.kind() == ErrorKind::PermissionDenied => {
                    refused.get_or_insert(InferError::Unreadable { path: folder.clone(), error });
                }
                _ => {}
            }
        }
        Err(refused.unwrap_or(InferError::NoFolder(tried)))
    }

    /// The path of the folder.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Returns the path of the file `name` in this folder, after a check that the file can be opened.
    ///
    /// # Errors
    /// [`InferError::Missing`] or [`InferError::Unreadable`].
    pub fn file(&self, name: &str) -> Result<PathBuf, InferError> {
        let path = self.0.join(name);
        match File::open(&path) {
            Ok(file) if file.metadata().is_ok_and(|found| found.is_file()) => Ok(path),
            Err(error) if error.kind() == ErrorKind::PermissionDenied => Err(InferError::Unreadable { path, error }),
            _ => Err(InferError::Missing(path)),
        }
    }
}

fn candidates(setting: &str) -> Vec<PathBuf> {
    if !setting.is_empty() {
        return vec![setting.into()];
    }
    if let Some(named) = env::var_os(VARIABLE) {
        return vec![named.into()];
    }
    let cache = env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let home = || env::var_os("HOME").map(|home| Path::new(&home).join(".cache"));
    let user = cache.or_else(home).map(|cache| cache.join("facewire/networks"));
    user.into_iter().chain([INSTALLED.into()]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_named_by_the_setting_is_the_only_one_tried() {
        let error = NetworkFolder::find("/nonexistent/networks").expect_err("no such folder");
        assert!(error.to_string().contains("/nonexistent/networks"));
        assert!(!error.to_string().contains(INSTALLED));
    }
}
