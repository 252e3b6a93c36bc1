//! Plays a file as if it were a camera: in real time, with timestamps of the monotonic clock, and skipping frames for a
//! reader that is late.

use std::mem::take;
use std::thread::sleep;
use std::time::Duration;

use rustix::time::{ClockId, clock_gettime};

use super::{CaptureError, Description, Frame, FrameRate, Source};

/// Largest number of frames that are skipped at once, so that a process that was stopped for hours continues soon.
const MAX_SKIPPED: u32 = 300;

/// Plays a source at its own rate.
#[derive(Debug)]
pub struct Paced<S> {
    source: S,
    period_us: u64,
    /// Time at which the next frame is due. The first call sets it.
    due_us: Option<u64>,
    skipped: u32,
}

impl<S: Source> Paced<S> {
    /// Starts to play with the first call of [`Source::next`]. A source without a rate is played at 30 frames per second.
    pub fn new(source: S) -> Self {
        let period_us = source.frame_period_us().unwrap_or(FrameRate::FPS_30.period_us()).max(1);
        Self { source, period_us, due_us: None, skipped: 0 }
    }

    /// Skips `count` frames, but no more than [`MAX_SKIPPED`] and not beyond the end.
    fn skip_frames(&mut self, count: u32) -> Result<(), CaptureError> {
        for _ in 0..count.min(MAX_SKIPPED) {
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
        self.skip_frames(skipped)?;
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

/// Returns how many frames are due that are older than the newest one.
fn frames_missed(now_us: u64, due_us: u64, period_us: u64) -> u32 {
    let periods = now_us.saturating_sub(due_us) / period_us;
    u32::try_from(periods).unwrap_or(u32::MAX)
}

/// Returns the time of `CLOCK_MONOTONIC` in microseconds. Most drivers take their timestamps from this clock.
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
    fn a_late_reader_gets_the_newest_frame_that_is_due() {
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
