//! The rotation of the head and of the eyes, in the conventions of other programs.
//!
//! facewire's axes are those of `ARKit`'s face: x to the person's left, y up, z out of the face. The angles here belong to
//! `Ry(yaw) Rx(-pitch) Rz(roll)`, the order in which Unity and Unreal compose theirs: the head tilts first, nods next
//! and turns last.

use crate::{BLENDSHAPE_COUNT, FULL_GAZE_DEG};

/// [`FULL_GAZE_DEG`] in radians.
pub const FULL_GAZE: f32 = FULL_GAZE_DEG * std::f32::consts::PI / 180.0;
/// From this coefficient of the blink on, a lid is shut and hides where the eye looks.
const SHUT: f32 = 0.75;

/// Angles of a rotation, radians: a turn to the person's left, a nod upwards and a tilt to the right shoulder are positive.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Angles {
    pub yaw: f32,
    pub pitch: f32,
    pub roll: f32,
}

impl Angles {
    pub fn of([x, y, z, w]: [f32; 4]) -> Self {
        // The columns of the rotation matrix are the axes of the face. `forward` is the axis out of the face; `left_up`
        // and `up_up` are the upward components of the other two.
        let forward = [2.0 * (x * z + y * w), 2.0 * (y * z - x * w), 1.0 - 2.0 * (x * x + y * y)];
        let (left_up, up_up) = (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z));
        let [forward_x, forward_y, forward_z] = forward;
        let pitch = forward_y.clamp(-1.0, 1.0).asin();
        // Adding 0 turns -0 into 0.
        Self { yaw: forward_x.atan2(forward_z) + 0.0, pitch: pitch + 0.0, roll: left_up.atan2(up_up) + 0.0 }
    }

    /// The angles of Live Link and VRCFaceTracking: positive to the person's right, downwards and to the left shoulder.
    pub fn reversed(self) -> [f32; 3] {
        [0.0 - self.yaw, 0.0 - self.pitch, 0.0 - self.roll]
    }

    /// The rotation as a unit quaternion x, y, z, w; the roll is left out.
    pub fn quaternion_without_roll(self) -> [f32; 4] {
        let ((sin_y, cos_y), (sin_x, cos_x)) = ((0.5 * self.yaw).sin_cos(), (-0.5 * self.pitch).sin_cos());
        [cos_y * sin_x, sin_y * cos_x, -sin_y * sin_x, cos_y * cos_x]
    }
}

/// Returns the rotation in Unity's left-handed axes: x to the person's right, y up, z out of the face.
pub fn unity([x, y, z, w]: [f32; 4]) -> [f32; 4] {
    // Adding 0 turns -0 into 0.
    [x, 0.0 - y, 0.0 - z, w]
}

/// The rotation of the eyes, without roll. An eye whose lid is shut keeps its direction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Gaze {
    pub left: Angles,
    pub right: Angles,
}

impl Gaze {
    pub fn follow(&mut self, coefficients: &[f32; BLENDSHAPE_COUNT]) {
        let [left_blink, left_down, left_in, left_out, left_up, _, _, right @ ..] = coefficients;
        let [right_blink, right_down, right_in, right_out, right_up, ..] = right;
        let turn = |eye: &mut Angles, blink: f32, left: f32, up: f32| {
            if blink < SHUT {
                *eye = Angles { yaw: FULL_GAZE * left, pitch: FULL_GAZE * up, roll: 0.0 };
            }
        };
        turn(&mut self.left, *left_blink, left_out - left_in, left_up - left_down);
        turn(&mut self.right, *right_blink, right_in - right_out, right_up - right_down);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::super::testing::{face, near};
    use super::*;
    use crate::yaw_pitch_roll_deg;

    #[test]
    fn the_angles_compose_to_the_rotation_again() {
        let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
        for [yaw, pitch, roll] in
            [[0.5, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, -0.2], [0.5, 0.3, -0.2], [-1.2, -0.7, 0.4], [2.5, 0.1, 1.0]]
        {
            let eye = about(Vector3::y_axis(), yaw) * about(Vector3::x_axis(), -pitch);
            let angles = Angles::of((eye * about(Vector3::z_axis(), roll)).coords.into());
            assert!(near(&[angles.yaw, angles.pitch, angles.roll], &[yaw, pitch, roll]), "{angles:?}");
            let solver = yaw_pitch_roll_deg((eye * about(Vector3::z_axis(), roll)).coords.into());
            let is_single = [yaw, pitch, roll].iter().filter(|angle| **angle != 0.0).count() == 1;
            assert!(!is_single || near(&solver.map(f32::to_radians), &[yaw, pitch, roll]), "as in the solver");
            assert!(near(&angles.quaternion_without_roll(), &<[f32; 4]>::from(eye.coords)));
        }
    }

    #[test]
    fn eyes_turn_by_35_degrees_for_a_coefficient_of_1_as_an_iphone_shows_them_and_a_shut_one_keeps_its_direction() {
        let mut gaze = Gaze::default();
        for (look, tolerance_deg, want_deg) in [
            (&[("eyeLookOutLeft", 1.0), ("eyeLookInRight", 1.0)][..], 1e-3, [35.0, 0.0, 35.0, 0.0]),
            (&[("eyeLookInLeft", 1.0), ("eyeLookOutRight", 1.0)], 1e-3, [-35.0, 0.0, -35.0, 0.0]),
            (&[("eyeLookUpLeft", 1.0), ("eyeLookDownRight", 0.6)], 1e-3, [0.0, 35.0, 0.0, -21.0]),
            (&[("eyeBlinkLeft", 1.0)], 1e-3, [0.0, 35.0, 0.0, 0.0]),
            (&[("eyeBlinkLeft", 0.7)], 1e-3, [0.0; 4]),
            // A frame of the real app, whose coefficients are whole percent.
            (
                &[
                    ("eyeLookDownLeft", 0.17),
                    ("eyeLookDownRight", 0.17),
                    ("eyeLookInRight", 0.06),
                    ("eyeLookInLeft", 0.04),
                ],
                0.5,
                [-1.666, -6.035, 2.440, -6.030],
            ),
        ] {
            gaze.follow(&face(look).coefficients);
            let found = [gaze.left.yaw, gaze.left.pitch, gaze.right.yaw, gaze.right.pitch].map(f32::to_degrees);
            let is_near = found.iter().zip(want_deg).all(|(found, want)| (found - want).abs() < tolerance_deg);
            assert!(is_near, "{look:?} {found:?}");
        }
    }
}
