//! Locates reference data for tests that the repository does not contain.

#[path = "../../tests/common/skip.rs"]
mod skip;

use std::path::{Path, PathBuf};

pub use skip::skip;

/// Returns the folder named by `FACEWIRE_SHARED`, or `shared` beside the checkout.
pub fn folder() -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    std::env::var_os("FACEWIRE_SHARED").map_or_else(beside, PathBuf::from)
}

/// Notes that the calling test was skipped because this part of the reference data is missing.
pub fn say_skipped(what: &str) {
    skip(&format!("no {what} in {} (set FACEWIRE_SHARED)", folder().display()));
}
