//! Corrective terms (eq. 7, 8): they restore the top of the range and remove a resting offset.
//!
//! Per blendshape `R_t = (1 + g(f)/eta - gamma) (f + beta)` with the result `f` of the regression, clamped to `0..=1`. `g`
//! rises smoothly from 0 to 1; `beta` is the model's shift less the wearer's rest, and the sum is divided by `1 - rest`,
//! so that 1 stays 1. The wearer's gain is a factor on `f + beta`, so that lids that close less far are lifted all the
//! same. Eq. 8 as printed doubles every expression that is held longer than `1/k`; here a calibration measures the rest.

use super::{Coefficients, Profile};
use crate::model::{Correction, CorrectiveTerms};

/// Largest resting offset that is removed, so that a blink while at rest is recorded cannot switch a blendshape off.
pub const MAX_REST: f32 = 0.3;
/// Least and greatest factor that a wearer's range gives.
pub const GAINS: [f32; 2] = [0.5, 2.0];

/// Corrects the coefficients of one frame. The results are within `0..=1`.
pub fn correct(raw: &Coefficients, terms: &Correction, profile: &Profile) -> Coefficients {
    let mut out = *raw;
    let wearer = profile.rest.iter().zip(&profile.gain);
    for ((value, terms), (rest, gain)) in out.0.iter_mut().zip(&terms.0).zip(wearer) {
        *value = terms.correct(*value, *rest, *gain);
    }
    out
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
    use crate::solve::COEFFS;
    use crate::solve::plausible::{BLINKS, JAW_OPEN};

    fn corrected(gain: f32, rest: f32, raw: f32) -> [f32; COEFFS] {
        let profile = Profile { rest: [rest; COEFFS], gain: [gain; COEFFS], ..Profile::default() };
        correct(&Coefficients([raw; COEFFS]), &Correction::default(), &profile).0
    }

    #[test]
    fn gain_and_rest_bring_an_expression_to_the_full_range_within_bounds() {
        let cases = [
            (BLINKS[0], 1.0, 0.0, 0.82, 1.0, "a shut eye is lifted"),
            (BLINKS[0], 1.0, 0.0, 0.3, 0.3, "an open eye keeps its value"),
            (JAW_OPEN, 1.0, 0.0, 0.82, 0.82, "what has no terms keeps its value"),
            (JAW_OPEN, 1.25, 0.0, 0.8, 1.0, "a weak expression reaches the full range"),
            (JAW_OPEN, 9.0, 0.0, 0.2, 0.4, "the gain is at most 2"),
            (JAW_OPEN, 0.0, 0.0, 0.8, 0.4, "and at least one half"),
            (JAW_OPEN, f32::NAN, f32::NAN, 0.4, 0.4, "what is not a number changes nothing"),
            (JAW_OPEN, 1.0, 0.2, 0.2, 0.0, "the rest is removed"),
            (JAW_OPEN, 1.0, 0.2, 1.0, 1.0, "and the full range kept"),
            (JAW_OPEN, 1.0, -0.2, -0.2, 0.0, "an output below 0 at rest hides the beginning of a smile"),
            (BLINKS[0], 1.0, 1.0, 0.9, 1.0, "a neutral face recorded during a blink does not stop blinking"),
        ];
        for (index, gain, rest, raw, want, promise) in cases {
            let found = corrected(gain, rest, raw)[index];
            assert!((found - want).abs() < 1e-6, "{promise}: {found} in place of {want}");
        }
        for (rest, gain) in [(0.1, 1.0), (-0.2, 0.6), (0.3, 2.0)] {
            let curve: Vec<f32> =
                (0_u8..=120).map(|i| corrected(gain, rest, f32::from(i) / 100.0)[BLINKS[0]]).collect();
            assert!(curve.windows(2).all(|pair| pair[1] >= pair[0]), "the order of values is kept");
        }
        let terms = CorrectiveTerms { shift: -0.05, ..CorrectiveTerms::NONE };
        assert!(terms.correct(0.13, terms.rest_of(0.13), 1.0).abs() < 1e-6);
    }
}
