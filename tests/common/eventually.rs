//! How tests wait for what must come.

use std::thread::sleep;
use std::time::{Duration, Instant};

/// Longer than anything in these tests takes on a busy machine.
pub const PATIENCE: Duration = Duration::from_mins(3);

/// Waits until something happens. Fails after [`PATIENCE`].
pub fn eventually(what: &str, mut happens: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !happens() {
        assert!(begun.elapsed() < PATIENCE, "{what} did not come");
        sleep(Duration::from_millis(2));
    }
}
