//! What a channel can follow: the coefficients, and the angles of the head.

use nalgebra::{Quaternion, UnitQuaternion};

use crate::link::Pose;
use crate::solve::{BLENDSHAPES, COEFFS, yaw_pitch_roll_deg};

/// The angles of the head, degrees: yaw to the person's left, pitch upwards, roll to the person's right shoulder.
const ANGLES: [&str; 3] = ["headYaw", "headPitch", "headRoll"];
/// Number of sources.
pub const SOURCE_COUNT: usize = COEFFS + ANGLES.len();
/// The names of all sources: those of the coefficients, then those of the angles.
pub const SOURCE_NAMES: [&str; SOURCE_COUNT] = {
    let mut names = [""; SOURCE_COUNT];
    let (coefficients, angles) = names.split_at_mut(COEFFS);
    coefficients.copy_from_slice(&BLENDSHAPES);
    angles.copy_from_slice(&ANGLES);
    names
};

/// How much each source moves a channel: per unit of a coefficient, and per degree of an angle.
pub type Gains = [f32; SOURCE_COUNT];

/// Returns the values of all sources.
#[must_use]
pub fn values(pose: &Pose) -> Gains {
    let angles_deg = yaw_pitch_roll_deg(UnitQuaternion::new_unchecked(Quaternion::from(pose.rotation)));
    let mut values = [0.0; SOURCE_COUNT];
    let all = pose.coefficients.iter().chain(&angles_deg);
    values.iter_mut().zip(all).for_each(|(to, from)| *to = *from);
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sources_are_the_coefficients_and_the_angles_of_the_head_in_degrees() {
        // 20 degrees about the vertical axis: the head turns to the person's left.
        let (sin, cos) = 10.0_f32.to_radians().sin_cos();
        let mut pose = Pose { rotation: [0.0, sin, 0.0, cos], ..Pose::NEUTRAL };
        pose.coefficients[3] = 0.25;
        let values = values(&pose);
        let of = |name| values[SOURCE_NAMES.iter().position(|source| *source == name).unwrap()];
        assert!((of("headYaw") - 20.0).abs() < 1e-4, "{}", of("headYaw"));
        assert!(of("headPitch").abs() < 1e-4 && of("headRoll").abs() < 1e-4);
        assert!((of(BLENDSHAPES[3]) - 0.25).abs() < f32::EPSILON);
    }
}
