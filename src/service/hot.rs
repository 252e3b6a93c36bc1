//! The hot loop: frames in, poses out, newest wins.
//!
//! The recovery is the loop: open the camera, work, on any error close it and open it again. Between
//! [`Source::next`] and the hand-over to the sender nothing allocates, locks or logs; events go to the supervisor only
//! while there is no camera.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, mpsc};
use std::thread::{self, Thread};
use std::time::Duration;

use facewire_packet::Reason;
use triple_buffer::Input;

use super::counters::Counters;
use super::report::Report;
use super::{camera, supervisor::Event};
use crate::capture::{CaptureError, Frame, Source};
use crate::config::{CameraSettings, Settings};
use crate::pipeline::{Pipeline, Rejected};

/// Waits between attempts to open a camera: the first, and the longest, milliseconds.
const BACK_OFF_MS: [u64; 2] = [100, 1000];
/// Longer gaps between frames are no frame period, microseconds.
const MAX_PERIOD_US: u64 = 500_000;
/// A new frame period counts for this part of the mean.
const PERIOD_SHARE: u64 = 8;

/// Where the hot loop's results go.
pub(super) struct Outlets {
    pub(super) reports: Input<Report>,
    /// The sender, to be woken for a report.
    pub(super) wake: Thread,
    pub(super) events: mpsc::Sender<Event>,
}

pub(super) struct HotLoop {
    camera: CameraSettings,
    pipeline: Pipeline,
    outlets: Outlets,
    counters: Arc<Counters>,
    last_captured_us: Option<u64>,
}

impl HotLoop {
    pub(super) fn new(settings: &Settings, pipeline: Pipeline, outlets: Outlets, counters: Arc<Counters>) -> Self {
        Self { camera: settings.camera.clone(), pipeline, outlets, counters, last_captured_us: None }
    }

    pub(super) fn run(mut self) {
        let [first_ms, longest_ms] = BACK_OFF_MS;
        let mut wait_ms = first_ms;
        while !self.counters.stopping() {
            match camera::open(&self.camera) {
                Ok(mut source) => {
                    wait_ms = first_ms;
                    self.opened(&*source);
                    if let Err(error) = self.stream(&mut *source) {
                        self.tell(Event::Lost(error));
                    }
                }
                Err(error) => self.tell(Event::Closed(error)),
            }
            if !self.counters.stopping() {
                self.report(Report::Fault(Reason::NoCamera));
                thread::park_timeout(Duration::from_millis(wait_ms));
                wait_ms = (2 * wait_ms).min(longest_ms);
            }
        }
    }

    fn opened(&mut self, source: &dyn Source) {
        add(&self.counters.opened, 1);
        self.counters.frame_period_us.store(source.frame_period_us().unwrap_or(0), Relaxed);
        self.last_captured_us = None;
        self.pipeline.tracker.forget();
        self.tell(Event::Opened(source.describe().to_string()));
    }

    /// Runs frames until the service stops or the camera fails.
    fn stream(&mut self, source: &mut dyn Source) -> Result<(), CaptureError> {
        while !self.counters.stopping() {
            match source.next() {
                Ok(Some(frame)) => self.frame(&frame),
                Ok(None) => return Err(CaptureError::Gone),
                Err(CaptureError::Frame { .. }) => add(&self.counters.damaged, 1),
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn frame(&mut self, frame: &Frame) {
        add(&self.counters.frames, 1);
        add(&self.counters.skipped, u64::from(frame.skipped));
        add(&self.counters.damaged, u64::from(frame.damaged));
        let report = match self.pipeline.process(frame) {
            Ok(solution) => {
                add(&self.counters.solved, 1);
                Report::solved(&solution, frame.captured_us)
            }
            Err(Rejected::NoFace) => Report::Fault(Reason::NoFace),
            Err(_) => {
                add(&self.counters.rejected, 1);
                Report::Fault(Reason::BadResult)
            }
        };
        self.measure_period(frame.captured_us);
        self.report(report);
    }

    /// Follows the time between frames that were worked on: a slow board needs a more patient failsafe.
    fn measure_period(&mut self, captured_us: u64) {
        let gap_us = self.last_captured_us.and_then(|last_us| captured_us.checked_sub(last_us));
        self.last_captured_us = Some(captured_us);
        let Some(gap_us) = gap_us.filter(|gap_us| *gap_us <= MAX_PERIOD_US) else { return };
        let mean_us = self.counters.frame_period_us.load(Relaxed);
        let next_us = (mean_us * (PERIOD_SHARE - 1) + gap_us) / PERIOD_SHARE;
        self.counters.frame_period_us.store(next_us, Relaxed);
    }

    fn report(&mut self, report: Report) {
        self.outlets.reports.write(report);
        self.outlets.wake.unpark();
    }

    /// The supervisor lives as long as this thread; if it did not, nobody would be there to be told.
    fn tell(&self, event: Event) {
        let _ = self.outlets.events.send(event);
    }
}

/// Only this thread adds to these counters.
fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Relaxed);
}
