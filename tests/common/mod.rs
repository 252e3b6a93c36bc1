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

pub use skip::skip;

/// The folder of reference clips and figures that are not part of the project, or `None` if it is not at hand.
pub fn shared() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
    let folder = std::env::var_os("FACEWIRE_SHARED").map_or_else(beside, PathBuf::from);
    folder.join("golden").is_dir().then_some(folder)
}
