//! Conversion between real numbers and the integers of the wire format. Values out of range saturate and NaN becomes
//! 0, so that a receiver never gets a value it cannot use.

/// Quantisation steps of a coefficient between 0 and 1.
const COEFFICIENT_STEPS: f32 = 65535.0;
/// Quantisation steps of the visibility of a part between 0 and 1.
const VISIBILITY_STEPS: f32 = 15.0;
/// Quantisation steps of a quaternion component between 0 and 1.
const ROTATION_STEPS: f32 = 32767.0;
/// Microseconds per step of the age.
const AGE_STEP_US: u32 = 100;

/// Quantises a coefficient from 0 to 1 to an integer from 0 to 65535.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "`as` saturates and turns NaN into 0")]
pub fn coefficient(value: f32) -> u16 {
    (value * COEFFICIENT_STEPS + 0.5) as u16
}

/// Converts a received integer to a coefficient.
pub fn coefficient_back(wire: u16) -> f32 {
    f32::from(wire) / COEFFICIENT_STEPS
}

/// Quantises the visibility of a part to fifteenths.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "`as` saturates and turns NaN into 0")]
pub fn visibility(value: f32) -> u8 {
    ((value * VISIBILITY_STEPS + 0.5) as u8).min(15)
}

/// Converts received fifteenths to the visibility of a part.
pub fn visibility_back(wire: u8) -> f32 {
    f32::from(wire) / VISIBILITY_STEPS
}

/// Quantises a quaternion to components from -32767 to 32767. If a component is not finite, returns the identity.
pub fn rotation(quaternion: [f32; 4]) -> [i16; 4] {
    if quaternion.iter().all(|component| component.is_finite()) {
        quaternion.map(|component| nearest(component.clamp(-1.0, 1.0) * ROTATION_STEPS))
    } else {
        [0, 0, 0, i16::MAX]
    }
}

/// Converts received integers to a quaternion. The value -32768 is never sent and is read as -1.
pub fn rotation_back(wire: [i16; 4]) -> [f32; 4] {
    wire.map(|component| (f32::from(component) / ROTATION_STEPS).max(-1.0))
}

/// Rounds a position to whole millimetres from -32768 to 32767.
pub fn position(mm: [f32; 3]) -> [i16; 3] {
    mm.map(nearest)
}

/// Rounds an age in microseconds to tenths of a millisecond, at most 6.5535 s.
pub fn age(us: u32) -> u16 {
    let steps = us.saturating_add(AGE_STEP_US / 2) / AGE_STEP_US;
    u16::try_from(steps).unwrap_or(u16::MAX)
}

/// Converts a received age to microseconds.
pub fn age_back(wire: u16) -> u32 {
    u32::from(wire) * AGE_STEP_US
}

/// Rounds to the nearest integer, half away from zero.
#[expect(clippy::cast_possible_truncation, reason = "`as` saturates and turns NaN into 0")]
fn nearest(value: f32) -> i16 {
    (value + 0.5_f32.copysign(value)) as i16
}
