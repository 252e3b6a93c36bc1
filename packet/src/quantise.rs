//! Real numbers to integers of the wire and back. Values beyond the range saturate and NaN becomes 0, so that
//! nothing a receiver could trip over leaves the sender.

/// Steps of a coefficient from 0 to 1.
const COEFFICIENT_STEPS: f32 = 65535.0;
/// Steps of a quaternion component from 0 to 1.
const ROTATION_STEPS: f32 = 32767.0;
/// Microseconds in one step of the age.
const AGE_STEP_US: u32 = 100;

/// A coefficient, 0..=1, to 0..=65535.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "`as` saturates and turns NaN into 0")]
pub fn coefficient(value: f32) -> u16 {
    (value * COEFFICIENT_STEPS + 0.5) as u16
}

/// The coefficient that a number of the wire stands for.
pub fn coefficient_back(wire: u16) -> f32 {
    f32::from(wire) / COEFFICIENT_STEPS
}

/// A quaternion, each component to -32767..=32767. One that is not finite becomes the identity.
pub fn rotation(quaternion: [f32; 4]) -> [i16; 4] {
    if quaternion.iter().all(|component| component.is_finite()) {
        quaternion.map(|component| nearest(component.clamp(-1.0, 1.0) * ROTATION_STEPS))
    } else {
        [0, 0, 0, i16::MAX]
    }
}

/// The quaternion that numbers of the wire stand for. -32768 is never sent and reads as -1.
pub fn rotation_back(wire: [i16; 4]) -> [f32; 4] {
    wire.map(|component| (f32::from(component) / ROTATION_STEPS).max(-1.0))
}

/// Millimetres to the nearest whole one within -32768..=32767.
pub fn position(mm: [f32; 3]) -> [i16; 3] {
    mm.map(nearest)
}

/// Microseconds to the nearest tenth of a millisecond, at most 6.5535 s.
pub fn age(us: u32) -> u16 {
    let steps = us.saturating_add(AGE_STEP_US / 2) / AGE_STEP_US;
    u16::try_from(steps).unwrap_or(u16::MAX)
}

/// The microseconds that a number of the wire stands for.
pub fn age_back(wire: u16) -> u32 {
    u32::from(wire) * AGE_STEP_US
}

/// Rounds half away from zero.
#[expect(clippy::cast_possible_truncation, reason = "`as` saturates and turns NaN into 0")]
fn nearest(value: f32) -> i16 {
    (value + 0.5_f32.copysign(value)) as i16
}
