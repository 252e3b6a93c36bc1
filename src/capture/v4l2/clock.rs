//! Judges the timestamps that a driver gives its frames.
//!
//! Contract: a timestamp that cannot be true is not used. Some drivers and relays mark the times of a clock that stands still, or
//! that began with the stream, as those of the monotonic clock. A frame with a false time would count as too old to be shown.
//!
//! Limits: a clock that is wrong by less than [`LONGEST_WAY_US`] is believed. One that is ahead is not reported, because its times
//! are limited to the present.

use super::stream::BUFFERS;

/// Exposure, compression and the way to the driver take less than this, or than two frame periods of a slow camera. A frame was
/// captured after its buffer was handed to the driver, or so much earlier.
const LONGEST_WAY_US: u64 = 1_000_000;
/// After so many false timestamps in a row, none of this driver is believed any more.
const MOST_FALSE: u32 = 3;

#[derive(Debug)]
pub(super) struct DriverClock {
    longest_way_us: u64,
    /// When each of the buffers was handed to the driver, the next one to come back first.
    handed_us: [u64; BUFFERS as usize],
    last_us: Option<u64>,
    /// Whether it was seen to go on, with believable times.
    has_advanced: bool,
    /// How many false timestamps came in a row.
    false_times: u32,
}

impl DriverClock {
    /// The clock of a camera with this frame period, whose buffers the driver has got by now.
    pub(super) fn new(period_us: u64, now_us: u64) -> Self {
        Self {
            longest_way_us: LONGEST_WAY_US.max(2 * period_us),
            handed_us: [now_us; BUFFERS as usize],
            last_us: None,
            has_advanced: false,
            false_times: 0,
        }
    }

    /// Returns the timestamp of a frame that was taken at `now_us`, or `None` if it cannot be true. Every frame must be judged.
    pub(super) fn judge(&mut self, stated_us: u64, now_us: u64) -> Option<u64> {
        let [handed_us, ..] = self.handed_us;
        self.handed_us.rotate_left(1);
        let [.., newest_us] = &mut self.handed_us;
        *newest_us = now_us;
        let before_us = self.last_us.replace(stated_us);
        let is_repeated = before_us == Some(stated_us);
        if self.is_given_up() {
            return None;
        }
        if is_repeated && self.has_advanced {
            // The clock goes: the driver sends the same frame again, because nothing newer comes.
            return Some(stated_us);
        }
        if is_repeated || stated_us.saturating_add(self.longest_way_us) < handed_us {
            self.false_times += 1;
            return None;
        }
        self.has_advanced |= before_us.is_some();
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

    /// What is believed of each of 200 frames of a clock, each of which is taken `late_us` after its capture.
    fn believed(stated: impl Fn(u64) -> u64, late_us: u64) -> Vec<Option<u64>> {
        let mut clock = DriverClock::new(PERIOD_US, BEGUN_US);
        let times = (1..=200).map(|number| BEGUN_US + number * PERIOD_US);
        times.map(|time_us| clock.judge(stated(time_us), time_us + late_us)).collect()
    }

    #[test]
    fn a_timestamp_is_believed_unless_it_stands_still_or_is_long_before_its_buffer_was_free() {
        for late_us in [0, 20_000, 60_000, 120_000] {
            let is_believed =
                |stated: fn(u64) -> u64| believed(stated, late_us).iter().filter(|time| time.is_some()).count();
            assert_eq!(is_believed(|time_us| time_us), 200);
            assert_eq!(is_believed(|time_us| time_us - 900_000), 200, "a slow camera");
            assert_eq!(is_believed(|time_us| time_us + 5_000_000), 200, "the caller limits it to the present");
            assert!(is_believed(|time_us| time_us / PERIOD_US / 2 * 2 * PERIOD_US) >= 199, "two frames of each time");
            assert_eq!(is_believed(|_| 0), 0, "it shows zero");
            assert_eq!(is_believed(|time_us| time_us - BEGUN_US), 0, "it began with the stream");
            assert_eq!(is_believed(|time_us| time_us - 60_000_000), 0, "it is a minute behind");
            assert_eq!(is_believed(|_| BEGUN_US), 1, "it stands still");
        }
    }

    #[test]
    fn a_clock_that_falls_behind_is_given_up_and_a_frame_that_is_sent_again_ages() {
        let at_half_the_rate = believed(|time_us| BEGUN_US + (time_us - BEGUN_US) / 2, 0);
        let last = at_half_the_rate.iter().rposition(Option::is_some).unwrap();
        assert!((55..80).contains(&last) && at_half_the_rate[..last].iter().all(Option::is_some), "{last}");
        let hangs = believed(|time_us| time_us.min(BEGUN_US + 50 * PERIOD_US), 0);
        assert!(hangs.iter().all(Option::is_some) && hangs[199] == Some(BEGUN_US + 50 * PERIOD_US));
    }

    #[test]
    fn neither_a_reader_that_was_late_nor_a_camera_of_a_frame_in_four_seconds_makes_a_clock_doubtful() {
        let mut clock = DriverClock::new(PERIOD_US, BEGUN_US);
        // Four frames wait half a minute for the reader, and the next ones come at once.
        let buffered = (1..=4).map(|number| (BEGUN_US + number * PERIOD_US, BEGUN_US + 30_000_000));
        let fresh = (1..=40).map(|number| BEGUN_US + 30_000_000 + number * PERIOD_US).map(|time_us| (time_us, time_us));
        assert!(buffered.chain(fresh).all(|(stated_us, now_us)| clock.judge(stated_us, now_us).is_some()));
        let mut slow = DriverClock::new(4_000_000, BEGUN_US);
        let times = (1..=20).map(|number| BEGUN_US + number * 4_000_000);
        assert!(times.into_iter().all(|time_us| slow.judge(time_us - 4_000_000, time_us).is_some()));
    }
}
