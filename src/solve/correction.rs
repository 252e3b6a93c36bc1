//! Corrective terms (eq. 7, 8): they restore the top of the range and remove a resting offset.
//!
//! Per blendshape `R_t = (1 + g(f)/eta - gamma) (f + beta)`, with `f = w.f + b` of the regression, clamped to `0..=1`.
//! - `g` rises smoothly from 0 to 1 while `f` goes from 0.5 to 0.9. A closed eye reads 0.8, and `1/eta` lifts it to 1.
//! - `beta = -rest`, where `rest` is the output for the face at rest, and `gamma = -rest / (1 - rest)`, so that an
//!   output of 1 stays 1.
//! - Eq. 8 as printed sets `beta = f_t` once `f_t` exceeds the last minimum by a margin that fades with time. That
//!   doubles every expression that is held longer than `1/k` (test `printed_shift_doubles_...`), the opposite of its
//!   purpose. Here the rest is a fixed part of the wearer's profile.
//!
//! The rest never exceeds [`MAX_REST`], so that a neutral face recorded during a blink or a smile cannot switch a
//! blendshape off.

use super::{COEFFS, regression::RawCoeffs};

/// Largest resting offset that is removed.
pub const MAX_REST: f32 = 0.3;
/// Where the response function `g` begins and ends to rise.
const RESPONSE_RANGE: [f32; 2] = [0.5, 0.9];
/// `eyeBlinkLeft` and `eyeBlinkRight`.
const EYE_BLINKS: [usize; 2] = [0, 7];
/// `1/eta` of the eyelids: full closure reads 0.8 and becomes 1. Other blendshapes have 0.
const EYE_BLINK_GAIN: f32 = 0.25;

/// Coefficients after correction, each within `0..=1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corrected(pub [f32; COEFFS]);

/// Corrects the coefficients of one frame. `rest` holds the raw outputs for the wearer's face at rest, 0 where unknown.
#[must_use]
pub fn correct(raw: &RawCoeffs, rest: &[f32; COEFFS]) -> Corrected {
    let mut out = raw.0;
    for (index, (value, rest)) in out.iter_mut().zip(rest).enumerate() {
        *value = correct_one(index, *value, *rest);
    }
    Corrected(out)
}

/// Corrects the coefficient of one blendshape, given by its index in [`super::BLENDSHAPES`].
#[must_use]
pub fn correct_one(blendshape: usize, raw: f32, rest: f32) -> f32 {
    let gain = if EYE_BLINKS.contains(&blendshape) { EYE_BLINK_GAIN } else { 0.0 };
    corrected(raw, bounded_rest(rest), gain)
}

/// Eq. 7 for one blendshape, clamped.
fn corrected(f: f32, rest: f32, gain: f32) -> f32 {
    let gamma = -rest / (1.0 - rest);
    ((1.0 + gain * response(f) - gamma) * (f - rest)).clamp(0.0, 1.0)
}

/// `g`: 0 below [`RESPONSE_RANGE`], 1 above it, smooth in between.
fn response(f: f32) -> f32 {
    let [from, to] = RESPONSE_RANGE;
    let u = ((f - from) / (to - from)).clamp(0.0, 1.0);
    u * u * (3.0 - 2.0 * u)
}

/// Limits a resting offset to `0..=MAX_REST`. An offset that is not a number counts as 0.
fn bounded_rest(rest: f32) -> f32 {
    if rest.is_nan() { 0.0 } else { rest.clamp(0.0, MAX_REST) }
}

#[cfg(test)]
#[allow(clippy::indexing_slicing)]
mod tests {
    use super::*;
    use crate::solve::BLENDSHAPES;

    const BLINK: usize = EYE_BLINKS[0];
    const JAW_OPEN: usize = 17;

    fn once(rest: f32, raw: f32) -> Corrected {
        correct(&RawCoeffs([raw; COEFFS]), &[rest; COEFFS])
    }

    /// `beta` of eq. 8 as printed, `age_s` seconds after the minimum was seen.
    fn printed_shift(f: f32, minimum: f32, age_s: f32, k: f32, beta_0: f32) -> f32 {
        if f > minimum + (-k * age_s).exp() { f } else { beta_0 }
    }

    #[test]
    fn printed_shift_doubles_an_expression_that_is_held() {
        let shifted = |age_s| 0.4 + printed_shift(0.4, 0.1, age_s, 2.0, 0.0);
        assert!((shifted(0.1) - 0.4).abs() < 1e-6, "right after the minimum nothing changes");
        assert!((shifted(2.0) - 0.8).abs() < 1e-6, "later the value is added to itself");
    }

    #[test]
    fn gain_applies_to_both_eyelids_and_to_nothing_else() {
        let gained = |index: &usize| once(0.0, 0.82).0[*index] > 0.98;
        let names: Vec<_> = (0..COEFFS).filter(gained).map(|index| BLENDSHAPES[index]).collect();
        assert_eq!(names, ["eyeBlinkLeft", "eyeBlinkRight"]);
        assert!((once(0.0, 0.82).0[JAW_OPEN] - 0.82).abs() < 1e-6);
    }

    #[test]
    fn open_eye_keeps_its_value() {
        assert!((once(0.0, 0.3).0[BLINK] - 0.3).abs() < 1e-6);
    }

    #[test]
    fn correction_keeps_the_order_of_values() {
        let curve: Vec<f32> = (0_u8..=120).map(|i| once(0.1, f32::from(i) / 100.0).0[BLINK]).collect();
        assert!(curve.windows(2).all(|pair| pair[1] >= pair[0]));
    }

    #[test]
    fn rest_is_removed_and_the_full_range_kept() {
        assert!(once(0.2, 0.2).0[JAW_OPEN].abs() < 1e-6);
        assert!((once(0.2, 1.0).0[JAW_OPEN] - 1.0).abs() < 1e-6);
    }

    #[test]
    fn neutral_recorded_during_a_blink_does_not_stop_blinking() {
        assert!(once(1.0, 0.9).0[BLINK] > 0.9);
    }

    #[test]
    fn rest_that_is_not_a_number_changes_nothing() {
        assert_eq!(once(f32::NAN, 0.4), once(0.0, 0.4));
    }
}
