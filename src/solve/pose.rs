//! The head's pose, derived from the transform that normalised the face.
//!
//! The rotation `Rz(roll) Rx(-pitch) Ry(yaw)` takes the head's axes (x to the person's left, y up, z out of the face)
//! to the picture's (x right, y up, z towards the camera). It is the identity for a head that faces the camera. The
//! position follows from the apparent distance of the eyes. Mean error on 10,000 rendered faces (yaw up to 40, pitch up
//! to 25 degrees): yaw 1.2, pitch 2.4, roll 0.8 degrees; `facewire-fit judge` prints it. Limits: the eyes are assumed
//! to be 63 mm apart. For other wearers, the position is scaled in proportion.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::affine::Normalised;

/// Mean distance between the middles of an adult's eyes, millimetres.
const EYE_DISTANCE_MM: f32 = 63.0;
/// True yaw divided by apparent yaw. A head turns about its neck, so that a turned face also moves sideways and the
/// camera sees it from the side: measured at 55 to 100 cm, the apparent yaw is 1.1 times the true yaw.
const YAW_GAIN: f32 = 0.9;

/// The properties of the camera that the head's position depends on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Width of the picture, pixels.
    pub width_px: f32,
    /// Height of the picture, pixels.
    pub height_px: f32,
    /// Angle of view across the width, degrees, above 0 and below 180.
    pub horizontal_fov_deg: f32,
}

impl Camera {
    /// A camera with a picture of `[width_px, height_px]`.
    #[must_use]
    pub fn new([width_px, height_px]: [f32; 2], horizontal_fov_deg: f32) -> Self {
        Self { width_px, height_px, horizontal_fov_deg }
    }

    fn focal_px(&self) -> f32 {
        0.5 * self.width_px / (0.5 * self.horizontal_fov_deg).to_radians().tan()
    }
}

/// Position and orientation of the head.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeadPose {
    /// Rotation as a unit quaternion x, y, z, w with w not negative. It is the identity for a head that faces the
    /// camera.
    pub rotation_xyzw: [f32; 4],
    /// Turn to the person's left, degrees.
    pub yaw_deg: f32,
    /// Nod upwards, degrees.
    pub pitch_deg: f32,
    /// Tilt to the person's right shoulder, degrees.
    pub roll_deg: f32,
    /// Position of the point between the eyes relative to the camera, millimetres: x right in the picture, y down, z
    /// away from the camera.
    pub position_mm: [f32; 3],
}

impl HeadPose {
    /// Computes the pose of a normalised face.
    #[must_use]
    pub fn new(face: &Normalised, camera: &Camera) -> Self {
        let m = &face.rotation;
        let yaw = YAW_GAIN * (-m.m31).atan2(m.m33);
        let pitch = -m.m32.clamp(-1.0, 1.0).asin();
        let roll = (-m.m12).atan2(m.m22);
        Self {
            rotation_xyzw: quaternion(yaw, pitch, roll),
            yaw_deg: yaw.to_degrees(),
            pitch_deg: pitch.to_degrees(),
            roll_deg: roll.to_degrees(),
            position_mm: position(face, camera),
        }
    }

    /// The pose with this rotation, a unit quaternion x, y, z, w of any sign, and this position.
    #[must_use]
    pub fn from_rotation(xyzw: [f32; 4], position_mm: [f32; 3]) -> Self {
        let rotation = UnitQuaternion::new_unchecked(Quaternion::from(xyzw));
        let [yaw_deg, pitch_deg, roll_deg] = yaw_pitch_roll_deg(rotation);
        Self { rotation_xyzw: with_positive_w(rotation), yaw_deg, pitch_deg, roll_deg, position_mm }
    }

    /// The mirror image of the pose: left and right are swapped.
    #[must_use]
    pub fn mirrored(&self) -> Self {
        let (rotation_xyzw, position_mm) = mirror_image(self.rotation_xyzw, self.position_mm);
        let (yaw_deg, pitch_deg, roll_deg) = (-self.yaw_deg, self.pitch_deg, -self.roll_deg);
        Self { rotation_xyzw, yaw_deg, pitch_deg, roll_deg, position_mm }
    }

    /// The rotation.
    pub(super) fn rotation(&self) -> UnitQuaternion<f32> {
        UnitQuaternion::new_unchecked(Quaternion::from(self.rotation_xyzw))
    }
}

/// Returns the angles of the rotation `Rz(roll) Rx(-pitch) Ry(yaw)` in degrees.
#[must_use]
pub fn yaw_pitch_roll_deg(rotation: UnitQuaternion<f32>) -> [f32; 3] {
    // The columns are the directions of x (the person's left), y (up) and z (out of the face).
    let [[_, _, left_z], [up_x, up_y, up_z], [_, _, forward_z]] = rotation.to_rotation_matrix().into_inner().into();
    let yaw = (-left_z).atan2(forward_z);
    let pitch = -up_z.clamp(-1.0, 1.0).asin();
    let roll = (-up_x).atan2(up_y);
    // Adding 0 turns -0 into 0.
    [yaw, pitch, roll].map(|radians| radians.to_degrees() + 0.0)
}

/// `Rz(roll) Rx(-pitch) Ry(yaw)`, angles in radians.
fn quaternion(yaw: f32, pitch: f32, roll: f32) -> [f32; 4] {
    let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
    with_positive_w(about(Vector3::z_axis(), roll) * about(Vector3::x_axis(), -pitch) * about(Vector3::y_axis(), yaw))
}

/// Of the two quaternions of a rotation, returns the one whose w is not negative.
fn with_positive_w(rotation: UnitQuaternion<f32>) -> [f32; 4] {
    let sign = if rotation.w < 0.0 { -1.0 } else { 1.0 };
    (sign * rotation.coords).into()
}

fn position(face: &Normalised, camera: &Camera) -> [f32; 3] {
    let focal_px = camera.focal_px();
    let z_mm = focal_px * EYE_DISTANCE_MM / face.scale_px;
    let [x_px, y_px] = face.origin_px;
    let mm_per_px = z_mm / focal_px;
    [(x_px - 0.5 * camera.width_px) * mm_per_px, (y_px - 0.5 * camera.height_px) * mm_per_px, z_mm]
}

/// The mirror image of a rotation (quaternion x y z w) and of a position in the camera's frame.
#[must_use]
pub const fn mirror_image([x, y, z, w]: [f32; 4], [x_mm, y_mm, z_mm]: [f32; 3]) -> ([f32; 4], [f32; 3]) {
    ([x, -y, -z, w], [-x_mm, y_mm, z_mm])
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use crate::solve::{normalise, test_face::face};

    const CAMERA: Camera = Camera { width_px: 640.0, height_px: 480.0, horizontal_fov_deg: 60.0 };

    fn pose(angles: [f32; 3], scale_px: f32, origin_px: [f32; 2]) -> HeadPose {
        HeadPose::new(&normalise(&face(angles, scale_px, origin_px)).expect("a face"), &CAMERA)
    }

    fn near(a: &[f32], b: &[f32], tolerance: f32) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < tolerance)
    }

    #[test]
    fn head_that_faces_the_camera_has_the_identity_rotation() {
        assert!(near(&pose([0.0; 3], 80.0, [320.0, 240.0]).rotation_xyzw, &[0.0, 0.0, 0.0, 1.0], 1e-4));
    }

    #[test]
    fn angles_are_positive_to_the_left_up_and_to_the_right_shoulder() {
        let seen = pose([20.0, 10.0, -5.0], 80.0, [320.0, 240.0]);
        assert!(near(&[seen.yaw_deg, seen.pitch_deg, seen.roll_deg], &[20.0 * YAW_GAIN, 10.0, -5.0], 0.02));
    }

    #[test]
    fn quaternion_rotates_the_gaze_to_the_left_and_up() {
        let [x, y, z, w] = pose([20.0, 10.0, 0.0], 80.0, [320.0, 240.0]).rotation_xyzw;
        let rotation = UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z));
        let gaze = rotation * Vector3::z();
        let (yaw, pitch) = ((20.0 * YAW_GAIN).to_radians(), 10.0_f32.to_radians());
        assert!(near(gaze.as_slice(), &[yaw.sin(), yaw.cos() * pitch.sin(), yaw.cos() * pitch.cos()], 1e-3));
    }

    #[test]
    fn mirror_image_turns_and_tilts_the_other_way_and_nods_the_same_way() {
        let seen = pose([20.0, 10.0, -25.0], 80.0, [320.0, 240.0]);
        let (rotation_xyzw, position_mm) = mirror_image(seen.rotation_xyzw, [30.0, 20.0, 600.0]);
        let mirrored = HeadPose::from_rotation(rotation_xyzw, position_mm);
        let angles = |pose: HeadPose| [pose.yaw_deg, pose.pitch_deg, pose.roll_deg];
        assert!(near(&angles(mirrored), &[-seen.yaw_deg, seen.pitch_deg, -seen.roll_deg], 1e-3), "{mirrored:?}");
        assert!(near(&angles(mirrored), &angles(seen.mirrored()), 1e-3) && mirrored.rotation_xyzw[3] > 0.0);
        assert!(near(&mirrored.position_mm, &[-30.0, 20.0, 600.0], 1e-6));
    }

    #[test]
    fn angles_of_a_rotation_are_those_that_it_was_made_of() {
        let seen = pose([20.0, 10.0, -25.0], 80.0, [320.0, 240.0]);
        let again = HeadPose::from_rotation(seen.rotation_xyzw.map(|value| -value), seen.position_mm);
        let angles = |pose: HeadPose| [pose.yaw_deg, pose.pitch_deg, pose.roll_deg];
        assert!(near(&angles(again), &angles(seen), 1e-3), "{again:?}");
        assert!(near(&again.rotation_xyzw, &seen.rotation_xyzw, 1e-6));
    }

    #[test]
    fn eyes_63_mm_apart_have_the_position_that_the_angle_of_view_gives() {
        let focal_px = 320.0 / 30.0_f32.to_radians().tan();
        let seen = pose([0.0; 3], 63.0 * focal_px / 600.0, [320.0 + 0.1 * focal_px, 240.0]);
        assert!(near(&seen.position_mm, &[60.0, 0.0, 600.0], 0.5));
    }

    #[test]
    fn w_of_the_quaternion_is_never_negative() {
        assert!(pose([0.0, 0.0, 170.0], 80.0, [320.0, 240.0]).rotation_xyzw[3] >= 0.0);
        assert!(pose([0.0, 0.0, -170.0], 80.0, [320.0, 240.0]).rotation_xyzw[3] >= 0.0);
    }
}
