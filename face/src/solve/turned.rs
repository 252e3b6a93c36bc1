//! What is shown of a face that turns away from the camera.
//!
//! The farther a head turns, the less the camera sees of the side that is turned away, and the landmarks there are guessed.
//! From [`FADE_DEG`] on, the eye, brow and gaze of that side follow those of the near side more and more. Beyond [`AWAY_DEG`]
//! the pose is wrong, too: then the face counts as turned away.

use super::COEFFS;
use super::correction::smoothstep;
use super::filter::LONGEST_STEP_S;
use super::plausible::{LIDS, index_of, pick, put};

/// Yaw at which the far side begins to follow the near one, and from which on it shows the same, degrees. All angles here are
/// those of the estimated pose, which falls short: in rendered pictures, heads that are turned by 46, 56 and 64 degrees are
/// read as turned by 45, 53 and 59.
const FADE_DEG: [f32; 2] = [44.0, 55.0];
/// Yaw up to which a face that was turned away is back, and beyond which it is turned away, degrees.
const AWAY_DEG: [f32; 2] = [50.0, 56.0];

/// What a near brow or eye shows beside its lids and a far one may show in its place, the person's left first. Both eyes look
/// the same way, so that one looks in while the other looks out.
const BROWS_AND_GAZE: [[usize; 2]; 6] = [
    [index_of("browDownLeft"), index_of("browDownRight")],
    [index_of("browOuterUpLeft"), index_of("browOuterUpRight")],
    [index_of("eyeLookDownLeft"), index_of("eyeLookDownRight")],
    [index_of("eyeLookUpLeft"), index_of("eyeLookUpRight")],
    [index_of("eyeLookInLeft"), index_of("eyeLookOutRight")],
    [index_of("eyeLookOutLeft"), index_of("eyeLookInRight")],
];

fn sides() -> impl Iterator<Item = [usize; 2]> {
    LIDS.into_iter().chain(BROWS_AND_GAZE)
}

/// Lets the far side of a face that is turned by `yaw_deg`, positive to the person's left, follow the near side.
pub(super) fn fade(values: &mut [f32; COEFFS], yaw_deg: f32) {
    let share = smoothstep(yaw_deg.abs(), FADE_DEG);
    if !(share > 0.0) {
        return;
    }
    for side in sides() {
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

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::solve::filter::FRAME_S;

    /// Values that differ from each other.
    fn values() -> [f32; COEFFS] {
        core::array::from_fn(|index| index as f32 / 100.0)
    }

    fn faded(yaw_deg: f32) -> [f32; COEFFS] {
        let mut values = values();
        fade(&mut values, yaw_deg);
        values
    }

    #[test]
    fn the_far_eye_brow_and_gaze_follow_the_near_ones_from_44_degrees_on_and_nothing_else_changes() {
        assert_eq!([faded(44.0), faded(-44.0)], [values(); 2]);
        let before = values();
        for (yaw_deg, far) in [(58.0, 0), (-58.0, 1)] {
            let shown = faded(yaw_deg);
            for side in sides() {
                let near = before[side[1 - far]];
                assert!((shown[side[far]] - near).abs() < 1e-6, "{yaw_deg}: {side:?}");
                assert_eq!(shown[side[1 - far]], near, "{yaw_deg}: {side:?}");
            }
            let others = (0..COEFFS).filter(|index| sides().flatten().all(|side| side != *index));
            assert!(others.into_iter().all(|index| shown[index] == before[index]));
        }
        assert_eq!(faded(f32::NAN), values());
    }

    #[test]
    fn the_far_side_fades_without_a_step() {
        let angles = (0..900).map(|step| 0.1 * step as f32);
        for pair in angles.map(faded).collect::<Vec<_>>().windows(2) {
            let step = pair[0].iter().zip(&pair[1]).map(|(one, other)| (one - other).abs()).fold(0.0, f32::max);
            assert!(step < 0.01, "{step}");
        }
    }

    #[test]
    fn a_face_is_turned_away_beyond_56_degrees_and_is_back_at_50_or_after_a_gap() {
        let mut away = Away::default();
        let mut is_away = |yaw_deg: f32| away.step(yaw_deg, FRAME_S);
        let seen = [55.0, 57.0, 55.0, 51.0, 49.0, 55.0, -57.0, -51.0, -49.0].map(&mut is_away);
        assert_eq!(seen, [false, true, true, true, false, false, true, true, false]);
        assert!(!is_away(f32::NAN));
        assert!(away.step(57.0, FRAME_S) && !away.step(55.0, 10.0), "nothing is known after a gap");
    }
}
