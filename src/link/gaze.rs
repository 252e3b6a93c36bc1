//! The rotation of the eyes, from the coefficients that say where they look.
//!
//! A coefficient of 1 stands for 35 degrees. This is what ARKit means by it: in a public recording of 180 packets from
//! the iPhone app Live Link Face (`dao.gesichter` of the project LLV), which has coefficients and rotations of the eyes
//! side by side, the angle is 0.61 radians times the difference of the opposed coefficients, with a correlation of 1.000
//! in all four directions.

use facewire_packet::BLENDSHAPE_COUNT;

use super::head::Angles;

/// The angle that a coefficient of 1 stands for, radians.
pub const FULL: f32 = 35.0 * std::f32::consts::PI / 180.0;
/// From this coefficient of the blink on, a lid is shut and hides where the eye looks.
const SHUT: f32 = 0.75;

/// The eyes of the wearer. An eye whose lid is shut keeps its direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Gaze {
    /// The person's left eye; the roll is 0.
    pub left: Angles,
    /// The person's right eye; the roll is 0.
    pub right: Angles,
}

impl Gaze {
    /// Follows the coefficients of a pose, in the order of [`facewire_packet::BLENDSHAPES`].
    pub fn follow(&mut self, coefficients: &[f32; BLENDSHAPE_COUNT]) {
        let [left_blink, left_down, left_in, left_out, left_up, _, _, right @ ..] = coefficients;
        let [right_blink, right_down, right_in, right_out, right_up, ..] = right;
        turn(&mut self.left, *left_blink, left_out - left_in, left_up - left_down);
        turn(&mut self.right, *right_blink, right_in - right_out, right_up - right_down);
    }

    /// The directions of the left and of the right eye as parts of the full angle: `[to the person's left, up]`.
    #[must_use]
    pub fn parts(&self) -> [[f32; 2]; 2] {
        [self.left, self.right].map(|eye| [eye.yaw / FULL, eye.pitch / FULL])
    }
}

fn turn(eye: &mut Angles, blink: f32, left: f32, up: f32) {
    if blink < SHUT {
        *eye = Angles { yaw: FULL * left, pitch: FULL * up, roll: 0.0 };
    }
}

/// Changes coefficients by their names, for tests.
#[cfg(test)]
pub fn set(coefficients: &mut [f32; BLENDSHAPE_COUNT], values: &[(&str, f32)]) {
    for (name, value) in values {
        let mut named = facewire_packet::BLENDSHAPES.iter().zip(coefficients.iter_mut());
        if let Some((_, coefficient)) = named.find(|(known, _)| *known == name) {
            *coefficient = *value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaze(values: &[(&str, f32)]) -> Gaze {
        let (mut gaze, mut coefficients) = (Gaze::default(), [0.0; BLENDSHAPE_COUNT]);
        set(&mut coefficients, values);
        gaze.follow(&coefficients);
        gaze
    }

    fn degrees(gaze: &Gaze) -> [i32; 4] {
        #[expect(clippy::cast_possible_truncation, reason = "angles are small")]
        [gaze.left.yaw, gaze.left.pitch, gaze.right.yaw, gaze.right.pitch]
            .map(|angle| angle.to_degrees().round() as i32)
    }

    #[test]
    fn eyes_turn_by_35_degrees_for_a_coefficient_of_1() {
        assert_eq!(degrees(&gaze(&[("eyeLookOutLeft", 1.0), ("eyeLookInRight", 1.0)])), [35, 0, 35, 0]);
        assert_eq!(degrees(&gaze(&[("eyeLookInLeft", 1.0), ("eyeLookOutRight", 1.0)])), [-35, 0, -35, 0]);
        assert_eq!(degrees(&gaze(&[("eyeLookUpLeft", 1.0), ("eyeLookDownRight", 0.6)])), [0, 35, 0, -21]);
    }

    /// A frame of the real app, whose coefficients are whole percent: its eyes turned by 2.44, -1.67 and 6.03 degrees.
    #[test]
    fn the_angles_agree_with_those_of_an_iphone() {
        let values =
            [("eyeLookDownLeft", 0.17), ("eyeLookDownRight", 0.17), ("eyeLookInRight", 0.06), ("eyeLookInLeft", 0.04)];
        let Gaze { left, right } = gaze(&values);
        for (ours, theirs) in [(right.yaw, 2.440), (left.yaw, -1.666), (-left.pitch, 6.035), (-right.pitch, 6.030)] {
            assert!((ours.to_degrees() - theirs).abs() < 0.5, "{} {theirs}", ours.to_degrees());
        }
    }

    #[test]
    fn an_eye_whose_lid_is_shut_keeps_its_direction_and_the_other_one_moves_on() {
        let mut coefficients = [0.0; BLENDSHAPE_COUNT];
        set(&mut coefficients, &[("eyeLookUpLeft", 1.0), ("eyeLookUpRight", 1.0)]);
        let mut gaze = Gaze::default();
        gaze.follow(&coefficients);
        set(&mut coefficients, &[("eyeBlinkLeft", 1.0), ("eyeLookUpLeft", 0.0), ("eyeLookUpRight", 0.0)]);
        gaze.follow(&coefficients);
        assert_eq!(degrees(&gaze), [0, 35, 0, 0]);
        set(&mut coefficients, &[("eyeBlinkLeft", 0.7)]);
        gaze.follow(&coefficients);
        assert_eq!(degrees(&gaze), [0, 0, 0, 0]);
    }
}
