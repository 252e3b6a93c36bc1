//! The hot loop: frames in, poses out, newest wins.
//!
//! The recovery is the loop: open the camera, work, on any error close it and open it again. Between
//! [`Source::next`] and the hand-over to the sender nothing allocates, locks or logs; events go to the supervisor only
//! while no frame is waiting. New settings are taken between frames.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, mpsc};
use std::thread::{self, Thread};
use std::time::Duration;

use facewire_packet::Reason;
use triple_buffer::Input;

use super::camera::{self, DamagedInARow};
use super::counters::Counters;
use super::heartbeat::Phase;
use super::realtime;
use super::report::{Event, Report};
use super::times::between;
use crate::capture::{CaptureError, Frame, FrameRate, Source, monotonic_us};
use crate::config::CameraSettings;
use crate::face::Tracker;
use crate::pipeline::{Pipeline, Rejected};
use crate::retry::BackOff;
use crate::solve::{Filters, Model};

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

/// The parts of the hot loop that a reload replaces. A field that is `None` keeps its current value.
pub(super) struct HotChange {
    /// The camera is opened again with these settings.
    pub(super) camera: Option<CameraSettings>,
    pub(super) tracker: Option<Tracker>,
    pub(super) model: Option<Model>,
    pub(super) filters: Option<Filters>,
}

pub(super) struct HotLoop {
    camera: CameraSettings,
    pipeline: Pipeline,
    outlets: Outlets,
    changes: mpsc::Receiver<HotChange>,
    counters: Arc<Counters>,
    /// When the camera showed its first picture.
    opened_us: Option<u64>,
    last_captured_us: Option<u64>,
    /// The camera's frame period: work that takes longer makes it skip frames.
    deadline: Duration,
}

impl HotLoop {
    pub(super) fn new(
        camera: CameraSettings,
        pipeline: Pipeline,
        outlets: Outlets,
        changes: mpsc::Receiver<HotChange>,
        counters: Arc<Counters>,
    ) -> Self {
        let (opened_us, last_captured_us, deadline) = (None, None, Duration::MAX);
        Self { camera, pipeline, outlets, changes, counters, opened_us, last_captured_us, deadline }
    }

    pub(super) fn run(mut self) {
        let mut back_off = BackOff::default();
        while !self.counters.stopping() {
            self.enter(Phase::Open);
            self.adopt();
            let trouble = self.session();
            self.report(Report::Fault(Reason::NoCamera));
            let lasted = self.opened_us.take().map_or(Duration::ZERO, |opened_us| between(opened_us, monotonic_us()));
            let Err(event) = trouble else { continue };
            self.tell(event);
            if !self.counters.stopping() {
                self.enter(Phase::Open);
                thread::park_timeout(camera::wait_after(lasted, &mut back_off));
            }
        }
    }

    /// Opens the camera and runs its frames until it fails, or until the service stops or wants another camera.
    fn session(&mut self) -> Result<(), Event> {
        let mut source = camera::open(&self.camera).map_err(Event::Closed)?;
        let outcome = self.show(&mut *source);
        // Closing, too, may take its time in the kernel.
        self.enter(Phase::Open);
        self.counters.camera_open.store(false, Relaxed);
        outcome
    }

    fn show(&mut self, source: &mut dyn Source) -> Result<(), Event> {
        self.await_picture(source).map_err(Event::Closed)?;
        self.opened(source);
        self.stream(source).map_err(Event::Lost)
    }

    /// A camera that sends nothing but damaged frames is none.
    fn await_picture(&self, source: &mut dyn Source) -> Result<(), CaptureError> {
        self.enter(self.wait());
        let outcome = camera::await_picture(source, || {
            self.enter(self.wait());
            add(&self.counters.damaged, 1);
        });
        self.count_skipped(source);
        outcome
    }

    fn opened(&mut self, source: &dyn Source) {
        add(&self.counters.opened, 1);
        self.counters.camera_open.store(true, Relaxed);
        self.opened_us = Some(monotonic_us());
        self.counters.frame_period_us.store(source.frame_period_us().unwrap_or(0), Relaxed);
        self.deadline = self.frame_period(source);
        self.last_captured_us = None;
        self.pipeline.tracker.forget();
        realtime::leave_room_in_heap();
        self.tell(Event::Opened(source.describe().to_string()));
    }

    /// Runs frames until the service stops, the camera fails, or new settings want it opened anew.
    fn stream(&mut self, source: &mut dyn Source) -> Result<(), CaptureError> {
        let mut in_a_row = DamagedInARow::default();
        while !self.counters.stopping() && !self.adopt() {
            self.enter(self.wait());
            let outcome = match source.next() {
                Ok(Some(frame)) => {
                    in_a_row.reset();
                    self.frame(&frame);
                    Ok(())
                }
                Ok(None) => Err(CaptureError::Gone),
                Err(CaptureError::Frame { fault, .. }) => {
                    add(&self.counters.damaged, 1);
                    in_a_row.add(fault)
                }
                Err(error) => Err(error),
            };
            self.count_skipped(source);
            outcome?;
        }
        Ok(())
    }

    fn count_skipped(&self, source: &mut dyn Source) {
        add(&self.counters.skipped, source.take_skipped().into());
    }

    /// What the camera states, or else what it was asked for.
    fn frame_period(&self, source: &dyn Source) -> Duration {
        let asked = FrameRate::new(self.camera.fps, 1).unwrap_or(FrameRate::FPS_30);
        Duration::from_micros(source.frame_period_us().unwrap_or(asked.period_us()))
    }

    fn frame(&mut self, frame: &Frame) {
        let begun_us = self.enter(Phase::Work);
        add(&self.counters.frames, 1);
        let report = match self.pipeline.process(frame) {
            Ok(solution) => {
                add(&self.counters.solved, 1);
                Report::solved(&solution, frame.captured_us)
            }
            Err(Rejected::NoFace) => {
                add(&self.counters.no_face, 1);
                Report::Fault(Reason::NoFace)
            }
            Err(_) => {
                add(&self.counters.rejected, 1);
                Report::Fault(Reason::BadResult)
            }
        };
        self.measure_period(frame.captured_us);
        self.report(report);
        self.measure_work(frame.captured_us, begun_us);
    }

    /// Counts how long the frame waited and was worked on. What it gave is already on its way.
    fn measure_work(&self, captured_us: u64, begun_us: u64) {
        let (counters, work) = (&self.counters, between(begun_us, monotonic_us()));
        counters.times.wait.record(between(captured_us, begun_us));
        counters.times.record_stages(self.pipeline.times());
        counters.worked(work, self.deadline);
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

    /// Takes the changes of all reloads since the last call. Returns whether the camera is to be opened again.
    fn adopt(&mut self) -> bool {
        let mut is_new_camera = false;
        while let Ok(HotChange { camera, tracker, model, filters }) = self.changes.try_recv() {
            is_new_camera |= camera.is_some();
            replace_if_some(&mut self.camera, camera);
            replace_if_some(&mut self.pipeline.tracker, tracker);
            replace_if_some(&mut self.pipeline.solver.model, model);
            replace_if_some(&mut self.pipeline.solver.filters, filters);
        }
        self.pipeline.horizontal_fov_deg = self.camera.horizontal_fov_deg;
        is_new_camera
    }

    /// Begins a phase and returns the time.
    fn enter(&self, phase: Phase) -> u64 {
        let now_us = monotonic_us();
        self.counters.heartbeats.hot(phase, now_us);
        now_us
    }

    fn wait(&self) -> Phase {
        Phase::Wait { stall_timeout_ms: self.camera.stall_timeout_ms }
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

fn replace_if_some<T>(old: &mut T, new: Option<T>) {
    if let Some(new) = new {
        *old = new;
    }
}

/// Only this thread adds to these counters.
fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Relaxed);
}
