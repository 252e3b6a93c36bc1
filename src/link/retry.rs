//! How often what failed is tried again, and how often that is told.

use std::time::Duration;

use super::LinkError;

/// Waits between attempts: the first and the longest.
const FIRST: Duration = Duration::from_millis(100);
const LONGEST: Duration = Duration::from_secs(1);

/// Attempts since the last success.
#[derive(Debug, Default)]
pub struct Retry {
    waited: Option<Duration>,
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
        let wait = self.waited.map_or(FIRST, |waited| (2 * waited).min(LONGEST));
        *self.waited.insert(wait)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_from_100_ms_to_1_s() {
        let mut retry = Retry::default();
        let waits: Vec<u128> = (0..6).map(|_| retry.wait().as_millis()).collect();
        assert_eq!(waits, [100, 200, 400, 800, 1000, 1000]);
    }
}
