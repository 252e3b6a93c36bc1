//! Data for tests: a small rig, which the repository contains, and data that it does not.

#[path = "../../../tests/common/skip.rs"]
mod skip;

use std::path::{Path, PathBuf};

pub use skip::skip;

pub const RIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/rig");

/// Returns a file in the folder named by `FACEWIRE_SHARED`, or `shared` beside the checkout. If it is missing, notes that
/// the calling test was skipped.
pub fn shared(file: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let path = std::env::var_os("FACEWIRE_SHARED").map_or_else(beside, PathBuf::from).join(file);
    if !path.exists() {
        skip(&format!("reference data is missing: {}; set FACEWIRE_SHARED", path.display()));
    }
    path.exists().then_some(path)
}
