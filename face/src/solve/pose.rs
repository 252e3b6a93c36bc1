//! The head's pose, derived from the transform that normalised the face.
//!
//! The rotation `Rz(roll) Rx(-pitch) Ry(yaw)` takes the head's axes (x to the person's left, y up, z out of the face)
//! to the picture's (x right, y up, z towards the camera). The position follows from the apparent distance of the eyes,
//! which are assumed to be 63 mm apart. `facewire-fit judge` prints the errors.

use facewire_packet::yaw_pitch_roll_deg;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::affine::Normalised;

const EYE_DISTANCE_MM: f32 = 63.0;
/// True yaw divided by apparent yaw: a head turns about its neck, so that a turned face also moves sideways.
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
    pub fn new([width_px, height_px]: [f32; 2], horizontal_fov_deg: f32) -> Self {
        Self { width_px, height_px, horizontal_fov_deg }
    }

    /// The same picture by a camera on its side, whose angle of view was that across the height of the picture.
    #[must_use]
    pub fn on_its_side(self) -> Self {
        let across_height = (0.5 * self.horizontal_fov_deg).to_radians().tan();
        let half_angle = (across_height * self.width_px / self.height_px).atan();
        Self { horizontal_fov_deg: 2.0 * half_angle.to_degrees(), ..self }
    }
}

/// Position and orientation of the head.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct HeadPose {
    /// Rotation as a unit quaternion x, y, z, w with w not negative.
    pub rotation_xyzw: [f32; 4],
    /// Position of the point between the eyes from the camera, millimetres: x right in the picture, y down, z away.
    pub position_mm: [f32; 3],
}

impl HeadPose {
    /// Computes the pose of a normalised face.
    pub fn new(face: &Normalised, camera: &Camera) -> Self {
        let m = &face.rotation;
        let yaw = YAW_GAIN * (-m.m31).atan2(m.m33);
        let pitch = -m.m32.clamp(-1.0, 1.0).asin();
        let roll = (-m.m12).atan2(m.m22);
        let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
        let rotation =
            about(Vector3::z_axis(), roll) * about(Vector3::x_axis(), -pitch) * about(Vector3::y_axis(), yaw);
        let focal_px = 0.5 * camera.width_px / (0.5 * camera.horizontal_fov_deg).to_radians().tan();
        let z_mm = focal_px * EYE_DISTANCE_MM / face.scale_px;
        let mm_per_px = z_mm / focal_px;
        let [x_px, y_px] = face.origin_px;
        let position_mm =
            [(x_px - 0.5 * camera.width_px) * mm_per_px, (y_px - 0.5 * camera.height_px) * mm_per_px, z_mm];
        Self::from_rotation(rotation.coords.into(), position_mm)
    }

    /// The pose with this rotation, a unit quaternion x, y, z, w of any sign, and this position.
    pub fn from_rotation(xyzw: [f32; 4], position_mm: [f32; 3]) -> Self {
        let [.., w] = xyzw;
        let sign = if w < 0.0 { -1.0 } else { 1.0 };
        Self { rotation_xyzw: xyzw.map(|part| sign * part), position_mm }
    }

    /// The angles of [`facewire_packet::yaw_pitch_roll_deg`].
    pub fn yaw_pitch_roll_deg(&self) -> [f32; 3] {
        yaw_pitch_roll_deg(self.rotation_xyzw)
    }

    pub(super) fn rotation(&self) -> UnitQuaternion<f32> {
        UnitQuaternion::new_unchecked(Quaternion::from(self.rotation_xyzw))
    }
}

/// The mirror image of a rotation (quaternion x y z w) and of a position in the camera's frame.
pub const fn mirror_image([x, y, z, w]: [f32; 4], [x_mm, y_mm, z_mm]: [f32; 3]) -> ([f32; 4], [f32; 3]) {
    ([x, -y, -z, w], [-x_mm, y_mm, z_mm])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::normalise;
    use crate::testing::face;

    fn pose(angles: [f32; 3], scale_px: f32, origin_px: [f32; 2]) -> HeadPose {
        let camera = Camera::new([640.0, 480.0], 60.0);
        HeadPose::new(&normalise(&face(angles, scale_px, origin_px)).expect("a face"), &camera)
    }

    fn assert_near(a: &[f32], b: &[f32], tolerance: f32) {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < tolerance), "{a:?} in place of {b:?}");
    }

    #[test]
    fn a_camera_on_its_side_sees_a_head_where_the_upright_one_sees_it() {
        let upright = Camera::new([640.0, 480.0], 60.0);
        let focal_px = |camera: Camera| 0.5 * camera.width_px / (0.5 * camera.horizontal_fov_deg).to_radians().tan();
        let sideways = Camera::new([480.0, 640.0], 60.0).on_its_side();
        assert!((focal_px(sideways) - focal_px(upright)).abs() < 1e-2, "{sideways:?}");
    }

    #[test]
    fn angles_are_positive_to_the_left_up_and_to_the_right_shoulder_and_mirrored_where_they_must() {
        let seen = HeadPose { position_mm: [30.0, 20.0, 600.0], ..pose([20.0, 10.0, -5.0], 80.0, [320.0, 240.0]) };
        let [yaw, pitch, roll] = [18.0, 10.0, -5.0];
        assert_near(&seen.yaw_pitch_roll_deg(), &[yaw, pitch, roll], 0.02);
        assert_near(&yaw_pitch_roll_deg(seen.rotation_xyzw.map(|part| -part)), &[yaw, pitch, roll], 0.02);
        let (mirrored, position_mm) = mirror_image(seen.rotation_xyzw, seen.position_mm);
        assert_near(&yaw_pitch_roll_deg(mirrored), &[-yaw, pitch, -roll], 0.02);
        assert_near(&position_mm, &[-30.0, 20.0, 600.0], 1e-6);
    }

    #[test]
    fn quaternion_rotates_the_gaze_and_is_the_identity_for_a_head_that_faces_the_camera() {
        assert_near(&pose([0.0; 3], 80.0, [320.0, 240.0]).rotation_xyzw, &[0.0, 0.0, 0.0, 1.0], 1e-4);
        let gaze = pose([20.0, 10.0, 0.0], 80.0, [320.0, 240.0]).rotation() * Vector3::z();
        let yaw = 18.0_f32.to_radians();
        let pitch = 10.0_f32.to_radians();
        assert_near(gaze.as_slice(), &[yaw.sin(), yaw.cos() * pitch.sin(), yaw.cos() * pitch.cos()], 1e-3);
        for roll in [170.0, -170.0] {
            assert!(pose([0.0, 0.0, roll], 80.0, [320.0, 240.0]).rotation_xyzw[3] >= 0.0);
        }
    }

    #[test]
    fn eyes_63_mm_apart_have_the_position_that_the_angle_of_view_gives() {
        let focal_px = 320.0 / 30.0_f32.to_radians().tan();
        let seen = pose([0.0; 3], 63.0 * focal_px / 600.0, [320.0 + 0.1 * focal_px, 240.0]);
        assert_near(&seen.position_mm, &[60.0, 0.0, 600.0], 0.5);
    }
}
