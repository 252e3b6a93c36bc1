//! What one receiver is shown: the output with the link's own adjustments, and what its settings want while no face is
//! followed.

use facewire_packet::{Reason, State};

use super::output::{Output, Pose};
use crate::config::{LinkSettings, Loss};
use crate::solve::{Adjustments, mirror_image};

/// What a link remembers for the time after a loss.
#[derive(Debug, Default)]
pub struct Shown {
    last_live: Option<Pose>,
}

impl Shown {
    /// Returns what the link shows of this output.
    pub fn next(&mut self, settings: &LinkSettings, output: &Output) -> Output {
        let mut shown = output.clone();
        if output.state == State::Live {
            self.last_live = Some(output.pose);
        }
        let is_lost = matches!(output.state, State::Decay | State::Neutral) && output.reason != Reason::Stopping;
        if let (Loss::Hold, true, Some(pose)) = (settings.pace.loss, is_lost, self.last_live) {
            (shown.state, shown.pose, shown.moving) = (State::Hold, pose, false);
        }
        shown.pose = adjusted(shown.pose, &settings.adjust.0);
        shown
    }
}

fn adjusted(mut pose: Pose, adjustments: &Adjustments) -> Pose {
    adjustments.apply(&mut pose.coefficients);
    if adjustments.mirror {
        (pose.rotation, pose.position_mm) = mirror_image(pose.rotation, pose.position_mm);
    }
    pose
}

#[cfg(test)]
#[allow(clippy::indexing_slicing, clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::solve::Adjustment;

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
            assert_eq!(shown.next(&settings(Loss::Neutral), &output(state, 0.3)), output(state, 0.3));
        }
    }

    #[test]
    fn mirror_gain_and_limits_hold_for_one_link_and_for_the_neutral_face_too() {
        let mut settings = settings(Loss::Neutral);
        settings.adjust.0.mirror = true;
        settings.adjust.0.coefficients[JAW_OPEN] = Adjustment { gain: 2.0, offset: 0.0, min: 0.1, max: 0.7 };
        let jaw = |state, jaw_open| Shown::default().next(&settings, &output(state, jaw_open)).pose;
        assert_eq!(jaw(State::Live, 0.3).coefficients[JAW_OPEN], 0.6);
        assert_eq!(jaw(State::Live, 0.9).coefficients[JAW_OPEN], 0.7);
        let neutral = jaw(State::Neutral, 0.0);
        assert_eq!(neutral.coefficients[JAW_OPEN], 0.1);
        assert_eq!(EYE_BLINK.map(|place| neutral.coefficients[place]), [0.0, 1.0]);
        assert_eq!((neutral.rotation, neutral.position_mm[0]), ([0.1, -0.2, -0.3, 0.9], -30.0));
    }

    #[test]
    fn a_link_that_holds_shows_the_last_live_pose_until_the_face_is_back_or_the_service_stops() {
        let (mut shown, settings) = (Shown::default(), settings(Loss::Hold));
        let mut see = |output: &Output| {
            let shown = shown.next(&settings, output);
            (shown.state, shown.pose.coefficients[JAW_OPEN])
        };
        assert_eq!(see(&output(State::Neutral, 0.0)), (State::Neutral, 0.0), "there was no face yet");
        assert_eq!(see(&output(State::Live, 0.8)), (State::Live, 0.8));
        assert_eq!(see(&output(State::Hold, 0.8)), (State::Hold, 0.8));
        assert_eq!(see(&output(State::Decay, 0.4)), (State::Hold, 0.8));
        assert_eq!(see(&output(State::Neutral, 0.0)), (State::Hold, 0.8));
        assert_eq!(see(&output(State::Live, 0.2)), (State::Live, 0.2));
        let stopping = Output { reason: Reason::Stopping, ..output(State::Neutral, 0.0) };
        assert_eq!(see(&stopping), (State::Neutral, 0.0));
    }
}
