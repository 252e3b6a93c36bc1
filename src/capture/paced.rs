//! Plays a file as if it were a camera: in real time, with timestamps of the monotonic clock, and skipping frames for a
//! reader that is late.

use std::mem::take;
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::time::{ClockId, clock_gettime};

use super::{CaptureError, Description, Frame, FrameRate, Skipped, Source};

/// Largest number of frames that are skipped at once, so that a process that was stopped for hours continues soon.
const MAX_SKIPPED: u32 = 300;

/// Plays a source at its own rate.
#[derive(Debug)]
pub struct Paced<S> {
    source: S,
    period_us: u64,
    /// Time at which the next frame is due. The first call sets it.
    due_us: Option<u64>,
    /// Frames that are due earlier are left out.
    wanted_us: u64,
    skipped: Skipped,
    decoding: Duration,
}

impl<S: Source> Paced<S> {
    /// Starts to play with the first call of [`Source::next`]. A source without a rate is played at 30 frames per second.
    pub fn new(source: S) -> Self {
        let period_us = source.frame_period_us().unwrap_or(FrameRate::FPS_30.period_us()).max(1);
        Self { source, period_us, due_us: None, wanted_us: 0, skipped: Skipped::default(), decoding: Duration::ZERO }
    }
}

impl<S: Source> Source for Paced<S> {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let now_us = monotonic_us();
        let due_us = self.due_us.unwrap_or(now_us);
        let skipped = frames_skipped(now_us, due_us, self.wanted_us, self.period_us);
        let count = skipped.for_newer.saturating_add(skipped.left_out);
        let captured_us = due_us + u64::from(count) * self.period_us;
        self.due_us = Some(captured_us + self.period_us);
        self.skipped.for_newer = self.skipped.for_newer.saturating_add(skipped.for_newer);
        self.skipped.left_out = self.skipped.left_out.saturating_add(skipped.left_out);
        for _ in 0..count.min(MAX_SKIPPED) {
            match self.source.skip() {
                Ok(true) | Err(CaptureError::Frame { .. }) => {}
                Ok(false) => break,
                Err(error) => return Err(error),
            }
        }
        sleep(Duration::from_micros(captured_us.saturating_sub(now_us)));
        let begun = Instant::now();
        let frame = self.source.next()?;
        self.decoding += begun.elapsed();
        Ok(frame.map(|frame| Frame { captured_us, ..frame }))
    }

    fn leave_out_until(&mut self, captured_us: u64) {
        self.wanted_us = captured_us;
    }

    fn take_skipped(&mut self) -> Skipped {
        take(&mut self.skipped)
    }

    fn take_decoding(&mut self) -> Duration {
        take(&mut self.decoding)
    }

    fn describe(&self) -> Description<'_> {
        self.source.describe()
    }
}

/// Returns how many frames from `due_us` on are due before `wanted_us`, and how many of the others are older than the
/// newest one.
fn frames_skipped(now_us: u64, due_us: u64, wanted_us: u64, period_us: u64) -> Skipped {
    let count = |periods: u64| u32::try_from(periods).unwrap_or(u32::MAX);
    let left_out = count(wanted_us.saturating_sub(due_us).div_ceil(period_us));
    let older = count(now_us.saturating_sub(due_us) / period_us);
    Skipped { for_newer: older.saturating_sub(left_out), left_out }
}

/// Returns the time of `CLOCK_MONOTONIC` in microseconds. Most drivers take their timestamps from this clock.
pub fn monotonic_us() -> u64 {
    let time = clock_gettime(ClockId::Monotonic);
    let [seconds, nanoseconds] = [time.tv_sec, time.tv_nsec].map(|part| u64::try_from(part).unwrap_or(0));
    seconds * 1_000_000 + nanoseconds / 1000
}

#[cfg(test)]
mod tests {
    use super::super::Clip;
    use super::*;

    #[test]
    fn a_late_reader_gets_the_newest_frame_that_is_due() {
        let skipped = |now_us, wanted_us| {
            let Skipped { for_newer, left_out } = frames_skipped(now_us, 100, wanted_us, 10);
            (for_newer, left_out)
        };
        assert_eq!(skipped(99, 0), (0, 0), "early");
        assert_eq!(skipped(109, 0), (0, 0), "still the newest");
        assert_eq!(skipped(110, 0), (1, 0));
        assert_eq!(skipped(135, 0), (3, 0));
        assert_eq!(skipped(99, 125), (0, 3), "the frame that is due at 130 is the first wanted one");
        assert_eq!(skipped(155, 125), (2, 3), "of the wanted ones the newest");
        assert_eq!(frames_skipped(u64::MAX, 0, 0, 1).for_newer, u32::MAX);
    }

    /// Checks that the next frame of a camera is due at its time by the first one's, and returns what was skipped before it.
    fn skipped_before_the_next(camera: &mut Paced<Clip>, first_us: u64) -> Skipped {
        let (captured_us, number) = camera.next().unwrap().map(|frame| (frame.captured_us, frame.number)).unwrap();
        let skipped = camera.take_skipped();
        let periods = u64::from(skipped.for_newer) + u64::from(skipped.left_out) + 1;
        assert_eq!((captured_us, number), (first_us + periods * 33_333, periods));
        assert!(captured_us <= monotonic_us());
        assert_eq!(camera.take_skipped(), Skipped::default());
        skipped
    }

    #[test]
    fn frames_carry_the_monotonic_time_at_which_they_were_due_and_skipped_ones_are_counted() {
        let play = || {
            let before_us = monotonic_us();
            let mut camera = Paced::new(Clip::looped().unwrap());
            let first_us = camera.next().unwrap().unwrap().captured_us;
            assert!(before_us <= first_us);
            (camera, first_us)
        };
        let (mut camera, first_us) = play();
        assert_eq!(skipped_before_the_next(&mut camera, first_us).left_out, 0);
        let (mut camera, first_us) = play();
        camera.leave_out_until(first_us + 2 * 33_333);
        assert_eq!(skipped_before_the_next(&mut camera, first_us).left_out, 1);
        let (mut camera, _) = play();
        let late_us = monotonic_us() - 5 * 33_333;
        camera.due_us = Some(late_us);
        assert!(skipped_before_the_next(&mut camera, late_us - 33_333).for_newer >= 5);
    }
}
