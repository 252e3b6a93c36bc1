//! The head's pose, derived from the transform that normalised the face.
//!
//! The rotation `Rz(roll) Rx(-pitch) Ry(yaw)` takes the head's axes (x to the person's left, y up, z out of the face)
//! to the picture's (x right, y up, z towards the camera). The position follows from the apparent distance of the eyes,
//! which are assumed to be 63 mm apart unless the solver is given another distance. `facewire-fit judge` prints the errors.

use facewire_packet::yaw_pitch_roll_deg;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::affine::Normalised;

/// True yaw divided by the yaw that the landmarks show: a head turns about its neck, so that a turned face also moves sideways.
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

    /// A camera with this focal length in pixels of the picture, above 0.
    pub fn of_focal_length([width_px, height_px]: [f32; 2], focal_px: f32) -> Self {
        let half_angle = (0.5 * width_px / focal_px).atan();
        Self { width_px, height_px, horizontal_fov_deg: 2.0 * half_angle.to_degrees() }
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
    /// Rotation as a unit quaternion x, y, z, w with w not negative. Its yaw is 0.9 of that which the landmarks show
    /// ([`HeadPose::apparent_rotation_xyzw`]).
    pub rotation_xyzw: [f32; 4],
    /// Position of the point between the eyes from the camera, millimetres: x right in the picture, y down, z away.
    pub position_mm: [f32; 3],
}

impl HeadPose {
    /// The distance between the pupils from which positions are computed.
    pub const EYE_DISTANCE_MM: f32 = 63.0;

    /// Computes the pose of a normalised face.
    pub fn new(face: &Normalised, camera: &Camera) -> Self {
        let m = &face.rotation;
        let yaw = YAW_GAIN * (-m.m31).atan2(m.m33);
        let pitch = -m.m32.clamp(-1.0, 1.0).asin();
        let roll = (-m.m12).atan2(m.m22);
        let rotation = rotation_of([yaw, pitch, roll]);
        let focal_px = 0.5 * camera.width_px / (0.5 * camera.horizontal_fov_deg).to_radians().tan();
        let z_mm = focal_px * Self::EYE_DISTANCE_MM / face.scale_px;
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

    /// The rotation that the landmarks show, for what is drawn over the face: that of [`HeadPose::rotation_xyzw`] with its yaw
    /// divided by 0.9. A head turns about its neck, so that a turned face also moves sideways and seems to turn further than
    /// the head does; the landmarks therefore show a larger yaw.
    pub fn apparent_rotation_xyzw(&self) -> [f32; 4] {
        let [yaw, pitch, roll] = self.yaw_pitch_roll_deg().map(f32::to_radians);
        let rotation = rotation_of([yaw / YAW_GAIN, pitch, roll]);
        Self::from_rotation(rotation.coords.into(), self.position_mm).rotation_xyzw
    }

    /// The pose of a person whose pupils are so far apart.
    pub(super) fn with_eye_distance(self, eye_distance_mm: f32) -> Self {
        let ratio = eye_distance_mm / Self::EYE_DISTANCE_MM;
        Self { position_mm: self.position_mm.map(|part_mm| ratio * part_mm), ..self }
    }

    pub(super) fn rotation(&self) -> UnitQuaternion<f32> {
        UnitQuaternion::new_unchecked(Quaternion::from(self.rotation_xyzw))
    }
}

/// The rotation by these angles in radians: `Rz(roll) Rx(-pitch) Ry(yaw)`.
fn rotation_of([yaw, pitch, roll]: [f32; 3]) -> UnitQuaternion<f32> {
    let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
    about(Vector3::z_axis(), roll) * about(Vector3::x_axis(), -pitch) * about(Vector3::y_axis(), yaw)
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
        assert_near(&seen.with_eye_distance(31.5).position_mm, &[30.0, 0.0, 300.0], 0.5);
    }

    #[test]
    fn a_focal_length_and_the_angle_of_view_that_it_gives_describe_the_same_camera() {
        let focal_px = 320.0 / 30.0_f32.to_radians().tan();
        let camera = Camera::of_focal_length([640.0, 480.0], focal_px);
        let described = [camera.width_px, camera.height_px, camera.horizontal_fov_deg];
        assert_near(&described, &[640.0, 480.0, 60.0], 1e-4);
    }

    #[test]
    fn apparent_rotation_is_that_of_the_landmarks_also_in_the_mirror() {
        for turned in [[20.0, 10.0, -5.0], [-50.0, -20.0, 30.0], [0.0; 3]] {
            let seen = pose(turned, 80.0, [320.0, 240.0]);
            assert_near(&yaw_pitch_roll_deg(seen.apparent_rotation_xyzw()), &turned, 0.02);
            let (rotation_xyzw, position_mm) = mirror_image(seen.rotation_xyzw, seen.position_mm);
            let [yaw, pitch, roll] = turned;
            let mirrored = HeadPose { rotation_xyzw, position_mm }.apparent_rotation_xyzw();
            assert_near(&yaw_pitch_roll_deg(mirrored), &[-yaw, pitch, -roll], 0.02);
        }
    }
}
