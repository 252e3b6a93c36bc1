//! What the whole-program tests share.
#![allow(dead_code, reason = "each of them uses a part")]

pub mod coefficients;
pub mod film;
pub mod networks;
pub mod points;
pub mod program;
pub mod service;
pub mod slew;
pub mod stuck;

use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Reference clips and figures that are not part of the project; `None` where they are not at hand.
pub fn shared() -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
    let folder = std::env::var_os("FACEWIRE_SHARED").map_or_else(beside, PathBuf::from);
    folder.join("golden").is_dir().then_some(folder)
}

/// Says that a test did not run. Written past the test harness, which would show it for failed tests only.
pub fn skip(test: &str, why: &str) {
    std::io::stderr().write_all(format!("skipped {test}: {why}\n").as_bytes()).unwrap();
}
