//! The counters that all threads share, in fixed memory, and without a lock in those that process and send frames.
//! [`Counters::rows`] is the one table from which the status line and the metrics page are made.

use std::io;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};

use facewire_packet::{NeutralFace, State, Visibility};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGUSR1};
use signal_hook::flag;

use super::adaptation::{Cause, Step};
use super::timing::{Times, quantiles};
use crate::calibration::WearerName;
use crate::link::{Panel, Traffic};
use facewire_board::{Impairment, Impairments};
use facewire_face::Rotation;

/// Exit status after a second SIGTERM or SIGINT.
const EXIT_SECOND_SIGNAL: i32 = 130;
/// [`Counters::state`] holds an index into this array.
const STATES: [State; 4] = [State::Neutral, State::Live, State::Hold, State::Decay];
const NEUTRAL_FACES: [NeutralFace; 3] = [NeutralFace::Mean, NeutralFace::Estimated, NeutralFace::Calibrated];

/// Longest time to load networks or a model, to open or close a camera, or to pause before the next attempt, microseconds.
/// The kernel gives up each control call to a USB camera after 5 s, and the first frame may take another 5 s.
pub(super) const OPEN_PATIENCE_US: u64 = 30_000_000;
/// Longest time to work on one frame, microseconds. Emulated and swapping machines have taken 2 s.
pub(super) const WORK_PATIENCE_US: u64 = 10_000_000;
/// A frame may take two stall timeouts: one to arrive, and one more for a newer frame if it waited in a buffer for long.
const STALL_TIMEOUTS_PER_FRAME: u64 = 2;
/// Time added to the stall timeouts, microseconds: half a second for frames that a step leaves out, and half a second to spare.
const GRACE_US: u64 = 1_000_000;
/// Longest time between two rounds of the sender, which sleeps for 0.1 s at most, microseconds.
const SENDER_PATIENCE_US: u64 = 5_000_000;

/// Counters of a running service. Those that do not describe the present only grow, and add up once the threads have
/// ended:
/// - `frames = solved + no_face + rejected`;
/// - `packets = sent + dropped`, each over all links, including those that a reload has replaced.
///
/// `frames` includes those that missed their deadline, and excludes `skipped`, `left_out` and `damaged` frames, which
/// never reached the pipeline.
#[derive(Default)]
pub(super) struct Counters {
    /// Whether the service is to stop. SIGTERM and SIGINT set it.
    pub(super) stop: Arc<AtomicBool>,
    /// Whether SIGHUP and SIGUSR1 have asked to read the settings again and to write the status line.
    pub(super) wants_reload: Arc<AtomicBool>,
    pub(super) wants_status: Arc<AtomicBool>,
    pub(super) stop_sending: AtomicBool,
    pub(super) heartbeats: Heartbeats,
    pub(super) frames: AtomicU64,
    pub(super) solved: AtomicU64,
    pub(super) no_face: AtomicU64,
    pub(super) rejected: AtomicU64,
    pub(super) engine_failures: AtomicU64,
    pub(super) skipped: AtomicU64,
    pub(super) left_out: AtomicU64,
    pub(super) mistimed: AtomicU64,
    pub(super) deadline_misses: AtomicU64,
    pub(super) damaged: AtomicU64,
    pub(super) opened: AtomicU64,
    pub(super) camera_open: AtomicBool,
    /// Packets of all links, counted by the links themselves.
    pub(super) traffic: Arc<Traffic>,
    pub(super) links_open: AtomicU64,
    /// Mean time between processed frames at present, microseconds. The failsafe is more patient with slow cameras.
    pub(super) frame_period_us: AtomicU64,
    pub(super) impairments: Impairments,
    state: AtomicUsize,
    /// The step of the pipeline, as an index into [`Step::ALL`].
    step: AtomicUsize,
    /// Why the step is not the first one, as an index into [`Cause::NAMES`] plus 1; 0 on the first step.
    step_cause: AtomicUsize,
    step_changes: AtomicU64,
    /// Whether the camera is to be opened with half the width and height.
    pub(super) small_picture: AtomicBool,
    pub(super) has_smaller_mode: AtomicBool,
    /// The neutral face from which coefficients are measured, as an index into [`NEUTRAL_FACES`].
    neutral_face: AtomicUsize,
    /// The bits of an `f32`: the share of the estimated face in the neutral one, which is 0 with a calibrated one.
    neutral_share: AtomicU32,
    neutral_forgotten: AtomicU64,
    /// The bits of `f32`s: how much of each part of the face is hidden, so that all is in view at the start.
    hidden: [AtomicU32; Visibility::NAMES.len()],
    /// The bits of an `f32`: the mesh network's score of the face in the last frame, 0 without a face.
    face_score: AtomicU32,
    /// The turn that shows the face upright and is not that of the settings, as an index into [`Rotation::ALL`] plus 1.
    proposed_rotation: AtomicUsize,
    pub(super) times: Times,
    /// The wearer whose profile is in use, who need not be the one that the settings name. Only the threads of control,
    /// supervisor and reloads lock it.
    wearer: Mutex<Option<WearerName>>,
    /// The panels of the links in the order of the settings, locked by the same threads.
    panels: Mutex<Vec<Arc<Panel>>>,
    /// When an operator released all servos, or let them move again, seconds since 1970.
    pub(super) released_unix_s: AtomicU64,
    /// Why the disk does not keep that for the next start.
    pub(super) release_not_kept: Mutex<Option<String>>,
    /// Why the settings that were read last are not in use. The hot loop does not lock it either.
    pub(super) settings_refused: Mutex<Option<String>>,
}

pub(super) struct Row {
    pub(super) metric: &'static str,
    pub(super) kind: &'static str,
    /// The label that tells the samples apart; empty if there is one sample.
    pub(super) label: &'static str,
    pub(super) help: &'static str,
    /// `key=value` in the status line; empty if it is on the page alone.
    text: String,
    pub(super) samples: Vec<(&'static str, f64)>,
}

/// The columns are the kind, the name, the label and the help of a metric, and its text in the status line with its
/// samples.
macro_rules! rows {
    ($($kind:ident $metric:literal $label:literal $help:literal = $values:expr;)*) => {
        vec![$({
            let (text, samples) = $values;
            Row { metric: $metric, kind: stringify!($kind), label: $label, help: $help, text, samples }
        },)*]
    };
}

type Values = (String, Vec<(&'static str, f64)>);

fn counts<const N: usize>(counts: [(&str, &'static str, &AtomicU64); N]) -> Values {
    let counts = counts.map(|(key, value, count)| (key, value, count.load(Relaxed)));
    let samples = counts.map(|(_, value, count)| (value, count as f64));
    (counts.map(|(key, _, count)| format!("{key}={count}")).join(" "), samples.into())
}

fn count(key: &str, count: &AtomicU64) -> Values {
    counts([(key, "", count)])
}

fn indicator(text: &str, is_set: bool) -> Values {
    (text.to_owned(), vec![("", f64::from(u8::from(is_set)))])
}

/// Makes a sample for each name: 1 if `holds` is true for its index, else 0. The status line lists the names with 1.
fn present<const N: usize>(key: &str, names: [&'static str; N], holds: impl Fn(usize) -> bool) -> Values {
    let samples: Vec<_> = names.into_iter().zip(0..).map(|(name, at)| (name, f64::from(u8::from(holds(at))))).collect();
    (listed(key, samples.iter().filter(|(_, holds)| *holds > 0.0).map(|(name, _)| *name)), samples)
}

fn hundredths(value: f32) -> f64 {
    (f64::from(value) * 100.0).round() / 100.0
}

fn listed(key: &str, names: impl Iterator<Item = &'static str>) -> String {
    let names: Vec<_> = names.collect();
    format!("{key}={}", if names.is_empty() { "none".to_owned() } else { names.join(",") })
}

impl Counters {
    /// Installs the handlers. The first SIGTERM or SIGINT stops the service, the second ends the process at once.
    pub(super) fn catch_signals(&self) -> io::Result<()> {
        for signal in [SIGTERM, SIGINT] {
            flag::register_conditional_shutdown(signal, EXIT_SECOND_SIGNAL, Arc::clone(&self.stop))?;
            flag::register(signal, Arc::clone(&self.stop))?;
        }
        flag::register(SIGHUP, Arc::clone(&self.wants_reload))?;
        flag::register(SIGUSR1, Arc::clone(&self.wants_status))?;
        Ok(())
    }

    pub(super) fn stopping(&self) -> bool {
        self.stop.load(Relaxed)
    }

    pub(super) fn stop(&self) {
        self.stop.store(true, Relaxed);
        self.stop_sending.store(true, Relaxed);
    }

    pub(super) fn wearer(&self) -> Option<WearerName> {
        self.wearer.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) fn set_wearer(&self, name: Option<WearerName>) {
        *self.wearer.lock().unwrap_or_else(PoisonError::into_inner) = name;
    }

    pub(super) fn panels(&self) -> Vec<Arc<Panel>> {
        self.panels.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) fn set_panels(&self, panels: Vec<Arc<Panel>>) {
        *self.panels.lock().unwrap_or_else(PoisonError::into_inner) = panels;
    }

    pub(super) fn set_state(&self, state: State) {
        self.state.store(STATES.iter().position(|known| *known == state).unwrap_or(0), Relaxed);
    }

    pub(super) fn set_neutral(&self, face: NeutralFace, share: f32, forgotten: u64) {
        self.neutral_face.store(face as usize, Relaxed);
        self.neutral_share.store(share.to_bits(), Relaxed);
        self.neutral_forgotten.store(forgotten, Relaxed);
    }

    pub(super) fn set_visibility(&self, visibility: Visibility) {
        for (hidden, value) in self.hidden.iter().zip(visibility.values()) {
            hidden.store((1.0 - value).to_bits(), Relaxed);
        }
    }

    fn visibility(&self) -> Visibility {
        Visibility::from_values(self.hidden.each_ref().map(|hidden| 1.0 - f32::from_bits(hidden.load(Relaxed))))
    }

    pub(super) fn set_face_score(&self, score: f32) {
        self.face_score.store(score.to_bits(), Relaxed);
    }

    pub(super) fn propose_rotation(&self, rotation: Option<Rotation>) {
        self.proposed_rotation.store(rotation.map_or(0, |rotation| rotation as usize + 1), Relaxed);
    }

    /// Whether another rotation of the picture shows the face upright.
    pub(super) fn has_proposed_rotation(&self) -> bool {
        self.proposed_rotation.load(Relaxed) != 0
    }

    /// Withdraws the proposal of a rotation that is now in use.
    pub(super) fn withdraw_rotation(&self, used: Rotation) {
        let _ = self.proposed_rotation.compare_exchange(used as usize + 1, 0, Relaxed, Relaxed);
    }

    pub(super) fn step(&self) -> Step {
        Step::ALL.get(self.step.load(Relaxed)).copied().unwrap_or_default()
    }

    /// Sets the step, and why it is not the first one. Counts the change.
    pub(super) fn set_step(&self, step: Step, cause: Option<Cause>) {
        self.step.store(step as usize, Relaxed);
        self.step_cause.store(cause.map_or(0, |cause| cause as usize + 1), Relaxed);
        self.step_changes.fetch_add(1, Relaxed);
    }

    pub(super) fn rows(&self) -> Vec<Row> {
        let impaired_by = self.impairments.present();
        let begun = self.impairments.begun().map(|(name, count)| (name, count as f64)).collect();
        let [state, step] = [&self.state, &self.step].map(|index| index.load(Relaxed));
        let step_cause = self.step_cause.load(Relaxed);
        let neutral = self.neutral_face.load(Relaxed);
        let is_released = self.traffic.operator.is_released.load(Relaxed);
        let is_small = self.small_picture.load(Relaxed);
        let face_score = f32::from_bits(self.face_score.load(Relaxed));
        let proposed_rotation = self.proposed_rotation.load(Relaxed);
        let visibility = self.visibility();
        let in_view = visibility.parts().map(|(part, value)| (part, hundredths(value))).collect();
        let share = f32::from_bits(self.neutral_share.load(Relaxed));
        let unheard = AtomicU64::new(self.panels().iter().filter(|panel| panel.is_unheard()).count() as u64);
        let Traffic { packets, sent, dropped, .. } = &*self.traffic;
        rows! {
            counter "frames" "result" "Frames processed, by result." = counts([
                ("faces", "solved", &self.solved), ("no_face", "no_face", &self.no_face),
                ("rejected", "rejected", &self.rejected),
            ]);
            counter "engine_failures" "" "Failed inferences; their frames are among the rejected ones."
                = count("engine_failures", &self.engine_failures);
            counter "frames_skipped" "" "Frames skipped for a newer frame." = count("skipped", &self.skipped);
            counter "frames_left_out" "" "Frames left out by the present step of the pipeline."
                = count("left_out", &self.left_out);
            counter "frames_mistimed" "" "Frames whose driver timestamp cannot be true; their time of arrival is used instead."
                = count("mistimed", &self.mistimed);
            counter "deadline_misses" "" "Frames that took longer than the time to the next frame that the step takes."
                = count("deadline_misses", &self.deadline_misses);
            counter "frames_damaged" "" "Frames damaged by camera or cable." = count("damaged", &self.damaged);
            counter "cameras_opened" "" "Number of times that a camera was opened." = count("cameras_opened", &self.opened);
            gauge "camera_open" "" "1 if a camera is open, else 0." = indicator("", self.camera_open.load(Relaxed));
            counter "packets" "" "Packets that all links were given to send." = count("packets", packets);
            counter "link_packets" "result" "Packets sent and dropped, summed over all links."
                = counts([("sent", "sent", sent), ("dropped", "dropped", dropped)]);
            gauge "links_open" "" "Links that are open." = count("links_open", &self.links_open);
            gauge "links_unheard" "" "Links by UDP to whose port nobody listens, as the receivers' machines say."
                = count("links_unheard", &unheard);
            gauge "failsafe_state" "state" "1 for the present state of the failsafe, 0 for the others."
                = present("state", STATES.map(State::name), |at| at == state);
            gauge "impaired" "by" "1 for each present impairment of tracking, else 0."
                = present("impaired_by", Impairment::ALL.map(Impairment::name), |at| {
                    Impairment::ALL.get(at).is_some_and(|by| impaired_by.contains(*by))
                });
            counter "impairments" "by" "How often each impairment has begun." = (String::new(), begun);
            gauge "step" "step" "1 for the present step of the pipeline, 0 for the others."
                = present("step", Step::ALL.map(Step::name), |at| at == step);
            gauge "step_by" "by" "1 for the reason of a step other than full, else 0."
                = present("step_by", Cause::NAMES, |at| at + 1 == step_cause);
            counter "step_changes" "" "How often the step has changed." = count("step_changes", &self.step_changes);
            gauge "small_picture" "" "1 if the camera is opened with half the width and height, else 0."
                = indicator(if is_small { "picture=small" } else { "picture=full" }, is_small);
            gauge "neutral_face" "from" "1 for the neutral face that coefficients are measured from, 0 for the others."
                = present("neutral", NEUTRAL_FACES.map(NeutralFace::name), |at| at == neutral);
            gauge "neutral_share" "" "Share of the estimated face in the neutral face, from 0 to 1; 0 with a calibrated one."
                = (format!("neutral_share={share:.2}"), vec![("", share.into())]);
            counter "neutral_forgotten" "" "How often the estimated neutral face was forgotten because another person sat down."
                = count("neutral_forgotten", &self.neutral_forgotten);
            gauge "visibility" "part" "How much of each part of the face is in view, from 0 (covered) to 1; 1 without a face."
                = (listed("covered", visibility.covered()), in_view);
            gauge "face_score" "" "How surely the mesh network sees a face: log-odds, about 25 for one in view; 0 without a face."
                = (format!("face_score={face_score:.1}"), vec![("", face_score.into())]);
            gauge "proposed_rotation" "degrees" "1 for the camera.rotation that shows the face upright, if it is not set."
                = present("proposed_rotation", ["0", "90", "180", "270"], |at| at + 1 == proposed_rotation);
            gauge "servos_released" "" "1 while an operator keeps all servos without pulses, else 0."
                = indicator(if is_released { "servos=released" } else { "" }, is_released);
        }
    }

    pub(super) fn status_line(&self) -> String {
        let frames = format!("frames={}", self.frames.load(Relaxed));
        let texts = self.rows().into_iter().map(|row| row.text).filter(|text| !text.is_empty());
        let times = self.times.all().map(|(name, histogram)| format!("{name}_ms={}", quantiles(histogram)));
        [frames].into_iter().chain(texts).chain(times).collect::<Vec<_>>().join(" ")
    }
}

/// Longest time to wait for a frame of a camera with this stall timeout, microseconds.
pub(super) fn frame_patience_us(stall_timeout_ms: u32) -> u64 {
    u64::from(stall_timeout_ms) * 1000 * STALL_TIMEOUTS_PER_FRAME + GRACE_US
}

/// The signs of life on which the pings for the service manager's watchdog depend: by when, on the monotonic clock, the hot
/// loop and the sender will report again. A thread that lets its deadline pass is stuck. The patience is far longer than
/// each phase takes on a healthy machine, because waiting for a camera is not being stuck, and neither is a slow frame on
/// a throttled board.
#[derive(Debug, Default)]
pub(super) struct Heartbeats {
    hot_deadline_us: AtomicU64,
    sender_deadline_us: AtomicU64,
}

impl Heartbeats {
    pub(super) fn beat_hot(&self, now_us: u64, patience_us: u64) {
        self.hot_deadline_us.store(now_us + patience_us, Relaxed);
    }

    pub(super) fn beat_sender(&self, now_us: u64) {
        self.sender_deadline_us.store(now_us + SENDER_PATIENCE_US, Relaxed);
    }

    pub(super) fn are_alive(&self, now_us: u64) -> bool {
        [&self.hot_deadline_us, &self.sender_deadline_us].iter().all(|deadline_us| now_us < deadline_us.load(Relaxed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    #[test]
    fn each_phase_is_stuck_after_its_own_time() {
        let [second, minute] = [1000, 60_000].map(frame_patience_us);
        for (patience_us, expected_s) in [(WORK_PATIENCE_US, 10), (OPEN_PATIENCE_US, 30), (second, 3), (minute, 121)] {
            let heartbeats = Heartbeats::default();
            heartbeats.beat_hot(100 * S, patience_us);
            let alive_s = (100..400).take_while(|at_s| {
                heartbeats.beat_sender(at_s * S);
                heartbeats.are_alive(at_s * S)
            });
            assert_eq!(alive_s.count(), expected_s, "{patience_us}");
        }
    }

    #[test]
    fn a_sender_that_stops_going_round_is_noticed_after_5_s() {
        let heartbeats = Heartbeats::default();
        heartbeats.beat_hot(100 * S, OPEN_PATIENCE_US);
        heartbeats.beat_sender(100 * S);
        assert!(heartbeats.are_alive(105 * S - 1) && !heartbeats.are_alive(105 * S));
    }
}
