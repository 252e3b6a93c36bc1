//! Trying again what failed because something is away: a camera, a serial port, a host, a file.

use std::{collections::VecDeque, fmt::Display, time::Duration};

const LONGEST_WAIT: Duration = Duration::from_secs(1);
/// The same where attempts that fail are a burden to the device.
const RARE_WAIT: Duration = Duration::from_secs(5);
const FIRST_WAIT: Duration = Duration::from_millis(100);

/// The growing waits between attempts: 100 ms at first, then twice as long each time, up to [`LONGEST_WAIT`]. Start with
/// a new value after a success that has lasted.
#[derive(Debug, Default)]
pub struct BackOff(Duration);

/// Whether a success of this length has lasted. What works for a moment and fails, again and again, keeps its back-off and what
/// was logged of it, so that it neither keeps the machine busy nor fills the log.
pub fn has_lasted(time: Duration) -> bool {
    time >= LONGEST_WAIT
}

impl BackOff {
    /// As [`BackOff::wait`], after a success of the length `lasted`, which is 0 after a failed attempt.
    pub fn wait_after(&mut self, lasted: Duration) -> Duration {
        if has_lasted(lasted) {
            *self = Self::default();
        }
        self.wait()
    }

    /// As [`BackOff::wait`], but the waits grow up to [`RARE_WAIT`].
    pub fn wait_longer(&mut self) -> Duration {
        self.wait_up_to(RARE_WAIT)
    }

    pub fn wait(&mut self) -> Duration {
        self.wait_up_to(LONGEST_WAIT)
    }

    fn wait_up_to(&mut self, longest: Duration) -> Duration {
        self.0 = (2 * self.0).clamp(FIRST_WAIT, longest);
        self.0
    }
}

/// The reasons that were logged since the last success, so that the log does not repeat itself with every attempt, even
/// if two reasons alternate. Start with a new value after a success.
#[derive(Debug, Default)]
pub struct LoggedReasons(VecDeque<String>);

const MAX_REASONS: usize = 8;

impl LoggedReasons {
    /// Takes the reason of another failure. Returns whether it has not been logged yet.
    pub fn is_new(&mut self, reason: &str) -> bool {
        let is_new = self.0.iter().all(|logged| logged != reason);
        if is_new {
            self.0.truncate(MAX_REASONS - 1);
            self.0.push_front(reason.to_owned());
        }
        is_new
    }
}

/// Attempts at something that logs its own failures. Start with a new value after a success that has lasted.
#[derive(Debug, Default)]
pub struct Retry {
    pub back_off: BackOff,
    pub logged: LoggedReasons,
    /// Whether a success was logged.
    pub has_logged_success: bool,
}

impl Retry {
    /// Starts anew if a success has lasted. Returns whether it did.
    pub fn succeed(&mut self, lasted: Duration) -> bool {
        let has_lasted = has_lasted(lasted);
        if has_lasted {
            *self = Self::default();
        }
        has_lasted
    }

    pub fn warn(&mut self, missing: &impl Display) {
        let reason = missing.to_string();
        if self.logged.is_new(&reason) {
            tracing::warn!("no {reason}; trying again");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attempts_wait_100_ms_at_first_then_twice_as_long_each_time_up_to_a_second_and_briefly_again_after_a_success() {
        let mut back_off = BackOff::default();
        let waits_ms = [(); 7].map(|()| back_off.wait().as_millis());
        assert_eq!(waits_ms, [100, 200, 400, 800, 1000, 1000, 1000]);
        back_off = BackOff::default();
        assert_eq!(back_off.wait(), Duration::from_millis(100));
    }

    #[test]
    fn waits_double_up_to_a_second_and_begin_again_only_after_what_lasted_a_second() {
        let mut back_off = BackOff::default();
        let mut wait_ms = |lasted_ms| back_off.wait_after(Duration::from_millis(lasted_ms)).as_millis();
        assert_eq!([0; 6].map(&mut wait_ms), [100, 200, 400, 800, 1000, 1000]);
        assert_eq!(wait_ms(999), 1000, "a glimpse");
        assert_eq!([1000, 0].map(&mut wait_ms), [100, 200]);
        let rare_ms = [(); 6].map(|()| back_off.wait_longer().as_millis());
        assert_eq!(rare_ms, [400, 800, 1600, 3200, 5000, 5000]);
        assert_eq!(back_off.wait().as_millis(), 1000);
    }

    #[test]
    fn each_reason_is_logged_once_until_an_attempt_succeeds_even_if_reasons_alternate() {
        let mut logged = LoggedReasons::default();
        assert_eq!(["a", "a", "b", "a", "b"].map(|reason| logged.is_new(reason)), [true, false, true, false, false]);
        logged = LoggedReasons::default();
        assert!(logged.is_new("a"));
        assert!((0..100).all(|number| logged.is_new(&number.to_string())));
        assert_eq!(logged.0.len(), 8, "memory is bounded");
    }
}
