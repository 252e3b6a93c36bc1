//! The counters that all threads share, without a lock and in fixed memory.

use std::fmt;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::time::Duration;

use facewire_packet::{NeutralFace, State};

use super::adaptation::Cause;
use super::heartbeat::Heartbeats;
use super::load::RecentLoad;
use super::step::Step;
use super::times::{Quantiles, Times};
use crate::impairment::{COUNT, ImpairmentSet, Impairments};
use crate::link::Traffic;

/// The states of the failsafe; [`Counters::state`] holds an index into this array.
pub(super) const STATES: [State; 4] = [State::Neutral, State::Live, State::Hold, State::Decay];
/// The neutral faces, in the order of their numbers.
pub(super) const NEUTRAL_FACES: [NeutralFace; 3] = [NeutralFace::Mean, NeutralFace::Estimated, NeutralFace::Calibrated];

/// Counters of a running service. They only grow, except for those that describe the present. [`Status`] says how they
/// add up.
#[derive(Debug, Default)]
pub struct Counters {
    stop: Arc<AtomicBool>,
    stop_sending: AtomicBool,
    /// Signs of life, for the watchdog.
    pub(super) heartbeats: Heartbeats,
    /// Frames that the pipeline processed.
    pub(super) frames: AtomicU64,
    /// Frames with a solution.
    pub(super) solved: AtomicU64,
    /// Frames without a face.
    pub(super) no_face: AtomicU64,
    /// Frames with a face whose result could not be trusted.
    pub(super) rejected: AtomicU64,
    /// Failed inferences; their frames are among the rejected ones.
    pub(super) engine_failures: AtomicU64,
    /// Frames that were skipped because a newer one had arrived.
    pub(super) skipped: AtomicU64,
    /// Frames that the present step left out.
    pub(super) left_out: AtomicU64,
    /// Frames that took longer than the time to the next frame that the step takes.
    pub(super) deadline_misses: AtomicU64,
    /// Damaged frames.
    pub(super) damaged: AtomicU64,
    /// How often a camera was opened.
    pub(super) opened: AtomicU64,
    /// Whether a camera is open at present.
    pub(super) camera_open: AtomicBool,
    /// Packets of all links, counted by the links themselves.
    pub(super) traffic: Arc<Traffic>,
    /// Links that are open at present.
    pub(super) links_open: AtomicU64,
    /// The first link whose last packet the network refused: its index plus 1 in the upper half, the system's error number
    /// in the lower half; 0 if there is none. Both share a word so that they always belong together.
    refusal: AtomicU64,
    /// Mean time between processed frames at present, microseconds. The failsafe is more patient with slow cameras.
    pub(super) frame_period_us: AtomicU64,
    /// What makes tracking poor at present.
    pub(super) impairments: Impairments,
    /// The state of the failsafe at present, as an index into [`STATES`].
    state: AtomicU64,
    /// How long the last frames took.
    pub(super) recent: RecentLoad,
    /// The step of the pipeline, as an index into [`Step::ALL`].
    step: AtomicUsize,
    /// Why it is not the first one, as an index into [`Cause::ALL`] plus 1; 0 on the first step.
    step_cause: AtomicUsize,
    /// How often the step has changed.
    step_changes: AtomicU64,
    /// Whether the camera is to be opened with half the width and height.
    pub(super) small_picture: AtomicBool,
    /// Whether the open camera offers a smaller picture.
    pub(super) has_smaller_mode: AtomicBool,
    /// The neutral face that is in use.
    pub(super) neutral: Neutral,
    /// Distributions of times.
    pub(super) times: Times,
}

/// The neutral face from which coefficients are measured.
#[derive(Debug, Default)]
pub(super) struct Neutral {
    /// Which it is, as an index into [`NEUTRAL_FACES`].
    face: AtomicU64,
    /// Bits of the share of the estimated face, which is 0 with a calibrated one.
    share: AtomicU32,
    /// How often the estimate was forgotten.
    forgotten: AtomicU64,
}

impl Neutral {
    /// Sets what the solver uses.
    pub(super) fn set(&self, face: NeutralFace, share: f32, forgotten: u64) {
        self.face.store(face as u64, Relaxed);
        self.share.store(share.to_bits(), Relaxed);
        self.forgotten.store(forgotten, Relaxed);
    }
}

impl Counters {
    /// Whether the service is to stop.
    pub(super) fn stopping(&self) -> bool {
        self.stop.load(Relaxed)
    }

    /// Returns the flag that SIGTERM and SIGINT set.
    pub(super) fn stop_flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
    }

    /// Whether the sender is to stop.
    pub(super) fn sending_stops(&self) -> bool {
        self.stop_sending.load(Relaxed)
    }

    /// Tells all threads to stop.
    pub(super) fn stop(&self) {
        self.stop.store(true, Relaxed);
        self.stop_sending.store(true, Relaxed);
    }

    /// Sets the first link that the network refuses: its index and the system's error number.
    pub(super) fn set_refusal(&self, refusal: Option<(u32, i32)>) {
        let word = refusal.map_or(0, |(link, error)| (u64::from(link) + 1) << 32 | u64::from(error.unsigned_abs()));
        self.refusal.store(word, Relaxed);
    }

    /// Returns the first link that the network refuses, as [`Counters::set_refusal`] set it, and the system's error.
    pub(super) fn refusal(&self) -> Option<(usize, io::Error)> {
        let word = self.refusal.load(Relaxed);
        let link = usize::try_from(word >> 32).ok()?.checked_sub(1)?;
        let error = i32::try_from(word & u64::from(u32::MAX)).ok()?;
        Some((link, io::Error::from_raw_os_error(error)))
    }

    /// Sets the state of the failsafe.
    pub(super) fn set_state(&self, state: State) {
        let number = STATES.iter().zip(0..).find(|(known, _)| **known == state);
        self.state.store(number.map_or(0, |(_, number)| number), Relaxed);
    }

    /// Counts the time that the decoding of a frame and the work on it took. Beyond `deadline`, the next frame had to wait.
    pub(super) fn count_busy(&self, busy: Duration, deadline: Duration) {
        self.deadline_misses.fetch_add(u64::from(busy > deadline), Relaxed);
    }

    /// The step on which the hot loop is to run.
    pub(super) fn step(&self) -> Step {
        Step::ALL.get(self.step.load(Relaxed)).copied().unwrap_or_default()
    }

    /// Sets the step, and why it is not the first one. Counts the change.
    pub(super) fn set_step(&self, step: Step, cause: Option<Cause>) {
        self.step.store(step as usize, Relaxed);
        self.step_cause.store(cause.map_or(0, |cause| cause as usize + 1), Relaxed);
        self.step_changes.fetch_add(1, Relaxed);
    }

    /// Returns the present counts.
    #[must_use]
    pub fn status(&self) -> Status {
        let state = usize::try_from(self.state.load(Relaxed)).ok().and_then(|number| STATES.get(number));
        let neutral_face = usize::try_from(self.neutral.face.load(Relaxed)).ok();
        Status {
            frames: self.frames.load(Relaxed),
            solved: self.solved.load(Relaxed),
            no_face: self.no_face.load(Relaxed),
            rejected: self.rejected.load(Relaxed),
            engine_failures: self.engine_failures.load(Relaxed),
            skipped: self.skipped.load(Relaxed),
            left_out: self.left_out.load(Relaxed),
            deadline_misses: self.deadline_misses.load(Relaxed),
            damaged: self.damaged.load(Relaxed),
            opened: self.opened.load(Relaxed),
            camera_open: self.camera_open.load(Relaxed),
            packets: self.traffic.packets.load(Relaxed),
            sent: self.traffic.sent.load(Relaxed),
            dropped: self.traffic.dropped.load(Relaxed),
            links_open: self.links_open.load(Relaxed),
            state: state.copied().unwrap_or_default(),
            step: self.step(),
            step_cause: self.step_cause.load(Relaxed).checked_sub(1).and_then(|index| Cause::ALL.get(index)).copied(),
            step_changes: self.step_changes.load(Relaxed),
            has_small_picture: self.small_picture.load(Relaxed),
            impaired_by: self.impairments.present(),
            impairments: self.impairments.begun(),
            neutral_face: neutral_face.and_then(|number| NEUTRAL_FACES.get(number)).copied().unwrap_or_default(),
            neutral_share: f32::from_bits(self.neutral.share.load(Relaxed)),
            neutral_forgotten: self.neutral.forgotten.load(Relaxed),
            times_ms: self.times.quantiles(),
        }
    }
}

/// The counts at one moment. They print as the status line.
///
/// They add up once the threads have ended (the line of a running service may be one frame or packet off):
/// - `frames = solved + no_face + rejected`;
/// - `packets = sent + dropped`, each over all links, including those that a reload has replaced.
///
/// `frames` includes those that missed their deadline, and excludes `skipped`, `left_out` and `damaged` frames, which never
/// reached the pipeline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// Frames that the pipeline processed.
    pub frames: u64,
    /// Frames with a solution.
    pub solved: u64,
    /// Frames without a face.
    pub no_face: u64,
    /// Frames with a face whose result could not be trusted.
    pub rejected: u64,
    /// Failed inferences; their frames are among the rejected ones.
    pub engine_failures: u64,
    /// Frames that were skipped because a newer one had arrived.
    pub skipped: u64,
    /// Frames that the steps of the adaptation left out.
    pub left_out: u64,
    /// Frames that took longer than the time to the next frame that the step takes.
    pub deadline_misses: u64,
    /// Damaged frames.
    pub damaged: u64,
    /// How often a camera was opened.
    pub opened: u64,
    /// Whether a camera is open at present.
    pub camera_open: bool,
    /// Packets that all links were given to send.
    pub packets: u64,
    /// Packets that all links sent.
    pub sent: u64,
    /// Packets that all links dropped.
    pub dropped: u64,
    /// Links that are open at present.
    pub links_open: u64,
    /// The failsafe's state.
    pub state: State,
    /// The step on which the pipeline runs.
    pub step: Step,
    /// Why it is not the first one.
    pub step_cause: Option<Cause>,
    /// How often the step has changed.
    pub step_changes: u64,
    /// Whether the camera is opened with half the width and height.
    pub has_small_picture: bool,
    /// What makes tracking poor.
    pub impaired_by: ImpairmentSet,
    /// The name of each impairment, and how often it has begun.
    pub impairments: [(&'static str, u64); COUNT],
    /// The neutral face from which coefficients are measured.
    pub neutral_face: NeutralFace,
    /// Share of the estimated face in it, from 0 to 1. It is 0 with a calibrated one.
    pub neutral_share: f32,
    /// How often an estimated neutral face was forgotten, because another person sat down.
    pub neutral_forgotten: u64,
    /// Names and distributions of times: wait, decode, detect, mesh, solve, work, age.
    pub times_ms: [(&'static str, Quantiles); 7],
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "frames={} faces={} no_face={} rejected={}", self.frames, self.solved, self.no_face, self.rejected)?;
        let Self { skipped, left_out, deadline_misses, damaged, opened, .. } = self;
        write!(f, " engine_failures={} skipped={skipped} left_out={left_out}", self.engine_failures)?;
        write!(f, " deadline_misses={deadline_misses} damaged={damaged} cameras_opened={opened}")?;
        write!(f, " packets={} sent={} dropped={}", self.packets, self.sent, self.dropped)?;
        write!(f, " links_open={} state={} impaired_by={}", self.links_open, self.state.name(), self.impaired_by)?;
        let cause = self.step_cause.map_or("none", Cause::name);
        let picture = if self.has_small_picture { "small" } else { "full" };
        write!(f, " step={} step_by={cause} step_changes={} picture={picture}", self.step, self.step_changes)?;
        let Self { neutral_face, neutral_share, neutral_forgotten, .. } = self;
        write!(f, " neutral={} neutral_share={neutral_share:.2}", neutral_face.name())?;
        write!(f, " neutral_forgotten={neutral_forgotten}")?;
        self.times_ms.iter().try_for_each(|(name, quantiles)| write!(f, " {name}_ms={quantiles}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::impairment::Impairment;

    #[test]
    fn the_status_line_has_every_count_under_its_name() {
        let counters = Counters::default();
        counters.frames.store(10, Relaxed);
        counters.no_face.store(1, Relaxed);
        counters.deadline_misses.store(2, Relaxed);
        counters.traffic.sent.store(3, Relaxed);
        counters.times.age.record(Duration::from_millis(8));
        counters.impairments.set(Impairment::Dark, true);
        counters.set_step(Step::Third, Some(Cause::Slow));
        counters.neutral.set(NeutralFace::Estimated, 0.733, 2);
        let line = counters.status().to_string();
        let parts = [
            "frames=10 ",
            " impaired_by=dark step=third step_by=slow step_changes=1 picture=full ",
            " neutral=estimated neutral_share=0.73 neutral_forgotten=2 ",
            " no_face=1 ",
            " deadline_misses=2 ",
            " sent=3 ",
            " wait_ms=0.000/0.000/0.000 ",
        ];
        assert!(parts.iter().all(|part| line.contains(part)), "{line}");
        assert!(line.ends_with(" age_ms=8.13/8.13/8.13"), "{line}");
        assert!(line.split(' ').all(|part| part.matches('=').count() == 1), "{line}");
    }

    #[test]
    fn work_as_long_as_the_frame_period_is_in_time_and_a_microsecond_longer_is_a_miss() {
        let counters = Counters::default();
        let misses = |work_us| {
            counters.count_busy(Duration::from_micros(work_us), Duration::from_micros(33_333));
            counters.status().deadline_misses
        };
        assert_eq!([0, 33_333, 33_334, 33_333, 500_000].map(misses), [0, 0, 1, 1, 2]);
    }

    #[test]
    fn a_refusal_names_its_link_and_the_error_until_it_is_cleared() {
        let counters = Counters::default();
        assert!(counters.refusal().is_none());
        counters.set_refusal(Some((2, 101)));
        let (link, error) = counters.refusal().unwrap();
        assert_eq!((link, error.raw_os_error()), (2, Some(101)));
        counters.set_refusal(None);
        assert!(counters.refusal().is_none());
    }

    #[test]
    fn the_status_reports_the_state_that_was_set() {
        let counters = Counters::default();
        assert_eq!(counters.status().state, State::Neutral);
        for state in STATES {
            counters.set_state(state);
            assert_eq!(counters.status().state, state);
        }
    }
}
