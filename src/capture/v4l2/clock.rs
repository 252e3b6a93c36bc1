//! Judges the times that a driver states for its frames.
//!
//! Contract: a time that cannot be true is not used. Some drivers and relays mark the times of a clock that stands still, or that
//! began with the stream, as those of the monotonic clock. A frame with a false time would count as too old to be shown.
//!
//! Limits: a clock that is wrong by less than [`LONGEST_WAY_US`] is believed.

/// A frame that the reader had to wait for was captured after the wait began, or little before: exposure, compression and the way
/// to the driver take less than this.
const LONGEST_WAY_US: u64 = 1_000_000;
/// After so many false times in a row, no time of this driver is believed any more.
const MOST_FALSE: u32 = 3;

#[derive(Debug, Default)]
pub(super) struct DriverClock {
    last_us: Option<u64>,
    /// How many false times came in a row.
    false_times: u32,
}

impl DriverClock {
    /// Returns the time that the driver states, or `None` if it cannot be true. `waited_since_us` is when the reader began to wait
    /// for this frame, if it was not there already.
    pub(super) fn judge(&mut self, stated_us: u64, waited_since_us: Option<u64>) -> Option<u64> {
        let is_too_old = waited_since_us.is_some_and(|since_us| stated_us.saturating_add(LONGEST_WAY_US) < since_us);
        let stands_still = self.last_us.replace(stated_us) == Some(stated_us);
        if self.is_given_up() {
            return None;
        }
        if is_too_old || stands_still {
            self.false_times += 1;
            return None;
        }
        self.false_times = 0;
        Some(stated_us)
    }

    pub(super) fn is_given_up(&self) -> bool {
        self.false_times >= MOST_FALSE
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_US: u64 = 33_333;
    const BEGUN_US: u64 = 90_000_000;

    /// What is believed of each of 200 frames, for which the reader waits one period, if a frame that is captured at a time is
    /// stated to be of another.
    fn believed(stated: fn(u64) -> u64) -> Vec<Option<u64>> {
        let mut clock = DriverClock::default();
        let times = (1..=200).map(|number| BEGUN_US + number * PERIOD_US);
        times.map(|time_us| clock.judge(stated(time_us), Some(time_us - PERIOD_US))).collect()
    }

    #[test]
    fn a_time_is_believed_unless_it_stands_still_or_is_long_before_the_reader_waited_for_its_frame() {
        let is_believed = |stated| believed(stated).iter().filter(|time| time.is_some()).count();
        assert_eq!(is_believed(|time_us| time_us), 200);
        assert_eq!(is_believed(|time_us| time_us - 900_000), 200, "a slow camera");
        assert_eq!(is_believed(|time_us| time_us + 5_000_000), 200, "the caller limits it to the present");
        assert_eq!(is_believed(|time_us| time_us / PERIOD_US / 2 * 2 * PERIOD_US), 100, "two frames of each time");
        for (false_clock, name) in [
            ((|_| 0) as fn(u64) -> u64, "zero"),
            (|time_us| time_us - BEGUN_US, "since the start of the stream"),
            (|time_us| time_us - 60_000_000, "a minute behind"),
        ] {
            assert_eq!(is_believed(false_clock), 0, "{name}");
        }
        assert_eq!(is_believed(|_| BEGUN_US), 1, "it stands still");
    }

    #[test]
    fn a_clock_that_falls_behind_is_given_up_and_a_late_reader_is_not_taken_for_a_false_clock() {
        let at_half_the_rate = believed(|time_us| BEGUN_US + (time_us - BEGUN_US) / 2);
        let last = at_half_the_rate.iter().rposition(Option::is_some).unwrap();
        assert!((55..70).contains(&last) && at_half_the_rate[..last].iter().all(Option::is_some), "{last}");
        let mut clock = DriverClock::default();
        let buffered = (1..=4).map(|number| clock.judge(BEGUN_US + number * PERIOD_US, None));
        assert!(buffered.into_iter().all(|time| time.is_some()), "they have waited for half a minute");
        assert!(!clock.is_given_up());
    }
}
