//! A rigid face to test with.

use nalgebra::{Rotation3, Vector3};

use super::canonical::RIGID;
use crate::face::{LANDMARKS, Landmarks};

/// The canonical face, turned by yaw (to its left), pitch (up) and roll (to its right shoulder) degrees, with
/// `scale_px` pixels per eye distance and the point between its eyes at `origin_px`.
pub(crate) fn face([yaw, pitch, roll]: [f32; 3], scale_px: f32, origin_px: [f32; 2]) -> Landmarks {
    let about = |axis, degrees: f32| Rotation3::from_axis_angle(&axis, degrees.to_radians());
    let rotation = about(Vector3::z_axis(), roll) * about(Vector3::x_axis(), -pitch) * about(Vector3::y_axis(), yaw);
    let place = |point: Vector3<f32>| {
        let turned = rotation * point * scale_px;
        [origin_px[0] + turned.x, origin_px[1] - turned.y, -turned.z]
    };
    let mut landmarks = Landmarks([place(Vector3::zeros()); LANDMARKS]);
    for (index, point) in RIGID {
        landmarks.0[index] = place(Vector3::from(point).cast());
    }
    landmarks
}
