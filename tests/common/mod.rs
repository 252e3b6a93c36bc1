//! Helpers that the whole-program tests share.
#![allow(dead_code, unused_imports, reason = "each test uses some of them")]

pub mod coefficients;
pub mod film;
pub mod networks;
pub mod points;
pub mod program;
pub mod service;
mod skip;
pub mod slew;
pub mod stuck;

use std::path::{Path, PathBuf};
use std::process::Command;

pub use skip::skip;

/// The folder of reference clips and figures that are not part of the project, or `None` if it is not at hand.
pub fn shared() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
    let folder = std::env::var_os("FACEWIRE_SHARED").map_or_else(beside, PathBuf::from);
    folder.join("golden").is_dir().then_some(folder)
}

/// Returns the Python into which `scripts/setup tests` installs packages, or `None` if it cannot import this module.
pub fn python_with(module: &str) -> Option<PathBuf> {
    let cache = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".cache")))?;
    let python = cache.join("facewire/venv-tests/bin/python");
    let imported = Command::new(&python).args(["-c", &format!("import {module}")]).output();
    imported.is_ok_and(|output| output.status.success()).then_some(python)
}
