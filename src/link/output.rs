//! What a link sends, and when.
//!
//! [`Output`] is the face as the failsafe shows it at one moment. [`Shown`] turns it into what one receiver sees, by the
//! link's own adjustments and what its settings want while no face is followed. [`Pace`] says when that is sent: at least
//! every 100 ms, because receivers go neutral by themselves after 500 ms without a packet. The only exception is a link
//! whose `loss` is "silent", while the face is neutral because no face is followed.
//! Time is an argument: a clock that stands still or steps back delays packets and does no other harm.

use facewire_face::stages::mirror_image;
use facewire_packet::{Pose, Reason, State};
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::config::{LinkSettings, Loss, PaceKind};

/// Longest time between two packets of a link that is not silent.
const KEEP_ALIVE_US: u64 = 100_000;
/// Smallest visible change of a coefficient.
const COEFFICIENT_STEP: f32 = 0.005;
/// Smallest visible change of a component of the head's rotation quaternion: the sine of half of 0.5 degrees.
const ROTATION_STEP: f32 = 0.004_363;
const POSITION_STEP_MM: f32 = 2.0;
/// Longest time that one step of a limited motion accounts for. After a longer pause, in which the process may have been
/// stopped, the motion goes on as if it had been paused.
pub const LONGEST_STEP_US: u64 = 100_000;
/// How far the head may turn and move while a coefficient may move by 1. At 4 units/s this is 180 degrees/s and 1 m/s.
const RADIANS_PER_UNIT: f32 = std::f32::consts::FRAC_PI_4;
const MM_PER_UNIT: f32 = 250.0;

#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// How far the pose can be trusted.
    pub state: State,
    /// Why the face is not live; [`Reason::None`] while it is.
    pub reason: Reason,
    pub pose: Pose,
    /// Time since the capture of the last pose that the output followed; `u64::MAX` if there was none.
    pub age_us: u64,
    /// Capture time of that pose on the monotonic clock; 0 if there was none.
    pub capture_us: u64,
    /// Whether the output follows a pose that has just arrived.
    pub followed: bool,
    /// Whether the output moves on without a new pose, as it does during a decay or a ramp.
    pub moving: bool,
    /// Whether the last pose that the output followed is an operator's, not the wearer's.
    pub is_puppet: bool,
}

impl Output {
    /// A face that nobody has moved yet.
    pub const NEUTRAL: Self = Self {
        state: State::Neutral,
        reason: Reason::None,
        pose: Pose::NEUTRAL,
        age_us: u64::MAX,
        capture_us: 0,
        followed: false,
        moving: false,
        is_puppet: false,
    };
}

/// What a link remembers for the time after a loss.
#[derive(Debug, Default)]
pub struct Shown {
    last_live: Option<Pose>,
    /// The pose that is shown in place of that of the output, and since when.
    pub(super) held: Option<(Pose, u64)>,
}

impl Shown {
    /// Returns what the link shows in place of this output. A pose that was held moves to that of the output no faster
    /// than `slew_per_s`.
    pub fn next(&mut self, settings: &LinkSettings, slew_per_s: f32, now_us: u64, output: &Output) -> Output {
        let mut shown = output.clone();
        if output.state == State::Live {
            self.last_live = Some(output.pose);
        }
        let is_lost = matches!(output.state, State::Decay | State::Neutral) && output.reason != Reason::Stopping;
        // Nobody wants an operator's face any more once the operator has left.
        let is_held = is_lost && settings.pace.loss == Loss::Hold && !output.is_puppet;
        if let (true, Some(pose)) = (is_held, self.held.map(|(pose, _)| pose).or(self.last_live)) {
            shown.state = State::Hold;
            shown.pose = pose;
            shown.moving = false;
            self.held = Some((pose, now_us));
        } else if let Some((pose, since_us)) = self.held.take() {
            let elapsed_s = now_us.saturating_sub(since_us).min(LONGEST_STEP_US) as f32 * 1e-6;
            shown.pose = towards(&pose, &output.pose, 1.0, slew_per_s * elapsed_s);
            shown.moving = shown.pose != output.pose;
            self.held = shown.moving.then_some((shown.pose, now_us));
        }
        Self::adjusted(settings, &shown)
    }

    /// Returns the output with the link's own adjustments.
    pub fn adjusted(settings: &LinkSettings, output: &Output) -> Output {
        let mut shown = output.clone();
        let adjust = &settings.adjust;
        let Pose { rotation, position_mm, coefficients, visibility, .. } = &mut shown.pose;
        adjust.apply(coefficients);
        if adjust.mirror {
            *visibility = visibility.mirrored();
            (*rotation, *position_mm) = mirror_image(*rotation, *position_mm);
        }
        shown
    }
}

/// When a link sends: what it has sent last, and when that was or should have been, microseconds.
#[derive(Debug, Default)]
pub struct Pace(Option<(u64, Output)>);

impl Pace {
    /// Returns whether to send this output now, and how long to wait before the next call, in microseconds, if no pose or
    /// fault comes first. `send_hz` is the rate of `[send]`.
    pub fn step(&mut self, settings: &LinkSettings, send_hz: u32, now_us: u64, output: &Output) -> (bool, u64) {
        let kind = settings.pace.pace;
        let period_us = 1_000_000 / u64::from(settings.rate_hz(send_hz).max(1));
        let wait_us = |at_us: u64, last: &Output| {
            interval_us(settings.pace.loss, kind, period_us, last, output).saturating_sub(now_us.saturating_sub(at_us))
        };
        // The wearer's poses have the camera's rate. An operator's may come at any rate.
        let is_followed = output.followed && kind == PaceKind::Pose && !output.is_puppet;
        let is_due = is_followed || self.0.as_ref().is_none_or(|(at_us, last)| wait_us(*at_us, last) == 0);
        if is_due {
            // A fixed rate keeps its grid, so that late wake-ups do not add up.
            let grid_us =
                self.0.as_ref().filter(|_| kind == PaceKind::Rate).map(|(at_us, _)| at_us.saturating_add(period_us));
            let is_on_time = |grid_us: &u64| now_us.checked_sub(*grid_us).is_some_and(|late_us| late_us < period_us);
            self.0 = Some((grid_us.filter(is_on_time).unwrap_or(now_us), output.clone()));
        }
        let left_us = self.0.as_ref().map_or(0, |(at_us, last)| wait_us(*at_us, last));
        (is_due, if output.moving { left_us.min(period_us) } else { left_us })
    }
}

/// Time from the last packet to one that carries this output.
fn interval_us(loss: Loss, kind: PaceKind, period_us: u64, last: &Output, output: &Output) -> u64 {
    let is_new_state = (last.state, last.reason) != (output.state, output.reason);
    match kind {
        _ if loss == Loss::Silent && output.state == State::Neutral && last.state == State::Neutral => u64::MAX,
        PaceKind::Pose if is_new_state => 0,
        PaceKind::Pose if output.moving || output.is_puppet || output.state == State::Hold => period_us,
        PaceKind::Change if is_new_state || differs_visibly(&last.pose, &output.pose) => period_us,
        PaceKind::Pose | PaceKind::Change => KEEP_ALIVE_US,
        PaceKind::Rate => period_us,
    }
}

/// Whether a receiver would show the difference between two poses, such as that a part of the face is covered now.
fn differs_visibly(one: &Pose, other: &Pose) -> bool {
    let moves = |from: &[f32], to: &[f32], step| from.iter().zip(to).any(|(from, to)| (from - to).abs() >= step);
    moves(&one.coefficients, &other.coefficients, COEFFICIENT_STEP)
        || moves(&one.rotation, &other.rotation, ROTATION_STEP)
        || moves(&one.position_mm, &other.position_mm, POSITION_STEP_MM)
        || !one.visibility.covered().eq(other.visibility.covered())
}

/// Moves a pose the fraction `part` of the way to `target`, but no coefficient by more than `limit`, and the head likewise.
pub fn towards(pose: &Pose, target: &Pose, part: f32, limit: f32) -> Pose {
    let share = |way: f32, limit: f32| part.min(limit / way);
    let mut moved = *target;
    for (value, from) in moved.coefficients.iter_mut().zip(pose.coefficients) {
        let way = *value - from;
        let share = share(way.abs(), limit);
        if share < 1.0 {
            *value = from + way * share;
        }
    }
    let [from, to] = [pose, target].map(|pose| UnitQuaternion::new_normalize(Quaternion::from(pose.rotation)));
    let turn = from.rotation_to(&to);
    let turned = share(turn.angle(), limit * RADIANS_PER_UNIT);
    if turned < 1.0 {
        moved.rotation = (turn.powf(turned) * from).coords.into();
    }
    let [from, to] = [pose, target].map(|pose| Vector3::from(pose.position_mm));
    let gone = share((to - from).norm(), limit * MM_PER_UNIT);
    if gone < 1.0 {
        moved.position_mm = (from + (to - from) * gone).into();
    }
    moved
}

#[cfg(test)]
pub fn test_output(state: State) -> Output {
    let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
    let moving = state == State::Decay;
    Output { state, reason, moving, age_us: 0, ..Output::NEUTRAL }
}

#[cfg(test)]
mod tests {
    use super::*;
    use facewire_face::Adjustment;

    const JAW_OPEN: usize = 17;
    const EYE_BLINK_RIGHT: usize = 7;

    fn output(state: State, jaw_open: f32) -> Output {
        let mut output = test_output(state);
        output.pose.rotation = [0.1, 0.2, 0.3, 0.9];
        output.pose.position_mm = [30.0, 20.0, 600.0];
        output.pose.coefficients[JAW_OPEN] = jaw_open;
        output.pose.coefficients[0] = 1.0;
        output.pose.visibility.left_eye = 0.0;
        output
    }

    fn settings(pace: PaceKind, loss: Loss) -> LinkSettings {
        let mut settings = LinkSettings::default();
        settings.pace.pace = pace;
        settings.pace.loss = loss;
        settings
    }

    #[test]
    fn mirror_gain_and_limits_hold_for_one_link_and_for_the_neutral_face_too() {
        let plain = settings(PaceKind::Pose, Loss::Neutral);
        let mut adjusted = plain.clone();
        adjusted.adjust.mirror = true;
        adjusted.adjust.coefficients[JAW_OPEN] = Adjustment { gain: 2.0, offset: 0.0, min: 0.1, max: 0.7 };
        for (state, jaw_open, want) in [(State::Live, 0.3, 0.6), (State::Live, 0.9, 0.7), (State::Neutral, 0.0, 0.1)] {
            let output = output(state, jaw_open);
            assert_eq!(Shown::default().next(&plain, 4.0, 0, &output), output, "to the last bit");
            let Pose { rotation, position_mm: [x_mm, ..], coefficients, visibility, .. } =
                Shown::default().next(&adjusted, 4.0, 0, &output).pose;
            assert!(visibility.covered().eq(["right_eye"]));
            assert_eq!([JAW_OPEN, 0, EYE_BLINK_RIGHT].map(|place| coefficients[place]), [want, 0.0, 1.0]);
            assert_eq!((rotation, x_mm), ([0.1, -0.2, -0.3, 0.9], -30.0));
        }
    }

    #[test]
    fn a_link_that_holds_shows_the_last_live_pose_and_moves_on_within_the_slew_limit_also_when_the_service_stops() {
        let mut shown = Shown::default();
        let settings = settings(PaceKind::Pose, Loss::Hold);
        let stopping = Output { reason: Reason::Stopping, ..output(State::Neutral, 0.0) };
        for (now_us, (given, want)) in (0..).step_by(50_000).zip([
            (output(State::Neutral, 0.0), (State::Neutral, 0.0, false)),
            (output(State::Live, 0.8), (State::Live, 0.8, false)),
            (output(State::Hold, 0.8), (State::Hold, 0.8, false)),
            (output(State::Decay, 0.4), (State::Hold, 0.8, false)),
            (output(State::Neutral, 0.0), (State::Hold, 0.8, false)),
            // 0.2 in 50 ms, and lost again on the way.
            (output(State::Live, 0.3), (State::Live, 0.6, true)),
            (output(State::Decay, 0.2), (State::Hold, 0.6, false)),
            (output(State::Live, 0.5), (State::Live, 0.5, false)),
            // Nothing is held any more.
            (output(State::Live, 0.9), (State::Live, 0.9, false)),
            (output(State::Neutral, 0.0), (State::Hold, 0.9, false)),
            (stopping.clone(), (State::Neutral, 0.7, true)),
        ]) {
            let Output { state, pose, moving, .. } = shown.next(&settings, 4.0, now_us, &given);
            assert_eq!((state, (pose.coefficients[JAW_OPEN] * 1000.0).round() / 1000.0, moving), want, "{now_us}");
        }
        assert!(shown.held.is_some());
        assert_eq!(Shown::adjusted(&settings, &stopping), stopping, "the last packet is neutral");
    }

    #[test]
    fn a_link_that_holds_never_holds_an_operators_face() {
        let mut shown = Shown::default();
        let settings = settings(PaceKind::Pose, Loss::Hold);
        let puppet = |state, jaw_open| Output { is_puppet: true, ..output(state, jaw_open) };
        for (now_us, given) in (0..).step_by(50_000).zip([
            output(State::Live, 0.3),
            puppet(State::Live, 1.0),
            puppet(State::Hold, 1.0),
            puppet(State::Decay, 0.6),
            puppet(State::Neutral, 0.0),
        ]) {
            assert_eq!(shown.next(&settings, 4.0, now_us, &given), given);
        }
        let lost = [output(State::Live, 0.8), output(State::Neutral, 0.0)];
        let jaws_open = lost.map(|given| shown.next(&settings, 4.0, 400_000, &given).pose.coefficients[JAW_OPEN]);
        assert_eq!(jaws_open, [0.8, 0.8], "the wearer's next face is held again");
    }

    #[test]
    fn after_a_pause_of_the_process_a_held_face_moves_on_no_farther_than_in_100_ms() {
        let mut shown = Shown::default();
        let settings = settings(PaceKind::Pose, Loss::Hold);
        for (now_us, given) in [(0, output(State::Live, 1.0)), (1, output(State::Neutral, 0.0))] {
            shown.next(&settings, 4.0, now_us, &given);
        }
        let moved_on = shown.next(&settings, 4.0, 5_000_000, &output(State::Live, 0.0));
        assert_eq!(moved_on.pose.coefficients[JAW_OPEN], 0.6);
    }

    /// A link that follows its pace, and the times at which it sent.
    struct Link {
        settings: LinkSettings,
        rate_hz: u32,
        pace: Pace,
        sent_ms: Vec<u64>,
    }

    impl Link {
        fn new(kind: PaceKind, loss: Loss, rate_hz: u32) -> Self {
            Self { settings: settings(kind, loss), rate_hz, pace: Pace::default(), sent_ms: Vec::new() }
        }

        /// Offers the output, and returns how long the link waits after that, microseconds.
        fn offer(&mut self, now_ms: u64, output: &Output) -> u64 {
            let (is_sent, wait_us) = self.pace.step(&self.settings, self.rate_hz, 1000 * now_ms, output);
            self.sent_ms.extend(is_sent.then_some(now_ms));
            wait_us
        }

        /// Shows an output for a second, and returns how often it was sent. Every wake-up comes `late_ms` late.
        fn run(&mut self, late_ms: u64, output: &Output) -> usize {
            let mut now_ms = 0;
            while now_ms < 1000 {
                let wait_us = self.offer(now_ms, output);
                assert!((1..=100_000).contains(&wait_us), "{wait_us} at {now_ms}");
                now_ms += wait_us / 1000 + late_ms;
            }
            self.sent_ms.len()
        }
    }

    #[test]
    fn with_pace_pose_every_pose_and_every_change_of_state_is_sent_at_once_and_a_still_face_10_times_a_second() {
        let mut link = Link::new(PaceKind::Pose, Loss::Neutral, 60);
        let followed = Output { followed: true, ..output(State::Live, 0.1) };
        let late = Output { reason: Reason::Late, ..output(State::Hold, 0.2) };
        let outputs = [output(State::Live, 0.1), followed, output(State::Live, 0.2), output(State::Hold, 0.2), late];
        for (now_ms, output) in (0..).zip(&outputs) {
            link.offer(now_ms, output);
        }
        assert_eq!(link.sent_ms, [0, 1, 3, 4]);
        let sent = [State::Live, State::Neutral, State::Hold, State::Decay]
            .map(|state| Link::new(PaceKind::Pose, Loss::Neutral, 50).run(0, &output(state, 0.5)));
        assert_eq!(sent, [10, 10, 50, 50]);
    }

    #[test]
    fn an_operators_face_keeps_to_the_rate_of_every_pace_however_often_it_is_given() {
        for kind in [PaceKind::Pose, PaceKind::Change, PaceKind::Rate] {
            let mut link = Link::new(kind, Loss::Neutral, 20);
            for now_ms in 0..1000 {
                let jaw_open = if now_ms % 2 == 0 { 0.2 } else { 0.8 };
                link.offer(now_ms, &Output { followed: true, is_puppet: true, ..output(State::Live, jaw_open) });
            }
            assert_eq!(link.sent_ms.len(), 20, "{kind:?}");
        }
    }

    #[test]
    fn a_fixed_rate_is_kept_whatever_the_face_does_and_however_late_the_thread_wakes_and_never_catches_up() {
        let link = || Link::new(PaceKind::Rate, Loss::Neutral, 25);
        for state in [State::Live, State::Hold, State::Decay, State::Neutral] {
            let followed = Output { followed: true, ..output(state, 0.5) };
            assert_eq!([0, 3].map(|late_ms| link().run(late_ms, &followed)), [25; 2], "{state:?}");
        }
        let mut link = link();
        for now_ms in [0, 500, 501, 539, 540] {
            link.offer(now_ms, &output(State::Live, 0.5));
        }
        assert_eq!(link.sent_ms, [0, 500, 540]);
    }

    #[test]
    fn with_pace_change_only_visible_changes_are_sent_and_never_faster_than_the_rate() {
        let steady: fn(u64) -> f32 = |_| 0.5;
        let noise: fn(u64) -> f32 = |now_ms| if now_ms % 20 == 0 { 0.5 } else { 0.504 };
        for (jaw_open, count) in [(steady, 10), (noise, 10), (|now_ms| now_ms as f32 * 1e-3, 20)] {
            let mut link = Link::new(PaceKind::Change, Loss::Neutral, 20);
            for now_ms in (0..1000).step_by(10) {
                link.offer(now_ms, &Output { followed: true, ..output(State::Live, jaw_open(now_ms)) });
            }
            assert_eq!(link.sent_ms.len(), count);
        }
        let mut link = Link::new(PaceKind::Change, Loss::Neutral, 50);
        let in_view = output(State::Live, 0.5);
        let mut covered = in_view.clone();
        covered.pose.visibility.mouth = 0.4;
        for (now_ms, output) in [(0, &in_view), (20, &in_view), (40, &covered), (60, &covered)] {
            link.offer(now_ms, output);
        }
        assert_eq!(link.sent_ms, [0, 40], "the mouth is covered now");
        let mut link = Link::new(PaceKind::Change, Loss::Neutral, 50);
        for (now_ms, state) in [(0, State::Live), (10, State::Hold), (20, State::Hold), (21, State::Hold)] {
            link.offer(now_ms, &output(state, 0.5));
        }
        assert_eq!(link.sent_ms, [0, 20], "a new state of a face that stands still");
    }

    #[test]
    fn a_silent_link_sends_one_neutral_packet_and_nothing_more_until_the_face_is_back() {
        for kind in [PaceKind::Pose, PaceKind::Change, PaceKind::Rate] {
            let mut link = Link::new(kind, Loss::Silent, 50);
            let states = [State::Live, State::Decay, State::Neutral, State::Neutral, State::Live, State::Neutral];
            for (now_ms, state) in (0..).step_by(20).zip(states) {
                link.offer(now_ms, &Output { followed: state == State::Live, ..output(state, 0.5) });
            }
            let day_ms = 24 * 3600 * 1000;
            assert!(link.offer(day_ms, &output(State::Neutral, 0.0)) > 1000 * day_ms, "{kind:?}");
            assert_eq!(link.sent_ms, [0, 20, 40, 80, 100], "{kind:?}");
        }
    }
}
