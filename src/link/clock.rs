//! The time between two outputs, for formats that move by themselves.

use crate::capture::monotonic_us;
use crate::servo::LONGEST_STEP_S;

/// Measures steps of time.
#[derive(Debug, Default)]
pub struct Clock {
    last_us: Option<u64>,
}

impl Clock {
    /// Returns the time since the last call, seconds; 0 for the first one.
    pub fn step_s(&mut self) -> f32 {
        let now_us = monotonic_us();
        let step_us = self.last_us.replace(now_us).map_or(0, |last_us| now_us.saturating_sub(last_us));
        (step_us as f32 * 1e-6).min(LONGEST_STEP_S)
    }
}
