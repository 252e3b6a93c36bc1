//! Counts what a camera delivers: its true frame rate, and the frames that are lost on the way.
//!
//! The counts come from the driver's sequence numbers and timestamps, so that they do not depend on which frames the
//! reader skips. Both are needed, because drivers get either of them wrong:
//! - Some drivers number every frame 0, and uvcvideo has numbered the frames of some cameras 0, 2, 4. The smallest
//!   difference since the camera was opened is therefore taken for one frame.
//! - A gap in the numbers counts only if the timestamps show it, too.
//! - A driver also drops frames while the reader leaves it no buffer, and not every driver numbers these. A frame that
//!   waited long in its buffer shows this, and the time after it does not count.

/// Time over which frames are counted together, microseconds.
const WINDOW_US: u64 = 1_500_000;
/// A driver that skips more numbers has begun to count anew.
const MAX_NUMBERS: u64 = 10_000;
/// A frame that waited in its buffer for more than so many frame periods shows that the reader was late.
const LATE_PERIODS: u64 = 2;

/// What a camera delivered within a window of about 1.5 s.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Delivery {
    pub time_us: u64,
    /// Frames that the camera sent in this time.
    pub sent: u64,
    /// Frames that were lost between the camera and its driver, or arrived damaged.
    pub lost: u64,
}

impl Delivery {
    pub fn fps(&self) -> f32 {
        self.sent as f32 * 1e6 / self.time_us.max(1) as f32
    }

    /// Share of the frames that were lost, from 0 to 1.
    pub fn lost_share(&self) -> f32 {
        (self.lost as f32 / self.sent.max(1) as f32).min(1.0)
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) struct Arrival {
    /// The driver's number of the frame, which may overflow.
    pub(super) sequence: u32,
    /// Time of capture on the monotonic clock.
    pub(super) captured_us: u64,
    pub(super) taken_us: u64,
}

/// Counts the frames of an open camera in windows.
///
/// A pair is two frames that were taken one after the other, between which the driver did not run out of buffers.
#[derive(Default)]
pub(super) struct DeliveryCounter {
    period_us: u64,
    last: Option<Arrival>,
    /// Smallest difference between the sequence numbers of two frames, apart from 0.
    step: Option<u64>,
    time_us: u64,
    pairs: u64,
    /// Sum of the times between the frames of the pairs.
    pairs_us: u64,
    /// Sum of the differences of their sequence numbers.
    numbers: u64,
    /// Frames that are missing by the timestamps.
    gaps: u64,
    /// Frames that arrived damaged.
    pub(super) damaged: u64,
}

impl DeliveryCounter {
    pub(super) fn new(period_us: u64) -> Self {
        Self { period_us: period_us.max(1), ..Self::default() }
    }

    /// Counts a frame, whether the reader uses it or skips it.
    pub(super) fn arrived(&mut self, arrival: Arrival) {
        let Some(last) = self.last.replace(arrival) else { return };
        let numbers = u64::from(arrival.sequence.wrapping_sub(last.sequence));
        if numbers > MAX_NUMBERS {
            return;
        }
        let time_us = arrival.captured_us.saturating_sub(last.captured_us);
        if numbers > 0 {
            self.step = Some(self.step.map_or(numbers, |step| step.min(numbers)));
        }
        self.time_us += time_us;
        if last.taken_us.saturating_sub(last.captured_us) <= LATE_PERIODS * self.period_us {
            self.pairs += 1;
            self.pairs_us += time_us;
            self.numbers += numbers;
            self.gaps += ((time_us + self.period_us / 2) / self.period_us).saturating_sub(1);
        }
    }

    /// Begins anew after a frame whose time is not known.
    pub(super) fn interrupt(&mut self) {
        self.last = None;
    }

    /// Returns the counts of a window when it is complete, and begins the next one. Returns `None` if every frame of the
    /// window waited long.
    pub(super) fn take(&mut self) -> Option<Delivery> {
        if self.time_us < WINDOW_US {
            return None;
        }
        let fresh = Self { last: self.last, step: self.step, ..Self::new(self.period_us) };
        let Self { pairs, pairs_us, numbers, gaps, damaged, .. } = std::mem::replace(self, fresh);
        // Without numbers, no frame is missing.
        let sent = self.step.and_then(|step| numbers.checked_div(step)).map_or(pairs, |frames| frames.max(pairs));
        (pairs > 0).then(|| Delivery { time_us: pairs_us, sent, lost: (sent - pairs).min(gaps) + damaged })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_US: u64 = 33_333;

    /// Counts frames with these numbers and times of capture in periods, of which each was taken `age` periods later.
    fn counted(frames: impl IntoIterator<Item = (u32, u64, u64)>) -> Delivery {
        let mut counter = DeliveryCounter::new(PERIOD_US);
        for (sequence, captured, age) in frames {
            let captured_us = 7_000_000 + captured * PERIOD_US;
            counter.arrived(Arrival { sequence, captured_us, taken_us: captured_us + age * PERIOD_US });
        }
        counter.take().unwrap_or_default()
    }

    #[test]
    fn only_frames_that_a_bus_loses_count_as_lost_whatever_the_driver_makes_of_its_numbers() {
        // For each case: which frames arrive, their sequence numbers, the periods from one to the next, and the frames per
        // second and the lost frames to be counted. A late reader is away for 8 periods after every 8th frame: the driver
        // fills its buffers and drops the rest.
        type Case = (&'static str, fn(u32) -> bool, fn(u32) -> u32, u64, (f32, u64));
        let table: [Case; 9] = [
            ("a camera at half its rate", |_| true, |number| number, 2, (15.0, 0)),
            ("every tenth frame lost", |number| number % 10 != 5, |number| number, 1, (30.0, 6)),
            ("numbers that overflow", |_| true, |number| number.wrapping_sub(30), 1, (30.0, 0)),
            ("numbers that stand still", |_| true, |_| 0, 1, (30.0, 0)),
            ("numbers by two", |_| true, |number| 2 * number, 1, (30.0, 0)),
            ("a driver that begins anew", |_| true, |number| number % 30, 1, (30.0, 0)),
            // uvcvideo numbers a frame twice if the camera does not mark its end.
            ("a gap in the numbers alone", |_| true, |number| number + number / 8, 1, (33.5, 0)),
            ("a late reader of numbered frames", |number| number % 8 < 4, |number| number, 1, (30.0, 0)),
            ("a late reader", |number| number % 8 < 4, |number| number / 8 * 4 + number % 8, 1, (30.0, 0)),
        ];
        for (case, arrives, sequence, periods, expected) in table {
            let is_late = case.starts_with("a late reader");
            let age = |number: u32| if is_late { u64::from((8 - number % 8) % 8) } else { 1 };
            let frames = (0..61).filter(|number| arrives(*number));
            let delivery = counted(frames.map(|number| (sequence(number), periods * u64::from(number), age(number))));
            assert!((delivery.fps() - expected.0).abs() < 0.5, "{case}: {delivery:?}");
            assert_eq!(delivery.lost, expected.1, "{case}");
        }
        let frames = |count, age| (0..count).map(move |number| (number, u64::from(number), age));
        assert_eq!(counted(frames(64, 8)), Delivery::default(), "nothing is known if every frame waited");
        assert_eq!(counted(frames(45, 1)), Delivery::default(), "a window takes a second and a half");
        assert_eq!(counted(frames(47, 1)), Delivery { time_us: 46 * PERIOD_US, sent: 46, lost: 0 });
    }

    /// In one window of a slow camera, every frame may follow a lost one.
    #[test]
    fn the_step_of_the_numbers_is_known_from_earlier_windows_and_damaged_frames_count_as_lost() {
        let mut counter = DeliveryCounter::new(PERIOD_US);
        let mut lost = Vec::new();
        for number in (0..46).chain((46..140).step_by(2)) {
            let captured_us = u64::from(number) * PERIOD_US;
            counter.arrived(Arrival { sequence: number, captured_us, taken_us: captured_us });
            counter.damaged += u64::from(number % 10 == 3);
            lost.extend(counter.take().map(|delivery| delivery.lost));
        }
        assert_eq!(lost, [5, 23, 23]);
    }
}
