//! When a link sends.
//!
//! Every pace sends at least every 100 ms, because receivers go neutral by themselves after 500 ms without a packet. The
//! only exception is a link whose `loss` is "silent", while the face is neutral because no face is followed.
//! Time is an argument: a clock that stands still or steps back delays packets and does no other harm.

use facewire_packet::{Reason, State};

use super::output::{Output, Pose};
use crate::config::{LinkSettings, Loss, PaceKind};

/// Longest time between two packets, microseconds.
const KEEP_ALIVE_US: u64 = 100_000;
/// Smallest visible change of a coefficient.
const COEFFICIENT_STEP: f32 = 0.005;
/// Smallest visible change of a component of the head's rotation quaternion: the sine of half of 0.5 degrees.
const ROTATION_STEP: f32 = 0.004_363;
/// Smallest visible change of the head's position, millimetres.
const POSITION_STEP_MM: f32 = 2.0;

/// The pace of a link.
#[derive(Debug, Clone, Copy)]
pub struct Pace {
    kind: PaceKind,
    period_us: u64,
    loss: Loss,
}

/// What a link sent last, and when.
#[derive(Debug)]
pub struct Sent {
    at_us: u64,
    state: State,
    reason: Reason,
    pose: Pose,
}

impl Pace {
    /// Returns the pace of a link; `send_hz` is the rate of `[send]`.
    pub fn new(settings: &LinkSettings, send_hz: u32) -> Self {
        Self {
            kind: settings.pace.pace,
            period_us: 1_000_000 / u64::from(settings.rate_hz(send_hz).max(1)),
            loss: settings.pace.loss,
        }
    }

    /// Whether the output is due.
    pub fn is_due(self, last: Option<&Sent>, now_us: u64, output: &Output) -> bool {
        let Some(last) = last else { return true };
        let followed = output.followed && self.kind == PaceKind::Pose;
        followed || now_us.saturating_sub(last.at_us) >= self.interval_us(last, output)
    }

    /// How long to wait before [`Pace::is_due`] is asked again, if no pose or fault comes first.
    pub fn wait_us(self, last: Option<&Sent>, now_us: u64, output: &Output) -> u64 {
        let Some(last) = last else { return 0 };
        let left_us = self.interval_us(last, output).saturating_sub(now_us.saturating_sub(last.at_us));
        if output.moving { left_us.min(self.period_us) } else { left_us }
    }

    /// Notes that the output is sent.
    pub fn sent(self, last: Option<&Sent>, now_us: u64, output: &Output) -> Sent {
        // A fixed rate keeps its grid, so that late wake-ups do not add up.
        let grid_us =
            last.filter(|_| self.kind == PaceKind::Rate).map(|last| last.at_us.saturating_add(self.period_us));
        let is_on_time = |grid_us: &u64| now_us.checked_sub(*grid_us).is_some_and(|late_us| late_us < self.period_us);
        let at_us = grid_us.filter(is_on_time).unwrap_or(now_us);
        Sent { at_us, state: output.state, reason: output.reason, pose: output.pose }
    }

    /// Time from the last packet to one that carries this output.
    fn interval_us(self, last: &Sent, output: &Output) -> u64 {
        let is_new_state = (last.state, last.reason) != (output.state, output.reason);
        if self.loss == Loss::Silent && output.state == State::Neutral && last.state == State::Neutral {
            return u64::MAX;
        }
        match self.kind {
            PaceKind::Pose if is_new_state => 0,
            PaceKind::Pose if output.moving || output.state == State::Hold => self.period_us,
            PaceKind::Change if is_new_state || is_visible(&last.pose, &output.pose) => self.period_us,
            PaceKind::Pose | PaceKind::Change => KEEP_ALIVE_US,
            PaceKind::Rate => self.period_us,
        }
    }
}

/// Whether a receiver would show the difference between two poses.
fn is_visible(from: &Pose, to: &Pose) -> bool {
    let moves = |from: &[f32], to: &[f32], step| from.iter().zip(to).any(|(from, to)| (from - to).abs() >= step);
    moves(&from.coefficients, &to.coefficients, COEFFICIENT_STEP)
        || moves(&from.rotation, &to.rotation, ROTATION_STEP)
        || moves(&from.position_mm, &to.position_mm, POSITION_STEP_MM)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1000;

    fn output(state: State, smile: f32) -> Output {
        let mut pose = Pose::NEUTRAL;
        pose.coefficients[23] = smile;
        let reason = if state == State::Live { Reason::None } else { Reason::Late };
        Output { state, reason, pose, age_us: 0, capture_us: 0, followed: false, moving: state == State::Decay }
    }

    /// A link that follows its pace, and the times at which it sent.
    struct Link {
        pace: Pace,
        last: Option<Sent>,
        sent_us: Vec<u64>,
    }

    impl Link {
        fn new(kind: PaceKind, rate_hz: u32) -> Self {
            let mut settings = LinkSettings::default();
            settings.pace.pace = kind;
            Self { pace: Pace::new(&settings, rate_hz), last: None, sent_us: Vec::new() }
        }

        /// Offers the output, and returns how long the link waits after that.
        fn offer(&mut self, now_us: u64, output: &Output) -> u64 {
            if self.pace.is_due(self.last.as_ref(), now_us, output) {
                self.last = Some(self.pace.sent(self.last.as_ref(), now_us, output));
                self.sent_us.push(now_us);
            }
            self.pace.wait_us(self.last.as_ref(), now_us, output)
        }

        /// Shows the outputs of a second. Every wake-up comes `late_us` late.
        fn run(&mut self, late_us: u64, output: impl Fn(u64) -> Output) -> usize {
            let mut now_us = 0;
            while now_us < 1_000_000 {
                let wait_us = self.offer(now_us, &output(now_us));
                assert!((1..=KEEP_ALIVE_US).contains(&wait_us), "{wait_us} at {now_us}");
                now_us += wait_us + late_us;
            }
            self.sent_us.len()
        }
    }

    #[test]
    fn with_pace_pose_every_pose_and_every_change_of_state_is_sent_at_once() {
        let mut link = Link::new(PaceKind::Pose, 60);
        for (at_us, output) in [
            (0, output(State::Live, 0.1)),
            (MS, Output { followed: true, ..output(State::Live, 0.1) }),
            (2 * MS, output(State::Live, 0.2)),
            (3 * MS, output(State::Hold, 0.2)),
            (4 * MS, Output { reason: Reason::NoFace, ..output(State::Hold, 0.2) }),
        ] {
            link.offer(at_us, &output);
        }
        assert_eq!(link.sent_us, [0, MS, 3 * MS, 4 * MS]);
    }

    #[test]
    fn with_pace_pose_a_still_face_is_sent_10_times_per_second_and_hold_and_decay_at_the_rate() {
        let sent = [State::Live, State::Neutral, State::Hold, State::Decay]
            .map(|state| Link::new(PaceKind::Pose, 50).run(0, |_| output(state, 0.5)));
        assert_eq!(sent, [10, 10, 50, 50]);
    }

    #[test]
    fn a_fixed_rate_is_kept_whatever_the_face_does_and_however_late_the_thread_wakes_and_never_catches_up() {
        for state in [State::Live, State::Hold, State::Decay, State::Neutral] {
            for late_us in [0, 3 * MS] {
                let followed = Output { followed: true, ..output(state, 0.5) };
                assert_eq!(Link::new(PaceKind::Rate, 25).run(late_us, |_| followed.clone()), 25, "{state:?} {late_us}");
            }
        }
        let mut link = Link::new(PaceKind::Rate, 50);
        for ms in [0, 500, 501, 519, 520] {
            link.offer(ms * MS, &output(State::Live, 0.5));
        }
        assert_eq!(link.sent_us, [0, 500 * MS, 520 * MS]);
    }

    #[test]
    fn with_pace_change_only_visible_changes_are_sent_and_never_faster_than_the_rate() {
        let send = |smile: fn(u64) -> f32| {
            let mut link = Link::new(PaceKind::Change, 20);
            for now_us in (0..1_000_000).step_by(10_000) {
                link.offer(now_us, &Output { followed: true, ..output(State::Live, smile(now_us)) });
            }
            link.sent_us.len()
        };
        assert_eq!(send(|_| 0.5), 10, "nothing moves");
        assert_eq!(send(|now_us| if now_us % 20_000 == 0 { 0.5 } else { 0.504 }), 10, "noise");
        assert_eq!(send(|now_us| now_us as f32 * 1e-6), 20, "a slow smile");
        let mut link = Link::new(PaceKind::Change, 50);
        for (now_us, state) in [(0, State::Live), (10, State::Hold), (20, State::Hold), (21, State::Hold)] {
            link.offer(now_us * MS, &output(state, 0.5));
        }
        assert_eq!(link.sent_us, [0, 20 * MS], "a new state of a face that stands still");
    }

    #[test]
    fn a_silent_link_sends_one_neutral_packet_and_nothing_more_until_the_face_is_back() {
        for kind in [PaceKind::Pose, PaceKind::Change, PaceKind::Rate] {
            let mut link = Link::new(kind, 50);
            link.pace.loss = Loss::Silent;
            let states = [State::Live, State::Decay, State::Neutral, State::Neutral, State::Live];
            for (now_us, state) in (0..).step_by(20_000).zip(states) {
                link.offer(now_us, &Output { followed: state == State::Live, ..output(state, 0.5) });
            }
            assert_eq!(link.sent_us, [0, 20 * MS, 40 * MS, 80 * MS], "{kind:?}");
            link.offer(100 * MS, &output(State::Neutral, 0.0));
            let day_us = 24 * 3600 * 1000 * MS;
            assert!(link.offer(day_us, &output(State::Neutral, 0.0)) > day_us && link.sent_us.len() == 5, "{kind:?}");
        }
    }
}
