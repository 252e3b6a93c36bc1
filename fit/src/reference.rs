//! Where tests find reference data that the repository does not carry.

use std::path::{Path, PathBuf};

/// The folder named by `FACEWIRE_SHARED`, or `shared` beside the checkout.
pub fn folder() -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    std::env::var_os("FACEWIRE_SHARED").map_or_else(beside, PathBuf::from)
}

/// Says that a test has nothing to judge by.
pub fn say_skipped(what: &str) {
    eprintln!("skipped: no {what} in {} (set FACEWIRE_SHARED)", folder().display());
}
