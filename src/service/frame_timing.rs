//! How long frames wait and take, and how often they come.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use super::counters::Counters;
use super::step::Step;
use super::times::between;
use crate::capture::{FrameRate, Source};
use crate::pipeline::StageTimes;

/// A longer time between two frames does not count as a frame period, microseconds.
const MAX_PERIOD_US: u64 = 500_000;
/// One part in this many of the mean frame period comes from the newest frame.
const PERIOD_SHARE: u64 = 8;

/// Measures the frames of the open camera and adds to the counters.
#[derive(Debug)]
pub(super) struct FrameTiming {
    counters: Arc<Counters>,
    last_captured_us: Option<u64>,
    camera_period: Duration,
    step: Step,
    /// How long the work on the newest frame took, until its decoding is known, too.
    work: Option<Duration>,
}

impl FrameTiming {
    pub(super) fn new(counters: Arc<Counters>) -> Self {
        let camera_period = Duration::from_micros(FrameRate::FPS_30.period_us());
        Self { counters, last_captured_us: None, camera_period, step: Step::default(), work: None }
    }

    /// Begins with another camera, which is to deliver `fps` frames a second unless it states its own rate.
    pub(super) fn camera_opened(&mut self, camera: &dyn Source, fps: u32) {
        let asked = FrameRate::new(fps, 1).unwrap_or(FrameRate::FPS_30);
        let stated_us = camera.frame_period_us();
        self.camera_period = Duration::from_micros(stated_us.unwrap_or(asked.period_us()));
        self.counters.frame_period_us.store(micros(self.step.period(self.camera_period)), Relaxed);
        self.counters.recent.begin(self.camera_period);
        self.last_captured_us = None;
    }

    /// Takes a step. The failsafe is as patient as the new step wants at once.
    pub(super) fn take(&mut self, step: Step) {
        if step != self.step {
            self.step = step;
            self.counters.frame_period_us.store(micros(step.period(self.camera_period)), Relaxed);
        }
    }

    /// The earliest time of capture of the next frame that the step takes. Frames may come half a period early.
    pub(super) fn wanted_us(&self) -> u64 {
        let Some(last_us) = self.last_captured_us.filter(|_| self.step.every() > 1) else { return 0 };
        last_us + micros(self.step.period(self.camera_period).saturating_sub(self.camera_period / 2))
    }

    /// Follows the mean time between processed frames: the failsafe is more patient on a slow board.
    pub(super) fn captured(&mut self, captured_us: u64) {
        let gap_us = self.last_captured_us.and_then(|last_us| captured_us.checked_sub(last_us));
        self.last_captured_us = Some(captured_us);
        let Some(gap_us) = gap_us.filter(|gap_us| *gap_us <= MAX_PERIOD_US) else { return };
        let mean_us = self.counters.frame_period_us.load(Relaxed);
        // A recording does not state its rate.
        let next_us = if mean_us == 0 { gap_us } else { (mean_us * (PERIOD_SHARE - 1) + gap_us) / PERIOD_SHARE };
        self.counters.frame_period_us.store(next_us, Relaxed);
    }

    /// Counts how long a frame waited, how long its stages took, and how long the whole work took.
    pub(super) fn worked(&mut self, captured_us: u64, begun_us: u64, ended_us: u64, stages: &StageTimes) {
        let (times, work) = (&self.counters.times, between(begun_us, ended_us));
        times.wait.record(between(captured_us, begun_us));
        times.record_stages(stages);
        times.work.record(work);
        self.work = Some(work);
    }

    /// Counts how long the frame that was worked on took to decode. Ignores the decoding of other frames.
    pub(super) fn decoded(&mut self, decoding: Duration) {
        let Some(work) = self.work.take() else { return };
        let busy = decoding + work;
        self.counters.times.decode.record(decoding);
        self.counters.recent.record(self.step.full_busy(busy), decoding);
        self.counters.count_missed_deadline(busy, self.step.period(self.camera_period));
    }
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::Clip;

    fn timing() -> FrameTiming {
        let mut timing = FrameTiming::new(Arc::default());
        timing.camera_opened(&Clip::once().unwrap(), 30);
        timing
    }

    #[test]
    fn a_lower_step_wants_every_nth_frame_even_if_it_comes_early() {
        let mut timing = timing();
        timing.captured(1_000_000);
        assert_eq!(timing.wanted_us(), 0, "every frame");
        timing.take(Step::Third);
        let (second_us, third_us) = (1_000_000 + 2 * 33_333, 1_000_000 + 3 * 33_333);
        assert!((second_us + 10_000..third_us - 10_000).contains(&timing.wanted_us()), "{}", timing.wanted_us());
        assert_eq!(timing.counters.frame_period_us.load(Relaxed), 99_999);
    }

    #[test]
    fn a_frame_misses_its_deadline_if_decoding_and_work_take_longer_than_the_step_allows() {
        let mut timing = timing();
        let mut misses = |step, decoding_ms| {
            timing.take(step);
            timing.worked(0, 0, 20_000, &StageTimes::default());
            timing.decoded(Duration::from_millis(decoding_ms));
            timing.decoded(Duration::from_secs(1));
            timing.counters.deadline_misses.load(Relaxed)
        };
        assert_eq!([misses(Step::Full, 13), misses(Step::Full, 14), misses(Step::Half, 46)], [0, 1, 1]);
        assert_eq!(misses(Step::Half, 47), 2);
    }
}
