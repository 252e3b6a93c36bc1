//! The head's rotation and that of an eye, as receivers of other programs count them.
//!
//! facewire's axes are those of ARKit's face: x to the person's left, y up, z out of the face. The angles here belong to
//! `Ry(yaw) Rx(-pitch) Rz(roll)`, the order in which Unity and Unreal compose theirs: the head tilts first, nods next
//! and turns last. Positive are a turn to the person's left, a nod upwards and a tilt to the person's right shoulder.

/// Angles of a rotation, radians.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Angles {
    /// Turn to the person's left.
    pub yaw: f32,
    /// Nod upwards.
    pub pitch: f32,
    /// Tilt to the person's right shoulder.
    pub roll: f32,
}

impl Angles {
    /// Returns the angles of a unit quaternion x, y, z, w.
    #[must_use]
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
    #[must_use]
    pub fn reversed(self) -> [f32; 3] {
        [0.0 - self.yaw, 0.0 - self.pitch, 0.0 - self.roll]
    }

    /// The rotation as a unit quaternion x, y, z, w; the roll is left out.
    #[must_use]
    pub fn quaternion_without_roll(self) -> [f32; 4] {
        let ((sin_y, cos_y), (sin_x, cos_x)) = ((0.5 * self.yaw).sin_cos(), (-0.5 * self.pitch).sin_cos());
        [cos_y * sin_x, sin_y * cos_x, -sin_y * sin_x, cos_y * cos_x]
    }
}

/// Returns the rotation in Unity's left-handed axes: x to the person's right, y up, z out of the face.
#[must_use]
pub fn unity([x, y, z, w]: [f32; 4]) -> [f32; 4] {
    // Adding 0 turns -0 into 0.
    [x, 0.0 - y, 0.0 - z, w]
}

/// Rotations of a head that does one thing, for tests: unit quaternions x, y, z, w.
#[cfg(test)]
pub mod poses {
    /// 30 degrees to the person's left.
    pub const LEFT: [f32; 4] = [0.0, 0.258_819, 0.0, 0.965_926];
    /// 20 degrees down.
    pub const DOWN: [f32; 4] = [0.173_648, 0.0, 0.0, 0.984_808];
    /// 10 degrees to the right shoulder.
    pub const TILTED: [f32; 4] = [0.0, 0.0, 0.087_156, 0.996_195];
}

#[cfg(test)]
mod tests {
    use nalgebra::{Quaternion, UnitQuaternion, Vector3};

    use super::*;
    use crate::solve::HeadPose;

    fn degrees(angles: Angles) -> [f32; 3] {
        [angles.yaw, angles.pitch, angles.roll].map(f32::to_degrees)
    }

    fn near(a: &[f32], b: &[f32]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3)
    }

    #[test]
    fn one_movement_has_the_same_sign_as_in_the_solver() {
        for (rotation, want) in
            [(poses::LEFT, [30.0, 0.0, 0.0]), (poses::DOWN, [0.0, -20.0, 0.0]), (poses::TILTED, [0.0, 0.0, 10.0])]
        {
            let solver = HeadPose::from_rotation(rotation, [0.0; 3]);
            assert!(near(&degrees(Angles::of(rotation)), &want), "{:?}", degrees(Angles::of(rotation)));
            assert!(near(&[solver.yaw_deg, solver.pitch_deg, solver.roll_deg], &want), "{solver:?}");
        }
    }

    #[test]
    fn the_angles_compose_to_the_rotation_again() {
        let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
        for [yaw, pitch, roll] in [[0.5, 0.3, -0.2], [-1.2, -0.7, 0.4], [2.5, 0.1, 1.0]] {
            let rotation =
                about(Vector3::y_axis(), yaw) * about(Vector3::x_axis(), -pitch) * about(Vector3::z_axis(), roll);
            let angles = Angles::of(rotation.coords.into());
            assert!(near(&[angles.yaw, angles.pitch, angles.roll], &[yaw, pitch, roll]), "{angles:?}");
            let eye = about(Vector3::y_axis(), yaw) * about(Vector3::x_axis(), -pitch);
            assert!(near(&angles.quaternion_without_roll(), &<[f32; 4]>::from(eye.coords)));
        }
    }

    /// A point that turns in facewire's axes turns the same way in Unity's, in which x has the other sign.
    #[test]
    fn unity_sees_the_same_movement() {
        for rotation in [poses::LEFT, poses::DOWN, poses::TILTED] {
            let turn = |rotation: [f32; 4], point: Vector3<f32>| {
                UnitQuaternion::new_unchecked(Quaternion::from(rotation)) * point
            };
            let flipped = |point: Vector3<f32>| Vector3::new(-point.x, point.y, point.z);
            let nose = Vector3::new(0.1, 0.2, 1.0);
            let difference = turn(unity(rotation), flipped(nose)) - flipped(turn(rotation, nose));
            assert!(difference.norm() < 1e-6, "{difference}");
        }
    }
}
