//! The hot loop: frames in, poses out, newest wins.
//!
//! The loop recovers by itself: it loads what is missing, opens the camera, runs frames, and on any trouble begins again.
//! From a frame in memory to the hand-over to the sender it allocates nothing, takes no lock and writes no log. It
//! sends events to the supervisor, and takes changed settings, only between frames.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, mpsc};
use std::thread::{self, Thread};
use std::time::Duration;

use facewire_packet::{Reason, Visibility};
use triple_buffer::Input;

use super::adaptation::Load;
use super::camera::OpenCamera;
use super::counters::{Counters, OPEN_PATIENCE_US, WORK_PATIENCE_US, frame_patience_us};
use super::failsafe::News;
use super::observer::Observer;
use super::picture::Copier;
use super::realtime::{self, Grant};
use super::timing::{FrameTiming, between};
use super::{Loader, ServiceError};
use crate::calibration::Observation;
use crate::capture::{CaptureError, Frame, FrameFault, Motion, Source};
use crate::clock::monotonic_us;
use crate::config::{NetworkSettings, Settings};
use crate::pipeline::{self, Pipeline, Rejected, SetupError};
use crate::recording::Recorded;
use crate::retry::BackOff;
use crate::watch::{MountTrial, Watch};
use facewire_board::{Impairment, ImpairmentSet};
use facewire_face::{InferError, Model, Profile, Rotation, Tracker};

/// Time for which an impairment must last, or be gone, before that is reported, microseconds.
const HOLD_US: u64 = 3_000_000;
/// A try of another way to mount the camera takes the time of two frames, so that tries are some frames apart.
const FRAMES_PER_TRY: u64 = 8;
/// The same while no face was seen, which may be so for days.
const FRAMES_PER_SEARCH: u64 = 32;
/// The longest work on a frame after which another way is tried without a reason: with a try, it takes half of the time for
/// which a face counts as live.
const QUICK: Duration = Duration::from_millis(25);
/// Time after which a better way to mount the camera is tried again, microseconds.
const CONFIRM_US: u64 = 60_000_000;
/// A single failed inference can be a moment without memory. After this many in a row, the networks are loaded again.
const FAILURES_BEFORE_REMEDY: u32 = 8;
/// After so many good inferences, loading the networks again counts as having helped: 10 s at 30 frames a second.
const GOOD_RUNS_BEFORE_TRUST: u32 = 300;

/// Where the hot loop leaves its results for the other threads.
pub(super) struct Outlets {
    pub(super) newest: Input<News>,
    pub(super) wake: Thread,
    pub(super) loads: Input<Option<Load>>,
    pub(super) events: mpsc::Sender<Event>,
    pub(super) observer: Observer<Observation>,
    pub(super) recorder: Observer<Recorded>,
    pub(super) copier: Copier,
}

/// An event for the log. Threads send events only between frames.
#[derive(Debug)]
pub(super) enum Event {
    Started(Vec<Grant>),
    Opened(String),
    /// The times that the driver of the camera states are not used any more.
    FalseClock,
    /// Another `camera.rotation` would show the face upright.
    Turned(Rotation),
    /// There are no pictures: what is missing, and why.
    Blind(&'static str, String),
    /// The engine has failed several times in a row, and its networks are about to be loaded again.
    EngineFailed(InferError),
    EngineReloaded,
}

/// What a reload or a change of the wearer replaces. A part that is `None` keeps its current value.
#[derive(Default)]
pub(super) struct HotChange {
    pub(super) settings: Option<Settings>,
    pub(super) tracker: Option<Tracker>,
    pub(super) model: Option<Model>,
    pub(super) profile: Option<Profile>,
}

pub(super) struct HotLoop {
    settings: Settings,
    /// `None` while a part of it, such as a model file on a disk that is not mounted yet, is missing.
    pipeline: Option<Pipeline>,
    /// The profile of the wearer, for a pipeline that is loaded later.
    profile: Profile,
    load_tracker: fn(&NetworkSettings) -> Result<Tracker, InferError>,
    loader: Loader,
    engine: EngineHealth,
    outlets: Outlets,
    changes: mpsc::Receiver<HotChange>,
    counters: Arc<Counters>,
    opened_us: Option<u64>,
    /// Whether a camera with a false clock was reported.
    has_false_clock: bool,
    timing: FrameTiming,
    watch: Watch,
    /// Runs while it is tried which way the camera is mounted: from its opening on, and when the watch begins to doubt the face.
    mount: Option<MountTrial>,
    /// When a way that was found to be better is tried again.
    confirm_mount_us: u64,
    /// What the camera's picture did at the last frame.
    motion: Motion,
    /// The impairments that a rehearsal has asked for, so that they are cleared when it no longer does.
    rehearsed: ImpairmentSet,
}

/// Whether another attempt in this process can succeed.
fn is_recoverable(error: &ServiceError) -> bool {
    match error {
        // The camera stays busy until the process ends.
        ServiceError::Camera(error) => !matches!(error, CaptureError::NotStopped { .. }),
        // A file that was missing may be copied at this moment, and so be incomplete.
        ServiceError::Setup(error) => matches!(error, SetupError::Model { .. }),
        _ => false,
    }
}

/// Whether the camera hangs, or its shutter is closed. Opening it again may help, but not at once if it has not helped before.
fn is_of_a_frozen_picture(error: &ServiceError) -> bool {
    matches!(error, ServiceError::Camera(CaptureError::AllDamaged { fault: FrameFault::Repeated, .. }))
}

impl HotLoop {
    pub(super) fn new(
        settings: Settings,
        mut pipeline: Option<Pipeline>,
        profile: Profile,
        outlets: Outlets,
        changes: mpsc::Receiver<HotChange>,
        counters: Arc<Counters>,
        loader: Loader,
    ) -> Self {
        if let Some(pipeline) = &mut pipeline {
            pipeline.solver.profile = profile.clone();
        }
        Self {
            settings,
            pipeline,
            profile,
            load_tracker: pipeline::load_tracker,
            loader,
            engine: EngineHealth::default(),
            outlets,
            changes,
            opened_us: None,
            has_false_clock: false,
            timing: FrameTiming::new(Arc::clone(&counters)),
            watch: Watch::new(HOLD_US),
            mount: None,
            confirm_mount_us: 0,
            counters,
            motion: Motion::Moving,
            rehearsed: ImpairmentSet::default(),
        }
    }

    pub(super) fn run(mut self) -> Result<(), ServiceError> {
        let mut back_off = BackOff::default();
        while !self.counters.stopping() {
            self.enter(OPEN_PATIENCE_US);
            self.adopt();
            let outcome = self.attempt();
            let lasted = self.opened_us.take().map(|opened_us| between(opened_us, monotonic_us()));
            let is_camera = matches!(outcome, Ok(()) | Err(ServiceError::Camera(_)));
            let is_frozen = outcome.as_ref().is_err_and(is_of_a_frozen_picture);
            self.outlets.report(Err(if is_camera { Reason::NoCamera } else { Reason::BadResult }));
            match outcome {
                Ok(()) => continue,
                Err(error) if !is_recoverable(&error) => return Err(error),
                Err(error) if !is_camera => self.tell(Event::Blind("no model", error.to_string())),
                Err(error) if lasted.is_none() => self.tell(Event::Blind("no camera", error.to_string())),
                Err(error) => self.tell(Event::Blind("camera lost", error.to_string())),
            }
            self.enter(OPEN_PATIENCE_US);
            let wait = if is_frozen { back_off.wait_longer() } else { back_off.wait_after(lasted.unwrap_or_default()) };
            if !self.counters.stopping() {
                thread::park_timeout(wait);
            }
        }
        Ok(())
    }

    /// Loads what is missing, and runs frames until something fails, or until the service stops or wants another camera.
    fn attempt(&mut self) -> Result<(), ServiceError> {
        if self.pipeline.is_none() {
            let settings = self.settings.clone();
            let loaded = self.loader.load(move || Pipeline::load(&settings, true))?;
            self.pipeline.insert(loaded?).solver.profile = self.profile.clone();
        }
        self.enter(OPEN_PATIENCE_US);
        let is_small = self.counters.small_picture.load(Relaxed);
        let mut camera = OpenCamera::begin(&self.settings.camera, is_small)?;
        let outcome = self.use_camera(&mut camera, is_small);
        // Closing the camera may block in the kernel, too.
        self.enter(OPEN_PATIENCE_US);
        self.counters.camera_open.store(false, Relaxed);
        self.counters.set_visibility(Visibility::WHOLE);
        // A closed camera impairs nothing.
        self.watch = Watch::new(HOLD_US);
        self.counters.impairments.set_all(Watch::FINDS, self.watch.present());
        self.counters.impairments.set(Impairment::FrozenPicture, false);
        self.counters.impairments.set(Impairment::TurnedAway, false);
        self.motion = Motion::Moving;
        camera.source.close()?;
        outcome
    }

    /// Waits for a first picture, then runs frames.
    fn use_camera(&mut self, camera: &mut OpenCamera, is_small: bool) -> Result<(), ServiceError> {
        self.enter_wait();
        let outcome = camera.await_picture(|| {
            self.enter_wait();
            add(&self.counters.damaged, 1);
        });
        let source = &mut *camera.source;
        self.take_tally(source);
        outcome?;
        add(&self.counters.opened, 1);
        self.counters.has_smaller_mode.store(source.has_smaller_mode(), Relaxed);
        self.counters.camera_open.store(true, Relaxed);
        self.opened_us = Some(monotonic_us());
        self.timing.camera_opened(source, self.settings.camera.fps);
        self.outlets.loads.write(None);
        self.mount = Some(MountTrial::default());
        self.counters.withdraw_rotation(self.settings.camera.rotation);
        if let Some(pipeline) = &mut self.pipeline {
            pipeline.forget_face();
        }
        realtime::leave_room_in_heap();
        self.tell(Event::Opened(source.describe().to_string()));
        self.stream(camera, is_small)
    }

    fn stream(&mut self, camera: &mut OpenCamera, is_small: bool) -> Result<(), ServiceError> {
        while !self.counters.stopping() && !self.adopt() && self.counters.small_picture.load(Relaxed) == is_small {
            self.enter_wait();
            let step = self.counters.step();
            self.timing.set_step(step);
            camera.source.leave_out_until(self.timing.wanted_us());
            if let Some(pipeline) = &mut self.pipeline {
                pipeline.set_turns(step.has_turns());
                pipeline.set_wearer(&self.settings.wearer);
            }
            let was_doubtful = self.watch.is_doubtful();
            let outcome = match camera.next() {
                Ok(Some(frame)) => self.frame(&frame),
                Ok(None) => {
                    add(&self.counters.damaged, 1);
                    camera.check().map_err(ServiceError::from)
                }
                Err(error) => Err(error.into()),
            };
            self.take_tally(&mut *camera.source);
            self.watch.deliveries(&mut *camera.source);
            self.counters.impairments.set_all(Watch::FINDS, self.watch.present());
            self.judge_mount(was_doubtful);
            outcome?;
        }
        Ok(())
    }

    fn take_tally(&mut self, source: &mut dyn Source) {
        let tally = source.take_tally();
        add(&self.counters.skipped, tally.for_newer.into());
        add(&self.counters.left_out, tally.left_out.into());
        add(&self.counters.mistimed, tally.mistimed.into());
        if tally.has_false_clock && !std::mem::replace(&mut self.has_false_clock, true) {
            self.tell(Event::FalseClock);
        }
        self.counters.impairments.set(Impairment::FrozenPicture, tally.motion != Motion::Moving);
        self.motion = tally.motion;
        self.timing.decoded(tally.decoding);
        self.outlets.loads.write(self.timing.load());
        let before = std::mem::replace(&mut self.rehearsed, tally.rehearsed);
        self.counters.impairments.set_all(tally.rehearsed.iter().chain(before.iter()), tally.rehearsed);
    }

    fn frame(&mut self, frame: &Frame) -> Result<(), ServiceError> {
        let begun_us = self.enter(WORK_PATIENCE_US);
        let Self { pipeline: Some(pipeline), counters, outlets, timing, watch, motion, .. } = self else {
            return Ok(());
        };
        let processed = pipeline.process(frame);
        timing.captured(frame.captured_us);
        add(&counters.frames, 1);
        let solved = processed.solved.as_ref();
        counters.set_visibility(solved.map_or(Visibility::WHOLE, |solution| solution.visibility));
        counters.impairments.set(Impairment::TurnedAway, matches!(solved, Err(Rejected::TurnedAway)));
        let counter = match solved {
            Ok(solution) => {
                let solver = processed.solver;
                counters.set_neutral(solution.neutral_face, solver.neutral_share(), solver.neutral_forgotten());
                &counters.solved
            }
            Err(Rejected::NoFace) => &counters.no_face,
            Err(_) => &counters.rejected,
        };
        add(counter, 1);
        // A camera that hangs shows where the face was.
        let pose = if *motion == Motion::Hung { Err(Reason::NoCamera) } else { processed.pose() };
        outlets.report(pose.map(|pose| (pose, frame.captured_us)));
        // The result is on its way to the receivers, so measuring does not delay it.
        timing.worked(frame.captured_us, begun_us, monotonic_us(), &processed.times);
        watch.frame(frame, processed.face, counters.has_proposed_rotation());
        counters.set_face_score(processed.face.and_then(|face| face.appearance).map_or(0.0, |seen| seen.score));
        outlets.observer.publish(|| processed.observe(watch.present().is_dark()));
        outlets.recorder.publish(|| processed.record());
        outlets.copier.copy(frame, processed.face.map(|face| face.landmarks));
        let Err(Rejected::Infer(error)) = processed.solved else {
            self.engine.ran();
            // A slow board would lose too many frames, unless there is a reason.
            if between(begun_us, monotonic_us()) < QUICK || self.watch.is_doubtful() {
                self.try_mount(frame);
            }
            return Ok(());
        };
        add(&counters.engine_failures, 1);
        match self.engine.failed() {
            Remedy::Wait => Ok(()),
            Remedy::Reload => self.reload_engine(error),
            Remedy::GiveUp => Err(SetupError::from(error).into()),
        }
    }

    /// Tries another turn of the picture from time to time while it is tried which way the camera is mounted. A failure of the
    /// networks will show in the next frame.
    fn try_mount(&mut self, frame: &Frame) {
        let frames = self.counters.frames.load(Relaxed);
        let Self { pipeline: Some(Pipeline { tracker: Some(tracker), .. }), mount: Some(mount), .. } = self else {
            return;
        };
        let frames_per_try = if mount.has_seen_a_face() { FRAMES_PER_TRY } else { FRAMES_PER_SEARCH };
        if let Some(picture) = frame.picture().filter(|_| frames.is_multiple_of(frames_per_try)) {
            let _ = mount.add(tracker, picture);
        }
    }

    /// Reports a better way to mount the camera once one was found. Begins to try when the face becomes doubtful.
    fn judge_mount(&mut self, was_doubtful: bool) {
        let is_turned = self.counters.has_proposed_rotation();
        let has_become_doubtful = self.watch.is_doubtful() && !was_doubtful && !is_turned;
        // The wearer may have been lying, or somebody may have turned the camera since.
        let is_to_be_confirmed = is_turned && monotonic_us() >= self.confirm_mount_us;
        if self.mount.is_none() && (has_become_doubtful || is_to_be_confirmed) {
            self.mount = Some(MountTrial::default());
        }
        let Some(mount) = self.mount.take_if(|mount| mount.is_complete()) else { return };
        self.confirm_mount_us = monotonic_us() + CONFIRM_US;
        let better = mount.best().filter(|best| *best != self.settings.camera.rotation);
        self.counters.propose_rotation(better);
        if let Some(rotation) = better {
            self.tell(Event::Turned(rotation));
        }
    }

    fn reload_engine(&mut self, error: InferError) -> Result<(), ServiceError> {
        self.enter(OPEN_PATIENCE_US);
        self.tell(Event::EngineFailed(error));
        // A small board may not have the memory for two sets of networks.
        if let Some(pipeline) = &mut self.pipeline {
            pipeline.tracker = None;
        }
        let load_tracker = self.load_tracker;
        let settings = self.settings.networks.clone();
        let loaded = self.loader.load(move || load_tracker(&settings))?;
        let tracker = loaded.map_err(SetupError::from)?;
        if let Some(pipeline) = &mut self.pipeline {
            pipeline.tracker = Some(tracker);
        }
        self.tell(Event::EngineReloaded);
        Ok(())
    }

    /// Takes all changes since the last call. Returns whether the camera is to be opened again. A file that was read again
    /// and has not changed replaces nothing.
    fn adopt(&mut self) -> bool {
        let mut is_new_camera = false;
        while let Ok(HotChange { settings, tracker, model, profile }) = self.changes.try_recv() {
            if let Some(profile) = profile.filter(|profile| *profile != self.profile) {
                if let Some(pipeline) = &mut self.pipeline {
                    pipeline.solver.set_profile(profile.clone());
                }
                self.profile = profile;
            }
            let Some(settings) = settings else { continue };
            is_new_camera |= settings.camera != self.settings.camera;
            self.settings = settings;
            // A pipeline that is not loaded yet will be loaded by the new settings.
            let Some(pipeline) = &mut self.pipeline else { continue };
            pipeline.horizontal_fov_deg = self.settings.camera.horizontal_fov_deg;
            pipeline.tracker = tracker.or(pipeline.tracker.take());
            let solver = &mut pipeline.solver;
            solver.neutral_mode = self.settings.wearer.neutral;
            let eye_distance_mm = self.settings.wearer.eye_distance_mm;
            let shaping = pipeline::shaping(&self.settings);
            if let Some(model) = model.filter(|model| model != solver.model()) {
                solver.set_model(model);
            }
            if shaping != solver.shaping || eye_distance_mm != solver.eye_distance_mm {
                solver.shaping = shaping;
                solver.eye_distance_mm = eye_distance_mm;
                solver.crossfade();
            }
        }
        is_new_camera
    }

    /// Gives a heartbeat, and counts as stuck unless the next follows within `patience_us`. Returns the present time.
    fn enter(&self, patience_us: u64) -> u64 {
        let now_us = monotonic_us();
        self.counters.heartbeats.beat_hot(now_us, patience_us);
        now_us
    }

    fn enter_wait(&self) {
        self.enter(frame_patience_us(self.settings.camera.stall_timeout_ms));
    }

    /// The supervisor outlives this thread; if it did not, nobody would be left to read the event.
    fn tell(&self, event: Event) {
        let _ = self.outlets.events.send(event);
    }
}

impl Outlets {
    fn report(&mut self, news: News) {
        self.newest.write(news);
        self.wake.unpark();
    }
}

#[derive(Debug, Default)]
struct EngineHealth {
    /// Failures since the last good inference.
    failures: u32,
    /// Good inferences since the networks were loaded again, unless they were [`GOOD_RUNS_BEFORE_TRUST`].
    good_runs: Option<u32>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Remedy {
    Wait,
    Reload,
    GiveUp,
}

impl EngineHealth {
    fn ran(&mut self) {
        self.failures = 0;
        self.good_runs = self.good_runs.map(|count| count + 1).filter(|count| *count < GOOD_RUNS_BEFORE_TRUST);
    }

    fn failed(&mut self) -> Remedy {
        self.failures += 1;
        if self.failures < FAILURES_BEFORE_REMEDY {
            return Remedy::Wait;
        }
        if self.good_runs.is_some() {
            return Remedy::GiveUp;
        }
        *self = Self { failures: 0, good_runs: Some(0) };
        Remedy::Reload
    }
}

fn add(counter: &AtomicU64, count: u64) {
    counter.fetch_add(count, Relaxed);
}

#[cfg(test)]
mod tests {
    use std::{io, sync::atomic::AtomicU32};

    use super::*;
    use crate::capture::{Clip, DEMO};
    use crate::pipeline::{load_model, load_solver, load_tracker};
    use crate::service::{observer, picture};
    use facewire_face::Method;
    use facewire_face::testing::Scripted;

    /// A frame of the built-in clip in which the face has an expression.
    const EXPRESSION: u64 = 60;

    /// A hot loop without links, the receiver of its events, and its counters.
    fn hot(settings: Settings, tracker: Tracker) -> (HotLoop, mpsc::Receiver<Event>, Arc<Counters>) {
        let (newest, _) = triple_buffer::triple_buffer(&Err(Reason::NoCamera));
        let (events, told) = mpsc::channel();
        let observer = observer::channel().0;
        let recorder = observer::channel().0;
        let loads = triple_buffer::triple_buffer(&None).0;
        let copier = picture::channel().1;
        let outlets = Outlets { newest, wake: thread::current(), loads, events, observer, recorder, copier };
        let solver = load_solver(&settings).unwrap();
        let pipeline = Some(Pipeline { tracker: Some(tracker), solver, horizontal_fov_deg: 60.0 });
        let counters = Arc::<Counters>::default();
        let loader = Loader::start("fw-load").unwrap();
        let profile = Profile::default();
        let changes = mpsc::channel().1;
        let hot = HotLoop::new(settings, pipeline, profile, outlets, changes, Arc::clone(&counters), loader);
        (hot, told, counters)
    }

    fn camera(device: &str) -> Settings {
        let mut settings = Settings::default();
        device.clone_into(&mut settings.camera.device);
        settings
    }

    #[test]
    fn the_camera_is_opened_again_with_a_small_picture_when_the_supervisor_has_chosen_it() {
        let tracker = Tracker::load(&Scripted::new(|_| Ok(()))).unwrap();
        let (hot, told, counters) = hot(camera("rehearsal: slow-jpeg 600"), tracker);
        let hot = thread::spawn(|| hot.run());
        for is_small in [false, true, false] {
            counters.small_picture.store(is_small, Relaxed);
            assert!(matches!(told.recv(), Ok(Event::Opened(_))));
            assert_eq!(counters.has_smaller_mode.load(Relaxed), !is_small);
        }
        counters.stop();
        hot.join().unwrap().unwrap();
    }

    /// The method changes as by a reload, while the wearer holds an expression of the built-in clip.
    #[test]
    fn another_method_leads_the_face_over_without_a_step() {
        let mut paper = Settings::default();
        paper.solver.method = Method::Paper;
        let tracker = load_tracker(&paper.networks).unwrap();
        let (mut hot, _told, _counters) = hot(Settings::default(), tracker);
        let (changes, taken) = mpsc::channel();
        hot.changes = taken;
        let mut clip = Clip::once().unwrap();
        assert!((0..EXPRESSION).all(|_| clip.skip().unwrap()));
        let held = clip.next().unwrap().unwrap();
        let mut face = |number: u64| {
            if number == 45 {
                let model = load_model(&paper.solver).ok();
                let change = HotChange { settings: Some(paper.clone()), tracker: None, model, profile: None };
                changes.send(change).unwrap();
                hot.adopt();
            }
            let frame = Frame { captured_us: 33_333 * number, ..held };
            hot.pipeline.as_mut().unwrap().process(&frame).solved.ok().unwrap().smoothed.0
        };
        let faces: Vec<_> = (0..90).map(&mut face).collect();
        let step = |one: usize, other: usize| {
            faces[one].iter().zip(faces[other]).map(|(one, other)| (one - other).abs()).fold(0.0, f32::max)
        };
        assert!(step(44, 89) > 0.1, "the methods differ: {}", step(44, 89));
        assert!(step(44, 45) < 1e-3, "{}", step(44, 45));
        let most = 0.5 * step(44, 89);
        (45..89).for_each(|frame| assert!(step(frame, frame + 1) < most, "{frame}: {}", step(frame, frame + 1)));
    }

    /// How far a face at rest is known after 45 frames by one method and, after a reload, 30 frames by another.
    fn known_share([one, other]: [Method; 2]) -> f32 {
        let mut settings = Settings::default();
        settings.solver.method = one;
        let tracker = load_tracker(&settings.networks).unwrap();
        let (mut hot, _told, _counters) = hot(settings.clone(), tracker);
        let (changes, taken) = mpsc::channel();
        hot.changes = taken;
        let mut clip = Clip::once().unwrap();
        let held = clip.next().unwrap().unwrap();
        for number in 0..75 {
            if number == 45 {
                settings.solver.method = other;
                let model = load_model(&settings.solver).ok();
                changes
                    .send(HotChange { settings: Some(settings.clone()), tracker: None, model, profile: None })
                    .unwrap();
                hot.adopt();
            }
            let frame = Frame { captured_us: 33_333 * number, ..held };
            hot.pipeline.as_mut().unwrap().process(&frame).solved.ok().unwrap();
        }
        hot.pipeline.unwrap().solver.neutral_share()
    }

    #[test]
    fn a_face_that_a_new_method_reads_as_an_expression_is_known_no_better_than_if_it_had_been_used_from_the_start() {
        let [network, paper] = [Method::Network, Method::Paper];
        let shares = [[network, network], [network, paper], [paper, paper]].map(known_share);
        // The formulas read this face at rest as one with an expression.
        assert!(shares[0] > 0.2 && (shares[1] - shares[2]).abs() < 0.05, "{shares:?}");
    }

    #[test]
    fn a_change_of_eye_distance_moves_the_head_in_proportion_and_without_a_jump() {
        let tracker = load_tracker(&NetworkSettings::default()).unwrap();
        let (mut hot, _told, _counters) = hot(Settings::default(), tracker);
        let (changes, taken) = mpsc::channel();
        hot.changes = taken;
        let mut clip = Clip::once().unwrap();
        let held = clip.next().unwrap().unwrap();
        let mut away_mm = |number: u64| {
            let frame = Frame { captured_us: 33_333 * number, ..held };
            hot.adopt();
            hot.pipeline.as_mut().unwrap().process(&frame).solved.ok().unwrap().head.position_mm[2]
        };
        let before = (0..45).map(&mut away_mm).last().unwrap();
        let mut settings = Settings::default();
        settings.wearer.eye_distance_mm = 126.0;
        changes.send(HotChange { settings: Some(settings), tracker: None, model: None, profile: None }).unwrap();
        let after: Vec<_> = (45..120).map(&mut away_mm).collect();
        assert!((after[0] / before - 1.0).abs() < 1e-3, "{before} {}", after[0]);
        assert!((after[74] / before - 2.0).abs() < 1e-2, "{before} {}", after[74]);
    }

    #[test]
    fn a_camera_that_cannot_be_stopped_ends_the_service_and_one_that_is_gone_does_not() {
        let path = "/dev/video0".to_owned();
        let source = io::Error::other("stuck");
        assert!(!is_recoverable(&CaptureError::NotStopped { path, source }.into()));
        assert!(is_recoverable(&CaptureError::Gone.into()));
    }

    /// Inferences that the engine of a test may still run, and the number of CPUs of the thread that loaded it last.
    static GOOD_RUNS: AtomicU32 = AtomicU32::new(0);
    static CPUS_OF_LOADER: AtomicU32 = AtomicU32::new(0);

    /// Loads networks that see no face, and fail when the good runs are used up.
    fn load_failing(_: &NetworkSettings) -> Result<Tracker, InferError> {
        CPUS_OF_LOADER.store(rustix::thread::sched_getaffinity(None).unwrap().count(), Relaxed);
        let count_down = |runs: u32| runs.checked_sub(1);
        Tracker::load(&Scripted::new(move |_| {
            GOOD_RUNS.fetch_update(Relaxed, Relaxed, count_down).map(drop).map_err(|_| "the device has hung up")
        }))
    }

    /// The helper threads of the networks inherit the CPUs of the thread that starts them.
    #[test]
    fn an_engine_that_fails_for_good_is_told_loaded_again_and_then_ends_the_service() {
        let cpus = rustix::thread::sched_getaffinity(None).unwrap();
        let mut settings = camera(DEMO);
        settings.realtime.hot_cpu = (0..1024).find(|cpu| cpus.is_set(*cpu)).map_or(-1, |cpu| cpu as i32);
        let scheduling = realtime::Scheduling::hot(&settings.realtime);
        let tracker = load_failing(&NetworkSettings::default()).unwrap();
        let (mut hot, told, counters) = hot(settings, tracker);
        hot.load_tracker = load_failing;
        GOOD_RUNS.store(3, Relaxed);
        let bound = thread::spawn(move || {
            scheduling.apply();
            hot.run().unwrap_err().to_string()
        });
        let error = bound.join().unwrap();
        assert!(error.starts_with("network detector failed to run (the device has hung up)"), "{error}");
        let told: Vec<Event> = told.try_iter().collect();
        let is_told_once = matches!(&*told, [Event::Opened(_), Event::EngineFailed(_), Event::EngineReloaded]);
        assert!(is_told_once, "{told:?}");
        let counts = [&counters.no_face, &counters.rejected, &counters.engine_failures];
        assert_eq!(counts.map(|count| count.load(Relaxed)), [3, 16, 16]);
        assert_eq!(CPUS_OF_LOADER.load(Relaxed), cpus.count(), "not bound to the CPU of the hot loop");
    }

    #[test]
    fn eight_failures_in_a_row_reload_the_networks_and_eight_more_soon_after_are_given_up() {
        let [reload, give_up] = [Remedy::Reload, Remedy::GiveUp];
        for (is_reloaded, good_runs, remedy) in [(false, 0, reload), (true, 299, give_up), (true, 300, reload)] {
            let mut health = EngineHealth { failures: 0, good_runs: is_reloaded.then_some(0) };
            assert!((0..7).all(|_| health.failed() == Remedy::Wait));
            (0..good_runs).for_each(|_| health.ran());
            assert!(good_runs == 0 || (0..7).all(|_| health.failed() == Remedy::Wait));
            assert_eq!(health.failed(), remedy, "{good_runs}");
        }
    }
}
