//! Counts what a camera delivers: its true frame rate, and the frames that are lost on the way.
//!
//! The counts come from the driver's sequence numbers and timestamps, so that they do not depend on which frames the
//! reader skips. Both are needed, because drivers err in either:
//! - Some drivers number every frame 0, and uvcvideo has numbered the frames of some cameras 0, 2, 4. The smallest
//!   difference since the camera was opened is therefore taken for one frame.
//! - A gap in the numbers counts only if the timestamps show it, too.
//! - A driver also drops frames while the reader leaves it no buffer, and not every driver numbers these. A frame that
//!   waited long in its buffer says so, and the time after it does not count.

/// Time over which frames are counted together, microseconds.
const WINDOW_US: u64 = 1_500_000;
/// A driver that skips more numbers has begun to count anew.
const MAX_NUMBERS: u64 = 10_000;
/// Age in frame periods from which a frame that waited in its buffer shows that the reader was late.
const LATE_PERIODS: u64 = 2;

/// What a camera delivered within a window of about 1.5 s.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Delivery {
    /// Time that was counted.
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

/// A frame as the driver announces it.
#[derive(Debug, Clone, Copy)]
pub struct Arrival {
    /// The driver's number of the frame, which may overflow.
    pub sequence: u32,
    /// Time of capture on the monotonic clock, in microseconds.
    pub captured_us: u64,
    pub taken_us: u64,
}

/// Counts the frames of an open camera.
#[derive(Debug)]
pub struct DeliveryCounter {
    period_us: u64,
    last: Option<Arrival>,
    /// Smallest difference of the sequence numbers of two frames, without 0.
    step: Option<u64>,
    window: Window,
}

/// The counts of the present window. A pair is two frames that were taken one after the other, between which the driver
/// did not run out of buffers.
#[derive(Debug, Default)]
struct Window {
    /// Time from the first frame of the window to its last.
    time_us: u64,
    pairs: u64,
    /// Sum of the times between the frames of the pairs.
    pairs_us: u64,
    /// Sum of the differences of their sequence numbers.
    numbers: u64,
    /// Frames that are missing by the timestamps.
    gaps: u64,
    damaged: u64,
}

impl DeliveryCounter {
    /// Begins to count the frames of a camera with this frame period.
    pub fn new(period_us: u64) -> Self {
        Self { period_us: period_us.max(1), last: None, step: None, window: Window::default() }
    }

    /// Counts a frame, whether the reader uses it or skips it.
    pub fn arrived(&mut self, arrival: Arrival) {
        let Some(last) = self.last.replace(arrival) else { return };
        let numbers = u64::from(arrival.sequence.wrapping_sub(last.sequence));
        // The driver has begun to count anew.
        if numbers > MAX_NUMBERS {
            return;
        }
        let time_us = arrival.captured_us.saturating_sub(last.captured_us);
        if numbers > 0 {
            self.step = Some(self.step.map_or(numbers, |step| step.min(numbers)));
        }
        let window = &mut self.window;
        window.time_us += time_us;
        if last.taken_us.saturating_sub(last.captured_us) <= LATE_PERIODS * self.period_us {
            window.pairs += 1;
            window.pairs_us += time_us;
            window.numbers += numbers;
            window.gaps += ((time_us + self.period_us / 2) / self.period_us).saturating_sub(1);
        }
    }

    /// Counts that the frame which arrived last is damaged.
    pub fn damaged(&mut self) {
        self.window.damaged += 1;
    }

    /// Returns the counts of a window when it is complete, and begins the next one. Returns `None` if every frame of the
    /// window waited long.
    pub fn take(&mut self) -> Option<Delivery> {
        if self.window.time_us < WINDOW_US {
            return None;
        }
        let Window { pairs, pairs_us, numbers, gaps, damaged, .. } = std::mem::take(&mut self.window);
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

    /// The rate, rounded, and the lost frames.
    fn seen(frames: impl IntoIterator<Item = (u32, u64, u64)>) -> (u64, u64) {
        let delivery = counted(frames);
        ((delivery.sent * 1_000_000 + delivery.time_us / 2) / delivery.time_us.max(1), delivery.lost)
    }

    #[test]
    fn a_window_is_complete_after_a_second_and_a_half() {
        let frames = |count| (0..count).map(|number| (number, u64::from(number), 1));
        assert_eq!(counted(frames(45)), Delivery::default());
        assert_eq!(counted(frames(47)), Delivery { time_us: 46 * PERIOD_US, sent: 46, lost: 0 });
    }

    #[test]
    fn a_camera_at_half_its_rate_loses_nothing() {
        assert_eq!(seen((0..30).map(|number| (number, 2 * u64::from(number), 1))), (15, 0));
    }

    #[test]
    fn every_tenth_frame_that_a_bus_loses_is_counted_and_the_cameras_rate_stays() {
        let arrived = (0..61).filter(|number| number % 10 != 5);
        assert_eq!(seen(arrived.map(|number| (number, u64::from(number), 1))), (30, 6));
    }

    #[test]
    fn numbers_that_overflow_stand_still_or_count_by_two_are_no_loss() {
        let frames = |sequence: fn(u32) -> u32| (0..61).map(move |number| (sequence(number), u64::from(number), 1));
        assert_eq!(seen(frames(|number| number.wrapping_sub(30))), (30, 0));
        assert_eq!(seen(frames(|_| 0)), (30, 0));
        assert_eq!(seen(frames(|number| 2 * number)), (30, 0));
        assert_eq!(seen(frames(|number| number % 30)), (30, 0), "a driver that begins anew");
    }

    /// In one window of a slow camera, every frame may follow a lost one.
    #[test]
    fn the_step_of_the_numbers_is_known_from_earlier_windows() {
        let mut counter = DeliveryCounter::new(PERIOD_US);
        let mut lost = Vec::new();
        for number in (0..46).chain((46..140).step_by(2)) {
            let captured_us = u64::from(number) * PERIOD_US;
            counter.arrived(Arrival { sequence: number, captured_us, taken_us: captured_us });
            lost.extend(counter.take().map(|delivery| delivery.lost));
        }
        assert_eq!(lost, [0, 23, 23]);
    }

    /// uvcvideo numbers a frame twice if the camera does not mark its end.
    #[test]
    fn a_gap_in_the_numbers_that_the_timestamps_do_not_show_is_no_loss() {
        assert_eq!(seen((0..61).map(|number| (number + number / 8, u64::from(number), 1))).1, 0);
    }

    /// After every 8th frame the reader is away for 8 periods. The driver fills its three buffers and drops the rest. Some
    /// drivers number the frames that they drop, and some do not.
    #[test]
    fn frames_that_a_late_reader_made_the_driver_drop_are_not_lost_on_the_way() {
        let arrived = |number: &u32| number % 8 < 4;
        let age = |number: u32| if number.is_multiple_of(8) { 0 } else { u64::from(8 - number % 8) };
        let frames = |sequence: fn(u32) -> u32| {
            (0..64).filter(arrived).map(move |number| (sequence(number), u64::from(number), age(number)))
        };
        assert_eq!(seen(frames(|number| number)), (30, 0));
        assert_eq!(seen(frames(|number| number / 8 * 4 + number % 8)), (30, 0));
        let late = (0..64).map(|number| (number, u64::from(number), 8));
        assert_eq!(counted(late), Delivery::default(), "nothing is known");
    }

    #[test]
    fn damaged_frames_count_as_lost() {
        let mut counter = DeliveryCounter::new(PERIOD_US);
        for number in 0..61 {
            let captured_us = u64::from(number) * PERIOD_US;
            counter.arrived(Arrival { sequence: number, captured_us, taken_us: captured_us });
            if number % 10 == 0 {
                counter.damaged();
            }
        }
        let delivery = counter.take().unwrap();
        assert_eq!((delivery.sent, delivery.lost), (60, 7));
        assert!((delivery.fps() - 30.0).abs() < 0.1 && (delivery.lost_share() - 7.0 / 60.0).abs() < 1e-6);
    }
}
