//! Helpers that the whole-program tests share.
#![allow(dead_code, unused_imports, reason = "each test uses some of them")]

pub mod board;
pub mod camera;
pub mod coefficients;
mod eventually;
pub mod film;
pub mod hooks;
pub mod interface;
pub mod maestro;
pub mod networks;
pub mod points;
pub mod ports;
pub mod program;
pub mod service;
mod skip;
pub mod slew;
pub mod stuck;

use std::path::{Path, PathBuf};
use std::process::Command;

pub use eventually::{PATIENCE, eventually};
pub use skip::skip;

pub fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The folder of reference clips and figures that are not part of the project, or `None` if it is not at hand.
pub fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("FACEWIRE_SHARED").map_or_else(|| project("../shared"), PathBuf::from);
    folder.join("golden").is_dir().then_some(folder)
}

/// Returns the Python of this virtual environment, made by `scripts/setup`, or `None` if it cannot import this module.
pub fn python_with(environment: &str, module: &str) -> Option<PathBuf> {
    let cache = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".cache")))?;
    let python = cache.join("facewire").join(environment).join("bin/python");
    let imported = Command::new(&python).args(["-c", &format!("import {module}")]).output();
    imported.is_ok_and(|output| output.status.success()).then_some(python)
}
