//! How long frames wait and take, and how often they come.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use super::counters::Counters;
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
    /// The camera's frame period. Work that takes longer makes the hot loop skip frames.
    deadline: Duration,
}

impl FrameTiming {
    pub(super) fn new(counters: Arc<Counters>) -> Self {
        Self { counters, last_captured_us: None, deadline: Duration::MAX }
    }

    /// Begins with another camera, which is to deliver `fps` frames a second unless it states its own rate.
    pub(super) fn camera_opened(&mut self, camera: &dyn Source, fps: u32) {
        let asked = FrameRate::new(fps, 1).unwrap_or(FrameRate::FPS_30);
        let stated_us = camera.frame_period_us();
        self.counters.frame_period_us.store(stated_us.unwrap_or(0), Relaxed);
        self.deadline = Duration::from_micros(stated_us.unwrap_or(asked.period_us()));
        self.last_captured_us = None;
    }

    /// Follows the mean time between processed frames: the failsafe is more patient on a slow board.
    pub(super) fn captured(&mut self, captured_us: u64) {
        let gap_us = self.last_captured_us.and_then(|last_us| captured_us.checked_sub(last_us));
        self.last_captured_us = Some(captured_us);
        let Some(gap_us) = gap_us.filter(|gap_us| *gap_us <= MAX_PERIOD_US) else { return };
        let mean_us = self.counters.frame_period_us.load(Relaxed);
        let next_us = (mean_us * (PERIOD_SHARE - 1) + gap_us) / PERIOD_SHARE;
        self.counters.frame_period_us.store(next_us, Relaxed);
    }

    /// Counts how long a frame waited, how long its stages took, and how long the whole work took.
    pub(super) fn worked(&self, captured_us: u64, begun_us: u64, ended_us: u64, stages: &StageTimes) {
        let times = &self.counters.times;
        times.wait.record(between(captured_us, begun_us));
        times.record_stages(stages);
        self.counters.count_work(between(begun_us, ended_us), self.deadline);
    }
}
