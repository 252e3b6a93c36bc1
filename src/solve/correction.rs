//! Corrective terms (eq. 7, 8): the top of the range restored, a resting offset removed.
//!
//! Per blendshape `R_t = (1 + g(f)/eta - gamma) (f + beta)`, with `f = w.f + b` of the regression, clamped to `0..=1`.
//! - `g` rises smoothly from 0 to 1 where `f` goes from 0.5 to 0.9: a closed eye reads 0.8, and `1/eta` lifts it to 1.
//! - `beta = -rest`, the output of the face at rest, and `gamma = -rest / (1 - rest)`, so that 1 stays 1.
//! - Eq. 8 as printed sets `beta = f_t` once `f_t` exceeds the last minimum by a margin that fades with time. On a
//!   signal that doubles every expression held longer than `1/k` (test `printed_shift_doubles_...`), the contrary of
//!   its purpose. Here the previous minimum itself is the rest, and it is re-based towards `f_t` at the rate `k`.
//!
//! By default `rest` is 0 and `k` is 0: nothing is removed as long as nothing measures a rest, and nothing adapts. The rest never exceeds [`MAX_REST`], so
//! that a neutral face recorded during a blink or a smile cannot switch a blendshape off.

use super::{BLENDSHAPES, COEFFS, regression::RawCoeffs};

/// Largest resting offset that is removed.
pub const MAX_REST: f32 = 0.3;
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
    /// The raw output of the face at rest, as calibration measured it.
    pub rest: [f32; COEFFS],
    /// `k`: how fast the rest follows a face that stays above it, per second; 0 keeps it where calibration put it.
    pub rest_rate_per_s: [f32; COEFFS],
}

/// The resting offsets as they are now.
#[derive(Debug, Clone, PartialEq)]
pub struct CorrectionState {
    rest: [f32; COEFFS],
}

impl Default for Correction {
    fn default() -> Self {
        let gain = BLENDSHAPES.map(|name| if name.starts_with("eyeBlink") { EYE_BLINK_GAIN } else { 0.0 });
        Self { gain, rest: [0.0; COEFFS], rest_rate_per_s: [0.0; COEFFS] }
    }
}

impl Correction {
    /// The state to begin with.
    #[must_use]
    pub fn start(&self) -> CorrectionState {
        CorrectionState { rest: self.rest.map(bounded_rest) }
    }

    /// Corrects one frame, `dt_s` seconds after the previous one.
    pub fn process(&self, state: &mut CorrectionState, raw: &RawCoeffs, dt_s: f32) -> Corrected {
        let mut out = raw.0;
        let rests = state.rest.iter_mut().zip(&self.rest_rate_per_s);
        for ((value, gain), (rest, rate)) in out.iter_mut().zip(&self.gain).zip(rests) {
            *rest = follow(*rest, *value, rate * dt_s);
            *value = correct(*value, *rest, *gain);
        }
        Corrected(out)
    }
}

/// Eq. 7 for one blendshape, clamped.
fn correct(f: f32, rest: f32, gain: f32) -> f32 {
    let gamma = -rest / (1.0 - rest);
    ((1.0 + gain * response(f) - gamma) * (f - rest)).clamp(0.0, 1.0)
}

/// `g`: 0 below, 1 above [`RESPONSE_RANGE`], smooth between.
fn response(f: f32) -> f32 {
    let [from, to] = RESPONSE_RANGE;
    let u = ((f - from) / (to - from)).clamp(0.0, 1.0);
    u * u * (3.0 - 2.0 * u)
}

/// Eq. 8 as used: a lower value is the new minimum at once, a higher one draws it up by the share `1 - exp(-k dt)`.
fn follow(rest: f32, f: f32, k_dt: f32) -> f32 {
    if k_dt <= 0.0 {
        return rest;
    }
    let share = if f < rest { 1.0 } else { 1.0 - (-k_dt).exp() };
    bounded_rest(rest + share * (f - rest))
}

/// A rest that is not a number counts as none.
fn bounded_rest(rest: f32) -> f32 {
    if rest.is_nan() { 0.0 } else { rest.clamp(0.0, MAX_REST) }
}

#[cfg(test)]
#[allow(clippy::indexing_slicing, clippy::expect_used)]
mod tests {
    use super::*;

    const BLINK: usize = 0;
    const JAW_OPEN: usize = 17;
    const FRAME_S: f32 = 1.0 / 30.0;

    fn all(value: f32) -> RawCoeffs {
        RawCoeffs([value; COEFFS])
    }

    fn once(correction: &Correction, raw: f32) -> Corrected {
        correction.process(&mut correction.start(), &all(raw), FRAME_S)
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
        let correction = Correction::default();
        assert!(once(&correction, 0.82).0[BLINK] > 0.98);
        assert!((once(&correction, 0.3).0[BLINK] - 0.3).abs() < 1e-6);
        assert!((once(&correction, 0.82).0[JAW_OPEN] - 0.82).abs() < 1e-6, "other blendshapes are left alone");
    }

    #[test]
    fn correction_keeps_the_order_of_values() {
        let correction = Correction { rest: [0.1; COEFFS], ..Correction::default() };
        let curve: Vec<f32> = (0_u8..=120).map(|i| once(&correction, f32::from(i) / 100.0).0[BLINK]).collect();
        assert!(curve.windows(2).all(|pair| pair[1] >= pair[0]));
    }

    #[test]
    fn rest_is_removed_and_the_full_range_kept() {
        let correction = Correction { rest: [0.2; COEFFS], ..Correction::default() };
        assert!(once(&correction, 0.2).0[JAW_OPEN].abs() < 1e-6);
        assert!((once(&correction, 1.0).0[JAW_OPEN] - 1.0).abs() < 1e-6);
    }

    #[test]
    fn neutral_recorded_during_a_blink_does_not_stop_blinking() {
        let correction = Correction { rest: [1.0; COEFFS], ..Correction::default() };
        assert!(once(&correction, 0.9).0[BLINK] > 0.9);
    }

    #[test]
    fn rest_that_follows_reaches_a_resting_offset_and_drops_at_once() {
        let correction = Correction { rest_rate_per_s: [1.0; COEFFS], ..Correction::default() };
        let mut state = correction.start();
        let last = (0..150).map(|_| correction.process(&mut state, &all(0.12), FRAME_S)).last().expect("150 frames");
        assert!(last.0[JAW_OPEN] < 0.01);
        correction.process(&mut state, &all(0.02), FRAME_S);
        assert!(correction.process(&mut state, &all(0.5), FRAME_S).0[JAW_OPEN] > 0.45);
    }

    #[test]
    fn rest_does_not_move_by_default() {
        let correction = Correction::default();
        let mut state = correction.start();
        (0..3000).for_each(|_| {
            correction.process(&mut state, &all(0.5), FRAME_S);
        });
        assert!((correction.process(&mut state, &all(0.5), FRAME_S).0[JAW_OPEN] - 0.5).abs() < 1e-6);
    }
}
