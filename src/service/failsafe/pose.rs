//! How a pose is checked, and how it moves at a bounded speed.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use crate::link::Pose;

/// How far the head may turn while a coefficient may move by 1. At 4 units/s this is 180 degrees/s: a decay of 700 ms
/// brings back a head that is turned by 126 degrees.
const RADIANS_PER_UNIT: f32 = std::f32::consts::FRAC_PI_4;
/// How far the head may move while a coefficient may move by 1. At 4 units/s this is 1 m/s.
const MM_PER_UNIT: f32 = 250.0;
/// Rounding error of the solver that a coefficient of 0 or 1 may have.
const COEFFICIENT_TOLERANCE: f32 = 1e-3;
/// Rounding error that the length of the quaternion may have.
const ROTATION_TOLERANCE: f32 = 1e-2;
/// Farther than any camera sees a face, and within the 16 bits of the packet.
const POSITION_LIMIT_MM: f32 = 32_000.0;

impl Pose {
    /// The neutral face at the position of this pose: a head has no neutral position.
    pub(in crate::service) fn neutral_here(&self) -> Self {
        Self { position_mm: self.position_mm, neutral_face: self.neutral_face, ..Self::NEUTRAL }
    }

    /// Removes rounding errors. Returns `None` if any value is not a number or out of range.
    pub(super) fn checked(&self) -> Option<Self> {
        let plausible = -COEFFICIENT_TOLERANCE..=1.0 + COEFFICIENT_TOLERANCE;
        let coefficients_good = self.coefficients.iter().all(|value| plausible.contains(value));
        let limit = -POSITION_LIMIT_MM..=POSITION_LIMIT_MM;
        let position_good = self.position_mm.iter().all(|mm| limit.contains(mm));
        let quaternion = Quaternion::from(self.rotation);
        let rotation_good = (quaternion.norm() - 1.0).abs() <= ROTATION_TOLERANCE;
        (coefficients_good && position_good && rotation_good).then(|| Self {
            rotation: quaternion.normalize().coords.into(),
            position_mm: self.position_mm,
            coefficients: self.coefficients.map(|value| value.clamp(0.0, 1.0)),
            neutral_face: self.neutral_face,
        })
    }

    /// Moves the fraction `part` of the way to `target`, but no coefficient by more than `limit`, and the head by no more
    /// than the equivalent of it.
    pub(crate) fn towards(&self, target: &Self, part: f32, limit: f32) -> Self {
        let mut coefficients = target.coefficients;
        for (value, from) in coefficients.iter_mut().zip(self.coefficients) {
            let way = *value - from;
            if part < 1.0 || way.abs() > limit {
                *value = from + (way * part).clamp(-limit, limit);
            }
        }
        Self {
            rotation: turned(self.rotation, target.rotation, part, limit * RADIANS_PER_UNIT),
            position_mm: moved(self.position_mm, target.position_mm, part, limit * MM_PER_UNIT),
            coefficients,
            neutral_face: target.neutral_face,
        }
    }
}

/// Turns `from` towards `to` about one axis, the shorter way.
fn turned(from: [f32; 4], to: [f32; 4], part: f32, limit_rad: f32) -> [f32; 4] {
    let unit = |rotation| UnitQuaternion::new_normalize(Quaternion::from(rotation));
    let Some((axis, angle)) = unit(from).rotation_to(&unit(to)).axis_angle() else {
        return to;
    };
    if part >= 1.0 && angle <= limit_rad {
        return to;
    }
    let step = UnitQuaternion::from_axis_angle(&axis, (angle * part).min(limit_rad));
    (step * unit(from)).coords.into()
}

/// Moves `from` towards `to` on a straight line.
fn moved(from: [f32; 3], to: [f32; 3], part: f32, limit_mm: f32) -> [f32; 3] {
    let way = Vector3::from(to) - Vector3::from(from);
    if part >= 1.0 && way.norm() <= limit_mm {
        return to;
    }
    (Vector3::from(from) + (way * part).cap_magnitude(limit_mm)).into()
}
