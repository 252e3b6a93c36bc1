//! Corrective terms (eq. 7): the top of the range restored.
//!
//! Per blendshape `R_t = (1 + g(f)/eta) f`, with `f = w.f + b` of the regression, clamped to `0..=1`: `g` rises smoothly
//! from 0 to 1 where `f` goes from 0.5 to 0.9. A closed eye reads 0.8, and `1/eta` lifts it to 1.
//!
//! The terms `gamma` and `beta` of eq. 7 and 8, which take a resting offset away, are 0. Eq. 8 as printed sets
//! `beta = f_t` once `f_t` exceeds the last minimum by a margin that fades with time: on a signal that doubles every
//! expression held longer than `1/k` (test `printed_shift_doubles_...`), the contrary of its purpose.

use super::{BLENDSHAPES, COEFFS, regression::RawCoeffs};

/// Where the response function `g` begins and ends to rise.
const RESPONSE_RANGE: [f32; 2] = [0.5, 0.9];
/// `1/eta` of the eyelids: full closure reads 0.8 and becomes 1.
const EYE_BLINK_GAIN: f32 = 0.25;

/// Coefficients after correction, each within `0..=1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corrected(pub [f32; COEFFS]);

/// Settings of the corrective terms, per blendshape in the order of [`BLENDSHAPES`].
#[derive(Debug, Clone, PartialEq)]
pub struct Correction {
    /// `1/eta`: by how much of itself the top of the range is raised, 0 or more.
    pub gain: [f32; COEFFS],
}

impl Default for Correction {
    fn default() -> Self {
        Self { gain: BLENDSHAPES.map(|name| if name.starts_with("eyeBlink") { EYE_BLINK_GAIN } else { 0.0 }) }
    }
}

impl Correction {
    /// Corrects one frame.
    #[must_use]
    pub fn process(&self, raw: &RawCoeffs) -> Corrected {
        let mut out = raw.0;
        out.iter_mut().zip(&self.gain).for_each(|(value, gain)| *value = correct(*value, *gain));
        Corrected(out)
    }
}

/// Eq. 7 for one blendshape, clamped.
fn correct(f: f32, gain: f32) -> f32 {
    ((1.0 + gain * response(f)) * f).clamp(0.0, 1.0)
}

/// `g`: 0 below, 1 above [`RESPONSE_RANGE`], smooth between.
fn response(f: f32) -> f32 {
    let [from, to] = RESPONSE_RANGE;
    let u = ((f - from) / (to - from)).clamp(0.0, 1.0);
    u * u * (3.0 - 2.0 * u)
}

#[cfg(test)]
#[allow(clippy::indexing_slicing)]
mod tests {
    use super::*;

    const BLINK: usize = 0;
    const JAW_OPEN: usize = 17;

    fn once(raw: f32) -> Corrected {
        Correction::default().process(&RawCoeffs([raw; COEFFS]))
    }

    /// `beta` of eq. 8 as printed: `age_s` since the minimum `f_t0` was seen.
    fn printed_shift(f: f32, minimum: f32, age_s: f32, k: f32, beta_0: f32) -> f32 {
        if f > minimum + (-k * age_s).exp() { f } else { beta_0 }
    }

    #[test]
    fn printed_shift_doubles_an_expression_that_is_held() {
        let corrected = |age_s| 0.4 + printed_shift(0.4, 0.1, age_s, 2.0, 0.0);
        assert!((corrected(0.1) - 0.4).abs() < 1e-6, "right after the minimum nothing changes");
        assert!((corrected(2.0) - 0.8).abs() < 1e-6, "later the value is added to itself");
    }

    #[test]
    fn closed_eye_reaches_one_and_open_eye_stays_where_it_is() {
        assert!(once(0.82).0[BLINK] > 0.98);
        assert!((once(0.3).0[BLINK] - 0.3).abs() < 1e-6);
        assert!((once(0.82).0[JAW_OPEN] - 0.82).abs() < 1e-6, "other blendshapes are left alone");
    }

    #[test]
    fn correction_keeps_the_order_of_values_and_their_bounds() {
        let curve: Vec<f32> = (-20_i8..=120).map(|i| once(f32::from(i) / 100.0).0[BLINK]).collect();
        assert!(curve.windows(2).all(|pair| pair[1] >= pair[0]));
        assert!(curve.iter().all(|value| (0.0..=1.0).contains(value)));
    }
}
