//! A pose of the face, and how it moves at a bounded speed.

use facewire_packet::BLENDSHAPE_COUNT;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

/// How far the head turns while a coefficient may move by 1: 4 units/s are 180 degrees/s, so that decay brings a
/// head turned by 126 degrees back within its 700 ms.
const RADIANS_PER_UNIT: f32 = std::f32::consts::FRAC_PI_4;
/// How far the head moves while a coefficient may move by 1: 4 units/s are 1 m/s.
const MM_PER_UNIT: f32 = 250.0;
/// What rounding in the solver may add to a coefficient of 0 or 1.
const COEFFICIENT_TOLERANCE: f32 = 1e-3;
/// What rounding may add to the length of the quaternion.
const ROTATION_TOLERANCE: f32 = 1e-2;
/// Farther than any camera sees a face, and still within the packet's 16 bits.
const POSITION_LIMIT_MM: f32 = 32_000.0;

/// What a face shows at one moment. Fields are as in [`facewire_packet::Packet`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// Head rotation, unit quaternion x y z w; identity when facing the camera.
    pub rotation: [f32; 4],
    /// Head position in the camera's frame, millimetres.
    pub position_mm: [f32; 3],
    /// Blendshape coefficients, 0..=1.
    pub coefficients: [f32; BLENDSHAPE_COUNT],
}

impl Pose {
    /// No expression, facing the camera.
    pub const NEUTRAL: Self =
        Self { rotation: [0.0, 0.0, 0.0, 1.0], position_mm: [0.0; 3], coefficients: [0.0; BLENDSHAPE_COUNT] };

    /// Neutral at this pose's place: a head has no neutral position, so the last one stays.
    pub(in crate::service) fn neutral_here(&self) -> Self {
        Self { position_mm: self.position_mm, ..Self::NEUTRAL }
    }

    /// The pose with rounding removed, or `None` when any value is not a number or out of range.
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
        })
    }

    /// Moves the fraction `part` of the way to `target`, but no coefficient by more than `limit`, and the head by
    /// no more than corresponds to it.
    pub(super) fn towards(&self, target: &Self, part: f32, limit: f32) -> Self {
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
        }
    }
}

/// Turns about one axis, the shorter way.
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

/// Moves along the straight line.
fn moved(from: [f32; 3], to: [f32; 3], part: f32, limit_mm: f32) -> [f32; 3] {
    let way = Vector3::from(to) - Vector3::from(from);
    if part >= 1.0 && way.norm() <= limit_mm {
        return to;
    }
    (Vector3::from(from) + (way * part).cap_magnitude(limit_mm)).into()
}
