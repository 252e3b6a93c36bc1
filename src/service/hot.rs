//! The hot loop: frames in, poses out, newest wins.
//!
//! The loop is its own recovery: load what is missing, open the camera, run frames, and on any trouble begin again.
//! From a frame in memory to the hand-over to the sender it allocates nothing, takes no lock and writes no log. It
//! sends events to the supervisor, and takes changed settings, only between frames.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, mpsc};
use std::thread::{self, Thread};
use std::time::Duration;

use facewire_packet::Reason;
use triple_buffer::Input;

use super::ServiceError;
use super::camera::{self, DamagedInARow};
use super::counters::Counters;
use super::engine_health::{EngineHealth, Remedy};
use super::frame_timing::FrameTiming;
use super::heartbeat::Phase;
use super::observer::Observer;
use super::realtime;
use super::report::{Event, Report};
use super::times::between;
use super::watcher::Watcher;
use crate::calibration::Observation;
use crate::capture::{CaptureError, Frame, Source, monotonic_us};
use crate::config::{NetworkSettings, Settings};
use crate::face::Tracker;
use crate::impairment::ImpairmentSet;
use crate::infer::InferError;
use crate::pipeline::{Pipeline, Rejected};
use crate::preflight::{self, SetupError};
use crate::recording::Recorded;
use crate::retry::BackOff;
use crate::solve::{Model, Profile, Solution};

/// Where the results of the hot loop go.
pub(super) struct Outlets {
    /// The newest report, for the sender.
    pub(super) reports: Input<Report>,
    /// The sender's thread, which is woken for each report.
    pub(super) wake: Thread,
    /// Events, for the supervisor.
    pub(super) events: mpsc::Sender<Event>,
    /// What each frame shows, for a calibration.
    pub(super) observer: Observer<Observation>,
    /// What each frame shows and sends, for a recording.
    pub(super) recorder: Observer<Recorded>,
}

/// New settings, and the parts that they replace. A part that is `None` keeps its current value.
pub(super) struct HotChange {
    pub(super) settings: Settings,
    pub(super) tracker: Option<Tracker>,
    pub(super) model: Option<Model>,
    pub(super) profile: Option<Profile>,
}

/// What other threads leave for the hot loop.
pub(super) enum HotNews {
    /// New settings, after a reload.
    Settings(Box<HotChange>),
    /// The profile of another wearer, or a new one.
    Wearer(Box<Profile>),
}

pub(super) struct HotLoop {
    settings: Settings,
    /// `None` while a part of it, such as a model file on a disk that is not mounted yet, is missing.
    pipeline: Option<Pipeline>,
    /// The profile of the wearer, for a pipeline that is loaded later.
    profile: Profile,
    /// Loads the networks again after the engine has failed.
    load_tracker: fn(&NetworkSettings) -> Result<Tracker, InferError>,
    engine: EngineHealth,
    outlets: Outlets,
    changes: mpsc::Receiver<HotNews>,
    counters: Arc<Counters>,
    /// When the open camera delivered its first picture.
    opened_us: Option<u64>,
    timing: FrameTiming,
    watcher: Watcher,
    /// Whether the camera was opened with half the width and height.
    has_small_picture: bool,
    /// The impairments that a rehearsal has set.
    rehearsed: ImpairmentSet,
}

/// Why the loop has to begin again, or to end.
enum Trouble {
    /// Something is away or has failed for now: try again.
    Retry(Event),
    /// Trying again in this process does not help.
    Fatal(ServiceError),
}

impl From<Event> for Trouble {
    fn from(event: Event) -> Self {
        match event {
            // The camera stays busy until the process ends.
            Event::Lost(error @ CaptureError::NotStopped { .. })
            | Event::Closed(error @ CaptureError::NotStopped { .. }) => Self::Fatal(error.into()),
            event => Self::Retry(event),
        }
    }
}

impl HotLoop {
    pub(super) fn new(
        settings: Settings,
        mut pipeline: Option<Pipeline>,
        profile: Profile,
        outlets: Outlets,
        changes: mpsc::Receiver<HotNews>,
        counters: Arc<Counters>,
    ) -> Self {
        if let Some(pipeline) = &mut pipeline {
            pipeline.solver.profile = profile.clone();
        }
        let load_tracker = preflight::load_tracker;
        let (engine, timing) = (EngineHealth::default(), FrameTiming::new(Arc::clone(&counters)));
        let (opened_us, watcher) = (None, Watcher::new(Arc::clone(&counters)));
        let rehearsed = ImpairmentSet::default();
        Self {
            settings,
            pipeline,
            profile,
            load_tracker,
            engine,
            outlets,
            changes,
            counters,
            opened_us,
            timing,
            watcher,
            has_small_picture: false,
            rehearsed,
        }
    }

    /// Runs until the service stops.
    ///
    /// # Errors
    /// The engine or the camera's driver has failed in a way that only another process can recover from.
    pub(super) fn run(mut self) -> Result<(), ServiceError> {
        let mut back_off = BackOff::default();
        while !self.counters.stopping() {
            self.enter(Phase::Open);
            self.adopt();
            let outcome = self.attempt();
            let lasted = self.opened_us.take().map_or(Duration::ZERO, |opened_us| between(opened_us, monotonic_us()));
            match outcome {
                Ok(()) => self.report(Report::Fault(Reason::NoCamera)),
                Err(Trouble::Retry(event)) => {
                    self.report(Report::Fault(event.reason()));
                    self.tell(event);
                    self.pause(camera::wait_after(lasted, &mut back_off));
                }
                Err(Trouble::Fatal(error)) => {
                    self.report(Report::Fault(error.reason()));
                    return Err(error);
                }
            }
        }
        Ok(())
    }

    fn pause(&self, wait: Duration) {
        if !self.counters.stopping() {
            self.enter(Phase::Open);
            thread::park_timeout(wait);
        }
    }

    /// Loads what is missing, opens the camera and runs its frames until it fails, or until the service stops or wants
    /// another camera.
    fn attempt(&mut self) -> Result<(), Trouble> {
        self.load_pipeline()?;
        self.enter(Phase::Open);
        self.has_small_picture = self.counters.small_picture.load(Relaxed);
        let open = if self.has_small_picture { camera::open_small } else { camera::open };
        let mut source = open(&self.settings.camera).map_err(Event::Closed)?;
        let outcome = self.show(&mut *source);
        // Closing the camera may block in the kernel, too.
        self.enter(Phase::Open);
        self.counters.camera_open.store(false, Relaxed);
        self.watcher.camera_closed();
        source.close().map_err(Event::Lost)?;
        outcome
    }

    fn load_pipeline(&mut self) -> Result<(), Trouble> {
        if self.pipeline.is_some() {
            return Ok(());
        }
        let mut pipeline = Pipeline::load(&self.settings).map_err(|error| {
            match error {
                // A file that was missing may be copied at this moment, and so be incomplete.
                SetupError::Model { .. } => Event::NotLoaded(error).into(),
                SetupError::Networks(_) => Trouble::Fatal(error.into()),
            }
        })?;
        pipeline.solver.profile = self.profile.clone();
        self.pipeline = Some(pipeline);
        Ok(())
    }

    fn show(&mut self, source: &mut dyn Source) -> Result<(), Trouble> {
        self.await_picture(source).map_err(Event::Closed)?;
        self.opened(source);
        self.stream(source)
    }

    /// Waits for the first intact frame: a camera that sends only damaged frames does not count as open.
    fn await_picture(&mut self, source: &mut dyn Source) -> Result<(), CaptureError> {
        self.enter(self.wait());
        let outcome = camera::await_picture(source, || {
            self.enter(self.wait());
            add(&self.counters.damaged, 1);
        });
        self.account(source);
        outcome
    }

    fn opened(&mut self, source: &dyn Source) {
        add(&self.counters.opened, 1);
        self.counters.has_smaller_mode.store(source.has_smaller_mode(), Relaxed);
        self.counters.camera_open.store(true, Relaxed);
        self.opened_us = Some(monotonic_us());
        self.timing.camera_opened(source, self.settings.camera.fps);
        self.watcher.camera_opened(source);
        if let Some(pipeline) = &mut self.pipeline {
            pipeline.forget_face();
        }
        realtime::leave_room_in_heap();
        self.tell(Event::Opened(source.describe().to_string()));
    }

    /// Runs frames until the service stops, the camera fails, or new settings or another size of picture want it opened
    /// again.
    fn stream(&mut self, source: &mut dyn Source) -> Result<(), Trouble> {
        let mut in_a_row = DamagedInARow::default();
        while !self.counters.stopping() && !self.adopt() && !self.wants_other_picture() {
            self.enter(self.wait());
            self.take_step(source);
            let outcome = match source.next() {
                Ok(Some(frame)) => {
                    in_a_row.reset();
                    self.frame(&frame)
                }
                Ok(None) => Err(Event::Lost(CaptureError::Gone).into()),
                Err(CaptureError::Frame { fault, .. }) => {
                    add(&self.counters.damaged, 1);
                    in_a_row.add(fault).map_err(|error| Event::Lost(error).into())
                }
                Err(error) => Err(Event::Lost(error).into()),
            };
            self.account(source);
            self.watcher.count(source);
            outcome?;
        }
        Ok(())
    }

    /// Runs on the step that the supervisor has chosen.
    fn take_step(&mut self, source: &mut dyn Source) {
        let step = self.counters.step();
        self.timing.take(step);
        source.leave_out_until(self.timing.wanted_us());
        if let Some(tracker) = self.pipeline.as_mut().and_then(|pipeline| pipeline.tracker.as_mut()) {
            tracker.set_turns(step.has_turns());
        }
    }

    /// Takes in what the source has counted and measured.
    fn account(&mut self, source: &mut dyn Source) {
        let skipped = source.take_skipped();
        add(&self.counters.skipped, skipped.for_newer.into());
        add(&self.counters.left_out, skipped.left_out.into());
        self.timing.decoded(source.take_decoding());
        let before = std::mem::replace(&mut self.rehearsed, source.rehearsed());
        for impairment in self.rehearsed.iter().chain(before.iter()) {
            self.counters.impairments.set(impairment, self.rehearsed.contains(impairment));
        }
    }

    fn frame(&mut self, frame: &Frame) -> Result<(), Trouble> {
        let begun_us = self.enter(Phase::Work);
        let Some(pipeline) = &mut self.pipeline else { return Ok(()) };
        let outcome = pipeline.process(frame);
        let (stages, solver) = (*pipeline.times(), &pipeline.solver);
        if let Ok(solution) = &outcome {
            self.counters.neutral.set(solution.neutral_face, solver.neutral_share(), solver.neutral_forgotten());
        }
        self.timing.captured(frame.captured_us);
        let report = self.count(&outcome, frame.captured_us);
        self.report(report);
        // The result is on its way: measuring delays nobody.
        self.timing.worked(frame.captured_us, begun_us, monotonic_us(), &stages);
        let tracker = self.pipeline.as_ref().and_then(|pipeline| pipeline.tracker.as_ref());
        self.watcher.look(frame, tracker.and_then(Tracker::face).map(|face| face.landmarks));
        if let Some(pipeline) = &self.pipeline {
            let is_dark = self.watcher.is_dark();
            self.outlets.observer.publish(|| pipeline.observe(frame, is_dark));
            self.outlets.recorder.publish(|| pipeline.record(frame, report.pose()));
        }
        if let Err(Rejected::Infer(error)) = outcome {
            return self.engine_failed(error);
        }
        self.engine.ran();
        Ok(())
    }

    fn count(&self, outcome: &Result<Solution, Rejected>, captured_us: u64) -> Report {
        let counters = &self.counters;
        add(&counters.frames, 1);
        let (counter, report) = match outcome {
            Ok(solution) => (&counters.solved, Report::solved(solution, captured_us)),
            Err(error @ Rejected::NoFace) => (&counters.no_face, Report::Fault(error.reason())),
            Err(error) => (&counters.rejected, Report::Fault(error.reason())),
        };
        add(counter, 1);
        report
    }

    /// Counts a failed inference. After too many in a row, loads the networks again, or gives up if that was done already.
    fn engine_failed(&mut self, error: InferError) -> Result<(), Trouble> {
        add(&self.counters.engine_failures, 1);
        match self.engine.failed() {
            Remedy::Wait => Ok(()),
            Remedy::Reload => self.reload_engine(error).map_err(|error| Trouble::Fatal(error.into())),
            Remedy::GiveUp => Err(Trouble::Fatal(SetupError::from(error).into())),
        }
    }

    fn reload_engine(&mut self, error: InferError) -> Result<(), SetupError> {
        self.enter(Phase::Open);
        self.tell(Event::EngineFailed(error));
        // A small board may not have the memory for two sets of networks.
        if let Some(pipeline) = &mut self.pipeline {
            pipeline.tracker = None;
        }
        let tracker = (self.load_tracker)(&self.settings.networks)?;
        if let Some(pipeline) = &mut self.pipeline {
            pipeline.tracker = Some(tracker);
        }
        self.tell(Event::EngineReloaded);
        Ok(())
    }

    /// Takes the changes of all reloads since the last call. Returns whether the camera is to be opened again. What was
    /// learned of the wearer stays.
    fn adopt(&mut self) -> bool {
        let mut is_new_camera = false;
        while let Ok(news) = self.changes.try_recv() {
            match news {
                HotNews::Settings(change) => is_new_camera |= self.adopt_settings(*change),
                HotNews::Wearer(profile) => self.wear(*profile),
            }
        }
        is_new_camera
    }

    /// Takes the change of a reload. Returns whether the camera is to be opened again.
    fn adopt_settings(&mut self, HotChange { settings, tracker, model, profile }: HotChange) -> bool {
        let is_new_camera = settings.camera != self.settings.camera;
        self.settings = settings;
        if let Some(profile) = profile {
            self.wear(profile);
        }
        // A pipeline that is not loaded yet will be loaded by the new settings.
        let Some(pipeline) = &mut self.pipeline else { return is_new_camera };
        pipeline.horizontal_fov_deg = self.settings.camera.horizontal_fov_deg;
        pipeline.tracker = tracker.or(pipeline.tracker.take());
        let is_new_model = model.is_some();
        if let Some(model) = model {
            pipeline.solver.model = model;
        }
        pipeline.solver.neutral_mode = self.settings.wearer.neutral;
        let shaping = preflight::shaping(&self.settings);
        if is_new_model || shaping != pipeline.solver.shaping {
            pipeline.solver.shaping = shaping;
            pipeline.solver.bridge();
        }
        is_new_camera
    }

    fn wear(&mut self, profile: Profile) {
        if let Some(pipeline) = &mut self.pipeline {
            pipeline.solver.wear(profile.clone());
        }
        self.profile = profile;
    }

    /// Whether the supervisor has chosen another size of picture since the camera was opened.
    fn wants_other_picture(&self) -> bool {
        self.counters.small_picture.load(Relaxed) != self.has_small_picture
    }

    /// Begins a phase and returns the time.
    fn enter(&self, phase: Phase) -> u64 {
        let now_us = monotonic_us();
        self.counters.heartbeats.hot(phase, now_us);
        now_us
    }

    fn wait(&self) -> Phase {
        Phase::Wait { stall_timeout_ms: self.settings.camera.stall_timeout_ms }
    }

    fn report(&mut self, report: Report) {
        self.outlets.reports.write(report);
        self.outlets.wake.unpark();
    }

    /// The supervisor outlives this thread; if it did not, nobody would be left to read the event.
    fn tell(&self, event: Event) {
        let _ = self.outlets.events.send(event);
    }
}

/// Adds to a counter that only this thread writes.
fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Relaxed);
}

#[cfg(test)]
#[allow(clippy::panic, clippy::unwrap_used)]
mod tests {
    use std::io;
    use std::sync::atomic::AtomicU32;

    use super::*;
    use crate::capture::DEMO;
    use crate::infer::scripted::Scripted;
    use crate::preflight::load_solver;
    use crate::service::observer;

    /// Inferences that the engine of a test may still run.
    static GOOD_RUNS: AtomicU32 = AtomicU32::new(0);

    /// Outlets whose reports nobody reads, and the receiver of their events.
    fn outlets() -> (Outlets, mpsc::Receiver<Event>) {
        let ((reports, _), (events, told)) = (triple_buffer::triple_buffer(&Report::Nothing), mpsc::channel());
        let (observer, _) = observer::channel(&Observation::nothing(0));
        let (recorder, _) = observer::channel(&Recorded::nothing(0, Reason::None));
        (Outlets { reports, wake: thread::current(), events, observer, recorder }, told)
    }

    /// Loads networks that see no face, and fail when the good runs are used up.
    fn load_failing(_: &NetworkSettings) -> Result<Tracker, InferError> {
        let count_down = |runs: u32| runs.checked_sub(1);
        Tracker::load(&Scripted::new(move |_| {
            GOOD_RUNS.fetch_update(Relaxed, Relaxed, count_down).map(drop).map_err(|_| "the device has hung up")
        }))
    }

    #[test]
    fn the_camera_is_opened_again_with_a_small_picture_when_the_supervisor_has_chosen_it() {
        let mut settings = Settings::default();
        settings.camera.device = "rehearsal: slow-jpeg 600".to_owned();
        let tracker = Tracker::load(&Scripted::new(|_| Ok(()))).unwrap();
        let pipeline = Pipeline::new(tracker, load_solver(&settings).unwrap(), 60.0);
        let ((outlets, told), (_changes, for_hot)) = (outlets(), mpsc::channel());
        let counters = Arc::<Counters>::default();
        let hot = HotLoop::new(settings, Some(pipeline), Profile::default(), outlets, for_hot, Arc::clone(&counters));
        let hot = thread::spawn(|| hot.run());
        for is_small in [false, true, false] {
            counters.small_picture.store(is_small, Relaxed);
            assert!(matches!(told.recv(), Ok(Event::Opened(_))));
            assert_eq!(counters.has_smaller_mode.load(Relaxed), !is_small);
        }
        counters.stop();
        hot.join().unwrap().unwrap();
    }

    #[test]
    fn a_camera_that_cannot_be_stopped_ends_the_service_and_one_that_is_gone_does_not() {
        let not_stopped =
            || CaptureError::NotStopped { path: "/dev/video0".to_owned(), source: io::Error::other("stuck") };
        for event in [Event::Lost(not_stopped()), Event::Closed(not_stopped())] {
            let Trouble::Fatal(error) = Trouble::from(event) else { panic!("the service goes on") };
            assert_eq!(error.reason(), Reason::NoCamera);
        }
        assert!(matches!(Trouble::from(Event::Lost(CaptureError::Gone)), Trouble::Retry(_)));
    }

    #[test]
    fn an_engine_that_fails_for_good_is_told_loaded_again_and_then_ends_the_service() {
        let mut settings = Settings::default();
        settings.camera.device = DEMO.to_owned();
        let tracker = load_failing(&settings.networks).unwrap();
        let pipeline = Pipeline::new(tracker, load_solver(&settings).unwrap(), 60.0);
        let ((outlets, told), (_changes, for_hot)) = (outlets(), mpsc::channel());
        let counters = Arc::<Counters>::default();
        let mut hot =
            HotLoop::new(settings, Some(pipeline), Profile::default(), outlets, for_hot, Arc::clone(&counters));
        hot.load_tracker = load_failing;
        GOOD_RUNS.store(3, Relaxed);
        let error = hot.run().unwrap_err().to_string();
        assert!(
            error.starts_with("network detector failed to run (the device has hung up); free some memory"),
            "{error}"
        );
        let told: Vec<Event> = told.try_iter().collect();
        assert!(
            matches!(&*told, [Event::Opened(_), Event::EngineFailed(_), Event::EngineReloaded]),
            "the log is told once: {told:?}"
        );
        let status = counters.status();
        assert_eq!((status.no_face, status.rejected, status.engine_failures), (3, 16, 16));
    }
}
