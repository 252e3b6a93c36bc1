//! What links send: the face as the failsafe shows it at one moment, and what one receiver is shown of it: the output with
//! the link's own adjustments, and what its settings want while no face is followed.

use facewire_face::Adjustments;
use facewire_face::stages::mirror_image;
use facewire_packet::{BLENDSHAPE_COUNT, NeutralFace, Reason, State};

use crate::config::{LinkSettings, Loss};

/// A pose of the face. The fields are those of [`facewire_packet::Packet`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Head rotation, unit quaternion x y z w. It is the identity when the head faces the camera.
    pub rotation: [f32; 4],
    /// Head position in the camera's frame, millimetres.
    pub position_mm: [f32; 3],
    /// Blendshape coefficients, 0..=1, in the order of [`facewire_packet::BLENDSHAPES`].
    pub coefficients: [f32; BLENDSHAPE_COUNT],
    /// The neutral face from which the coefficients are measured.
    pub neutral_face: NeutralFace,
}

impl Pose {
    /// No expression, facing the camera.
    pub const NEUTRAL: Self = Self {
        rotation: [0.0, 0.0, 0.0, 1.0],
        position_mm: [0.0; 3],
        coefficients: [0.0; BLENDSHAPE_COUNT],
        neutral_face: NeutralFace::Mean,
    };
}

/// The output of the failsafe.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// How far the pose can be trusted.
    pub state: State,
    /// Why the face is not live; [`Reason::None`] while it is.
    pub reason: Reason,
    /// The pose to show.
    pub pose: Pose,
    /// Time since the capture of the last pose that the output followed; `u64::MAX` if there was none.
    pub age_us: u64,
    /// Capture time of that pose on the monotonic clock; 0 if there was none.
    pub capture_us: u64,
    /// Whether the output follows a pose that has just arrived.
    pub followed: bool,
    /// Whether the output moves on without a new pose, as it does during a decay or a ramp.
    pub moving: bool,
}

/// What a link remembers for the time after a loss.
#[derive(Debug, Default)]
pub struct Shown {
    last_live: Option<Pose>,
    /// The pose that is shown in place of that of the output, and since when.
    held: Option<(Pose, u64)>,
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
        let is_held = is_lost && settings.pace.loss == Loss::Hold;
        if let (true, Some(pose)) = (is_held, self.held.map(|(pose, _)| pose).or(self.last_live)) {
            (shown.state, shown.pose, shown.moving) = (State::Hold, pose, false);
            self.held = Some((pose, now_us));
        } else if let Some((pose, since_us)) = self.held.take() {
            let elapsed_s = now_us.saturating_sub(since_us) as f32 * 1e-6;
            shown.pose = pose.towards(&output.pose, 1.0, slew_per_s * elapsed_s);
            shown.moving = shown.pose != output.pose;
            self.held = shown.moving.then_some((shown.pose, now_us));
        }
        shown.pose = adjusted(shown.pose, &settings.adjust);
        shown
    }

    /// Returns this output as the last one that the link shows.
    pub fn last(settings: &LinkSettings, output: &Output) -> Output {
        Output { pose: adjusted(output.pose, &settings.adjust), ..output.clone() }
    }

    /// Whether a pose is shown in place of that of the output.
    pub fn is_held(&self) -> bool {
        self.held.is_some()
    }
}

fn adjusted(mut pose: Pose, adjustments: &Adjustments) -> Pose {
    adjustments.apply(&mut pose.coefficients);
    if adjustments.mirror {
        (pose.rotation, pose.position_mm) = mirror_image(pose.rotation, pose.position_mm);
    }
    pose
}

/// Returns a neutral output in this state.
#[cfg(test)]
pub fn test_output(state: State) -> Output {
    let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
    Output { state, reason, pose: Pose::NEUTRAL, age_us: 0, capture_us: 0, followed: true, moving: false }
}

#[cfg(test)]
mod tests {
    use super::*;
    use facewire_face::Adjustment;

    const JAW_OPEN: usize = 17;
    const EYE_BLINK: [usize; 2] = [0, 7];

    fn output(state: State, jaw_open: f32) -> Output {
        let mut pose = Pose { rotation: [0.1, 0.2, 0.3, 0.9], position_mm: [30.0, 20.0, 600.0], ..Pose::NEUTRAL };
        (pose.coefficients[JAW_OPEN], pose.coefficients[EYE_BLINK[0]]) = (jaw_open, 1.0);
        let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
        Output { state, reason, pose, age_us: 0, capture_us: 0, followed: false, moving: state == State::Decay }
    }

    fn settings(loss: Loss) -> LinkSettings {
        let mut settings = LinkSettings::default();
        settings.pace.loss = loss;
        settings
    }

    #[test]
    fn without_settings_of_its_own_a_link_shows_every_output_to_the_last_bit() {
        let mut shown = Shown::default();
        for state in [State::Live, State::Hold, State::Decay, State::Neutral] {
            assert_eq!(shown.next(&settings(Loss::Neutral), 4.0, 0, &output(state, 0.3)), output(state, 0.3));
        }
    }

    #[test]
    fn mirror_gain_and_limits_hold_for_one_link_and_for_the_neutral_face_too() {
        let mut settings = settings(Loss::Neutral);
        settings.adjust.mirror = true;
        settings.adjust.coefficients[JAW_OPEN] = Adjustment { gain: 2.0, offset: 0.0, min: 0.1, max: 0.7 };
        let jaw = |state, jaw_open| Shown::default().next(&settings, 4.0, 0, &output(state, jaw_open)).pose;
        assert_eq!(jaw(State::Live, 0.3).coefficients[JAW_OPEN], 0.6);
        assert_eq!(jaw(State::Live, 0.9).coefficients[JAW_OPEN], 0.7);
        let neutral = jaw(State::Neutral, 0.0);
        assert_eq!(neutral.coefficients[JAW_OPEN], 0.1);
        assert_eq!(EYE_BLINK.map(|place| neutral.coefficients[place]), [0.0, 1.0]);
        assert_eq!((neutral.rotation, neutral.position_mm[0]), ([0.1, -0.2, -0.3, 0.9], -30.0));
    }

    #[test]
    fn a_link_that_holds_shows_the_last_live_pose_and_moves_on_within_the_slew_limit() {
        let (mut shown, settings) = (Shown::default(), settings(Loss::Hold));
        let mut now_us = 0;
        let mut see = |output: &Output| {
            now_us += 50_000;
            let shown = shown.next(&settings, 4.0, now_us, output);
            (shown.state, (shown.pose.coefficients[JAW_OPEN] * 1000.0).round(), shown.moving)
        };
        assert_eq!(see(&output(State::Neutral, 0.0)), (State::Neutral, 0.0, false), "there was no face yet");
        assert_eq!(see(&output(State::Live, 0.8)), (State::Live, 800.0, false));
        assert_eq!(see(&output(State::Hold, 0.8)), (State::Hold, 800.0, false));
        assert_eq!(see(&output(State::Decay, 0.4)), (State::Hold, 800.0, false));
        assert_eq!(see(&output(State::Neutral, 0.0)), (State::Hold, 800.0, false));
        assert_eq!(see(&output(State::Live, 0.3)), (State::Live, 600.0, true), "0.2 in 50 ms");
        assert_eq!(see(&output(State::Decay, 0.2)), (State::Hold, 600.0, false), "lost again on the way");
        assert_eq!(see(&output(State::Live, 0.5)), (State::Live, 500.0, false));
        assert_eq!(see(&output(State::Live, 0.9)), (State::Live, 900.0, false), "nothing is held any more");
    }

    #[test]
    fn a_held_pose_moves_to_neutral_when_the_service_stops_and_the_last_packet_is_neutral() {
        let (mut shown, settings) = (Shown::default(), settings(Loss::Hold));
        shown.next(&settings, 4.0, 0, &output(State::Live, 0.8));
        shown.next(&settings, 4.0, 0, &output(State::Neutral, 0.0));
        let stopping = Output { reason: Reason::Stopping, ..output(State::Neutral, 0.0) };
        let seen = shown.next(&settings, 4.0, 100_000, &stopping);
        assert!((seen.pose.coefficients[JAW_OPEN] - 0.4).abs() < 1e-6 && shown.is_held());
        assert_eq!(Shown::last(&settings, &stopping).pose.coefficients[JAW_OPEN], 0.0);
    }
}
