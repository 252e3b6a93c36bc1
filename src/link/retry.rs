//! How often what failed is tried again, and how often that is told.

use std::time::Duration;

use super::LinkError;
use crate::back_off::BackOff;

/// Attempts since the last success.
#[derive(Debug, Default)]
pub struct Retry {
    back_off: BackOff,
    told: Option<String>,
}

impl Retry {
    /// Logs why there is no link; the same reason once.
    pub fn tell(&mut self, error: &LinkError) {
        let reason = error.to_string();
        if self.told.as_ref() != Some(&reason) {
            tracing::warn!("no {reason}; trying again");
        }
        self.told = Some(reason);
    }

    /// How long to wait for the next attempt: twice as long as for the last.
    pub fn wait(&mut self) -> Duration {
        self.back_off.wait()
    }
}
