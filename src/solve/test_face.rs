//! A rigid face for tests.

use nalgebra::{Rotation3, Vector3};

use super::canonical::RIGID;
use crate::face::{LANDMARKS, Landmarks};

/// The canonical face, rotated by yaw (to its left), pitch (up) and roll (to its right shoulder), degrees. Its eyes are
/// `scale_px` apart, and the point between them lies at `origin_px`. All other landmarks coincide with that point.
pub(crate) fn face([yaw, pitch, roll]: [f32; 3], scale_px: f32, origin_px: [f32; 2]) -> Landmarks {
    let about = |axis, degrees: f32| Rotation3::from_axis_angle(&axis, degrees.to_radians());
    let rotation = about(Vector3::z_axis(), roll) * about(Vector3::x_axis(), -pitch) * about(Vector3::y_axis(), yaw);
    let to_picture = |point: Vector3<f32>| {
        let turned = rotation * point * scale_px;
        [origin_px[0] + turned.x, origin_px[1] - turned.y, -turned.z]
    };
    let mut landmarks = Landmarks([to_picture(Vector3::zeros()); LANDMARKS]);
    for (index, point) in RIGID {
        landmarks.0[index] = to_picture(Vector3::from(point).cast());
    }
    landmarks
}
