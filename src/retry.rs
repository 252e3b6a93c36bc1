//! Trying again what failed because something is away: a camera, a serial port, a host, a file.

use std::fmt::Display;
use std::time::Duration;

/// The longest wait between two attempts.
pub const LONGEST_WAIT: Duration = Duration::from_secs(1);
const FIRST_WAIT: Duration = Duration::from_millis(100);

/// The growing waits between attempts. Start with a new value after a success.
#[derive(Debug)]
pub struct BackOff {
    next: Duration,
}

impl Default for BackOff {
    fn default() -> Self {
        Self { next: FIRST_WAIT }
    }
}

impl BackOff {
    /// Returns how long to wait before the next attempt: 100 ms at first, then twice as long each time, up to
    /// [`LONGEST_WAIT`].
    pub fn wait(&mut self) -> Duration {
        let wait = self.next;
        self.next = (2 * wait).min(LONGEST_WAIT);
        wait
    }
}

/// The reason that was logged last, so that the log does not repeat itself with every attempt.
#[derive(Debug, Default)]
pub struct LastReason(Option<String>);

impl LastReason {
    /// Takes the reason of another failure. Returns whether it differs from the last one.
    pub fn is_new(&mut self, reason: &str) -> bool {
        let is_new = self.0.as_deref() != Some(reason);
        if is_new {
            self.0 = Some(reason.to_owned());
        }
        is_new
    }

    /// Forgets the reason after a success.
    pub fn clear(&mut self) {
        self.0 = None;
    }
}

/// Attempts at something that logs its own failures.
#[derive(Debug, Default)]
pub struct Retry {
    back_off: BackOff,
    last_reason: LastReason,
}

impl Retry {
    /// Logs what is missing and why, once for each reason.
    pub fn warn(&mut self, missing: &impl Display) {
        let reason = missing.to_string();
        if self.last_reason.is_new(&reason) {
            tracing::warn!("no {reason}; trying again");
        }
    }

    /// Returns how long to wait before the next attempt.
    pub fn wait(&mut self) -> Duration {
        self.back_off.wait()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_from_100_ms_to_1_s() {
        let mut back_off = BackOff::default();
        let waits: Vec<u128> = (0..6).map(|_| back_off.wait().as_millis()).collect();
        assert_eq!(waits, [100, 200, 400, 800, 1000, 1000]);
    }

    #[test]
    fn a_reason_is_new_once_until_another_comes_or_the_attempt_succeeds() {
        let mut last = LastReason::default();
        assert_eq!(["a", "a", "b", "b", "a"].map(|reason| last.is_new(reason)), [true, false, true, false, true]);
        last.clear();
        assert!(last.is_new("a"));
    }
}
