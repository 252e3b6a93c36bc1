//! Where the networks and ONNX Runtime lie on this machine.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::{env, fs};

use super::InferError;

/// Names the folder in place of the search.
const VARIABLE: &str = "FACEWIRE_NETWORKS";
/// Where a package installs it.
const INSTALLED: &str = "/usr/lib/facewire/networks";

/// A folder that holds the converted networks and the ONNX Runtime library.
#[derive(Debug, Clone)]
pub struct NetworkFolder(PathBuf);

impl NetworkFolder {
    /// Takes the folder that the setting names, or, if it is empty, the first that exists of: `$FACEWIRE_NETWORKS`,
    /// the user's cache (where `scripts/setup` puts it), and the place of an installed package.
    ///
    /// # Errors
    /// [`InferError::NoFolder`], naming every folder tried, or [`InferError::Unreadable`] for the first that this user
    /// may not look at, if there is no other.
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

    /// The folder itself.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }

    pub(super) fn network(&self, name: &str) -> PathBuf {
        self.0.join(format!("{name}.onnx"))
    }

    #[cfg(feature = "ort")]
    pub(super) fn onnx_runtime(&self) -> PathBuf {
        self.0.join("libonnxruntime.so")
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
