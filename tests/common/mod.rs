//! Helpers that the whole-program tests share.
#![allow(dead_code, unused_imports, reason = "each test uses some of them")]

pub mod answers;
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
mod python;
pub mod service;
mod skip;
pub mod slew;
pub mod stuck;

use std::path::{Path, PathBuf};

pub use eventually::{PATIENCE, eventually};
pub use python::python_with;
pub use skip::skip;

pub fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// The folder of reference clips and figures that are not part of the project, or `None` if it is not at hand.
pub fn shared() -> Option<PathBuf> {
    let folder = std::env::var_os("FACEWIRE_SHARED").map_or_else(|| project("../shared"), PathBuf::from);
    folder.join("golden").is_dir().then_some(folder)
}
