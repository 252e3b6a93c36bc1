//! What is shown of a face that turns away from the camera.
//!
//! The farther a head turns, the less the camera sees of the side that is turned away, and the landmarks there are guessed. From
//! [`FADE_DEG`] on, the eye, brow and gaze of that side follow those of the near side more and more. Beyond [`AWAY_DEG`] the
//! pose is wrong, too: then the face counts as turned away.

use super::correction::smoothstep;
use super::filter::LONGEST_STEP_S;
use super::plausible::{pick, put};
use super::{COEFFS, plausible::index_of};

/// Yaw at which the far side begins to follow the near one, and from which on it shows the same, degrees.
const FADE_DEG: [f32; 2] = [45.0, 58.0];
/// Yaw up to which a face that was turned away is back, and beyond which it is turned away, degrees.
const AWAY_DEG: [f32; 2] = [54.0, 60.0];

/// What a near eye or brow shows and a far one may show in its place, the person's left first. Both eyes look the same way, so
/// that one looks in while the other looks out.
const SIDES: [[usize; 2]; 9] = [
    [index_of("browDownLeft"), index_of("browDownRight")],
    [index_of("browOuterUpLeft"), index_of("browOuterUpRight")],
    [index_of("eyeBlinkLeft"), index_of("eyeBlinkRight")],
    [index_of("eyeSquintLeft"), index_of("eyeSquintRight")],
    [index_of("eyeWideLeft"), index_of("eyeWideRight")],
    [index_of("eyeLookDownLeft"), index_of("eyeLookDownRight")],
    [index_of("eyeLookUpLeft"), index_of("eyeLookUpRight")],
    [index_of("eyeLookInLeft"), index_of("eyeLookOutRight")],
    [index_of("eyeLookOutLeft"), index_of("eyeLookInRight")],
];

/// Lets the far side of a face that is turned by `yaw_deg`, positive to the person's left, follow the near side.
pub(super) fn fade(values: &mut [f32; COEFFS], yaw_deg: f32) {
    let share = smoothstep(yaw_deg.abs(), FADE_DEG);
    if !(share > 0.0) {
        return;
    }
    for side in SIDES {
        let [left, right] = pick(values, side);
        let shown =
            if yaw_deg > 0.0 { [left + share * (right - left), right] } else { [left, right + share * (left - right)] };
        put(values, side, shown);
    }
}

/// Whether the face is turned away, with hysteresis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Away(bool);

impl Away {
    /// Judges a face `dt_s` after the last one. After a gap nothing is known of the past.
    pub(super) fn step(&mut self, yaw_deg: f32, dt_s: f32) -> bool {
        let was_away = self.0 && (0.0..=LONGEST_STEP_S).contains(&dt_s);
        let [back, away] = AWAY_DEG;
        self.0 = yaw_deg.abs() > if was_away { back } else { away };
        self.0
    }
}
