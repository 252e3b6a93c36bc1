//! Corrective terms (eq. 7, 8): they restore the top of the range and remove a resting offset.
//!
//! Per blendshape `R_t = (1 + g(f)/eta - gamma) (f + beta)` with the result `f` of the regression, clamped to `0..=1`.
//! What holds for everybody is in the model ([`CorrectiveTerms`]); what the wearer adds is in the [`Profile`].
//! - `g` rises smoothly from 0 to 1 over the model's range of response. A closed eye reads 0.7, and `1/eta` lifts it to 0.97.
//! - `beta` is the model's shift less the profile's rest, which is the output for the face at rest. The sum is divided by
//!   `1 - rest`, so that an output of 1 stays 1.
//! - `1 - gamma` is the model's slope. The profile's gain comes before it, as a factor on `f + beta`, so that lids that
//!   close less far are lifted all the same.
//! - Eq. 8 as printed sets `beta = f_t` once `f_t` exceeds the last minimum by a margin that fades with time. That
//!   doubles every expression that is held longer than `1/k` (test `printed_shift_doubles_...`), the opposite of its
//!   purpose. Here a calibration measures the rest.
//!
//! Rest and gain are bounded, so that a neutral face recorded during a blink or a smile cannot switch a blendshape off.

use super::{COEFFS, Profile, regression::RawCoeffs};
use crate::model::{Correction, CorrectiveTerms};

/// Largest resting offset that is removed.
pub const MAX_REST: f32 = 0.3;
/// Least and greatest factor that a wearer's range gives.
pub const GAINS: [f32; 2] = [0.5, 2.0];

/// Coefficients after correction, each within `0..=1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corrected(pub [f32; COEFFS]);

/// Corrects the coefficients of one frame.
pub fn correct(raw: &RawCoeffs, terms: &Correction, profile: &Profile) -> Corrected {
    let mut out = raw.0;
    let wearer = profile.rest.iter().zip(&profile.gain);
    for ((value, terms), (rest, gain)) in out.iter_mut().zip(&terms.0).zip(wearer) {
        *value = terms.correct(*value, *rest, *gain);
    }
    Corrected(out)
}

impl CorrectiveTerms {
    /// Eq. 7 for one blendshape, clamped. `rest` and `gain` are the wearer's, 0 and 1 where unknown.
    pub fn correct(&self, raw: f32, rest: f32, gain: f32) -> f32 {
        let [least, greatest] = GAINS;
        let rest = if rest.is_nan() { 0.0 } else { rest.clamp(-MAX_REST, MAX_REST) };
        let gain = if gain.is_nan() { 1.0 } else { gain.clamp(least, greatest) };
        // From 0 at rest to 1, whatever the rest; then as if the wearer's range were that of most people.
        let b = gain * (raw + self.shift - rest) / (1.0 - rest);
        let g = smoothstep(b, self.response);
        ((self.slope + self.lift * g) * b).clamp(0.0, 1.0)
    }

    /// The rest that makes this output 0, not bounded.
    pub fn rest_of(&self, raw: f32) -> f32 {
        raw + self.shift
    }
}

/// Rises from 0 to 1 between two values, without a step or a kink.
pub(super) fn smoothstep(value: f32, [from, to]: [f32; 2]) -> f32 {
    let u = ((value - from) / (to - from)).clamp(0.0, 1.0);
    u * u * (3.0 - 2.0 * u)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::BLENDSHAPES;

    const BLINK: usize = 0;
    const JAW_OPEN: usize = 17;

    fn once(rest: f32, raw: f32) -> Corrected {
        with_gain(1.0, rest, raw)
    }

    fn with_gain(gain: f32, rest: f32, raw: f32) -> Corrected {
        let profile = Profile { neutral: None, rest: [rest; COEFFS], gain: [gain; COEFFS] };
        correct(&RawCoeffs([raw; COEFFS]), &Correction::default(), &profile)
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
        assert!((once(0.0, 0.3).0[BLINK] - 0.3).abs() < 1e-6, "an open eye keeps its value");
    }

    #[test]
    fn correction_keeps_the_order_of_values() {
        for (rest, gain) in [(0.1, 1.0), (-0.2, 0.6), (0.3, 2.0)] {
            let curve: Vec<f32> = (0_u8..=120).map(|i| with_gain(gain, rest, f32::from(i) / 100.0).0[BLINK]).collect();
            assert!(curve.windows(2).all(|pair| pair[1] >= pair[0]));
        }
    }

    #[test]
    fn gain_brings_a_weak_expression_to_the_full_range_and_what_is_not_a_number_changes_nothing() {
        assert!((with_gain(1.25, 0.0, 0.8).0[JAW_OPEN] - 1.0).abs() < 1e-6);
        assert!((with_gain(9.0, 0.0, 0.2).0[JAW_OPEN] - 0.4).abs() < 1e-6);
        assert!((with_gain(0.0, 0.0, 0.8).0[JAW_OPEN] - 0.4).abs() < 1e-6);
        assert_eq!(with_gain(f32::NAN, f32::NAN, 0.4), once(0.0, 0.4));
    }

    #[test]
    fn rest_is_removed_and_the_full_range_kept() {
        let terms = CorrectiveTerms { shift: -0.05, ..CorrectiveTerms::NONE };
        assert!(terms.correct(0.13, terms.rest_of(0.13), 1.0).abs() < 1e-6);
        assert!(once(0.2, 0.2).0[JAW_OPEN].abs() < 1e-6);
        assert!((once(0.2, 1.0).0[JAW_OPEN] - 1.0).abs() < 1e-6);
        assert!(once(-0.2, -0.2).0[JAW_OPEN].abs() < 1e-6, "an output below 0 at rest hides the beginning of a smile");
    }

    #[test]
    fn neutral_recorded_during_a_blink_does_not_stop_blinking() {
        assert!(once(1.0, 0.9).0[BLINK] > 0.9);
    }
}
