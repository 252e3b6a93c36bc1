//! A file played as a camera would: in real time, stamped by the monotonic clock, newest frame wins.

use std::mem::take;
use std::thread::sleep;
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

use super::{CaptureError, Description, Frame, FrameRate, Source};

/// Frames passed over at once, however late the reader: a process that was stopped for hours goes on from near where
/// it was.
const MAX_PASSED_OVER: u32 = 300;

/// Plays `source` at its own rate.
#[derive(Debug)]
pub struct Paced<S> {
    source: S,
    period_us: u64,
    /// When the next frame is due; set by the first call.
    due_us: Option<u64>,
    skipped: u32,
}

impl<S: Source> Paced<S> {
    /// Starts with the first call of [`Source::next`]; a source without a rate is played at 30 frames a second.
    pub fn new(source: S) -> Self {
        let period_us = source.frame_period_us().unwrap_or(FrameRate::FPS_30.period_us()).max(1);
        Self { source, period_us, due_us: None, skipped: 0 }
    }

    /// Passes over `count` frames, or fewer at the end and when there are very many.
    fn pass_over(&mut self, count: u32) -> Result<(), CaptureError> {
        for _ in 0..count.min(MAX_PASSED_OVER) {
            match self.source.skip() {
                Ok(true) | Err(CaptureError::Frame { .. }) => {}
                Ok(false) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

impl<S: Source> Source for Paced<S> {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let now_us = monotonic_us();
        let due_us = self.due_us.unwrap_or(now_us);
        let skipped = frames_missed(now_us, due_us, self.period_us);
        let captured_us = due_us + u64::from(skipped) * self.period_us;
        self.due_us = Some(captured_us + self.period_us);
        self.skipped = self.skipped.saturating_add(skipped);
        self.pass_over(skipped)?;
        sleep(Duration::from_micros(captured_us.saturating_sub(now_us)));
        let frame = self.source.next()?;
        Ok(frame.map(|frame| Frame { captured_us, ..frame }))
    }

    fn take_skipped(&mut self) -> u32 {
        take(&mut self.skipped)
    }

    fn frame_period_us(&self) -> Option<u64> {
        Some(self.period_us)
    }

    fn describe(&self) -> Description<'_> {
        self.source.describe()
    }
}

/// Frames older than the newest that is due by now.
fn frames_missed(now_us: u64, due_us: u64, period_us: u64) -> u32 {
    let periods = now_us.saturating_sub(due_us) / period_us;
    u32::try_from(periods).unwrap_or(u32::MAX)
}

/// Microseconds of `CLOCK_MONOTONIC`, the clock of the drivers' timestamps.
#[must_use]
pub fn monotonic_us() -> u64 {
    let time = clock_gettime(ClockId::Monotonic);
    let [seconds, nanoseconds] = [time.tv_sec, time.tv_nsec].map(|part| u64::try_from(part).unwrap_or(0));
    seconds * 1_000_000 + nanoseconds / 1000
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::Clip;
    use super::*;

    #[test]
    fn a_late_reader_misses_whole_frames_and_gets_the_newest() {
        assert_eq!(frames_missed(99, 100, 10), 0, "early");
        assert_eq!(frames_missed(109, 100, 10), 0, "still the newest");
        assert_eq!(frames_missed(110, 100, 10), 1);
        assert_eq!(frames_missed(135, 100, 10), 3);
        assert_eq!(frames_missed(u64::MAX, 0, 1), u32::MAX);
    }

    #[test]
    fn frames_carry_the_monotonic_time_at_which_they_were_due() {
        let before_us = monotonic_us();
        let mut camera = Paced::new(Clip::looped().unwrap());
        let first = camera.next().unwrap().unwrap().captured_us;
        let second = camera.next().unwrap().unwrap().captured_us;
        let periods = u64::from(camera.take_skipped()) + 1;
        assert_eq!(second, first + periods * 33_333);
        assert!(before_us <= first && second <= monotonic_us());
    }

    #[test]
    fn skipped_frames_are_counted_and_numbered() {
        let mut camera = Paced::new(Clip::looped().unwrap());
        camera.next().unwrap();
        camera.due_us = Some(monotonic_us() - 5 * 33_333);
        let late = camera.next().unwrap().unwrap().number;
        let skipped = camera.take_skipped();
        assert!(skipped >= 5);
        assert_eq!((late, camera.take_skipped()), (1 + u64::from(skipped), 0));
    }
}
