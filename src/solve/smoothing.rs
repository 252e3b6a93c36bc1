//! `F`: the gated moving average (eq. 9 to 11).
//!
//! Within one standard deviation of the last N values a new one is averaged with them, `(f_t + N avg) / (N + 1)`;
//! outside it passes as it is, so that a blink is not delayed. Eq. 10 is a standard deviation (it has the root).
//! The printed gate closes to nothing on a face that holds still, which lets every bit of jitter through; so it is
//! never narrower than [`GatedAverage::min_gate`], about the jitter of a still face.
//! N is 5, for the eyes 2: they want little smoothing.

use super::{
    blendshapes::{BLENDSHAPES, COEFFS},
    correction::Corrected,
};

/// Most frames that are remembered.
pub const MAX_WINDOW: usize = 10;
const WINDOW: u8 = 5;
const EYE_WINDOW: u8 = 2;
/// Twice the standard deviation of coefficients on a still face.
const MIN_GATE: f32 = 0.02;

/// Coefficients ready to be sent, each within `0..=1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothed(pub [f32; COEFFS]);

/// Settings of the gated moving average, per blendshape in the order of [`BLENDSHAPES`].
#[derive(Debug, Clone, PartialEq)]
pub struct GatedAverage {
    /// N: how many previous values are averaged, at most [`MAX_WINDOW`]; below 2 turns smoothing off.
    pub window: [u8; COEFFS],
    /// Half width below which the gate never closes.
    pub min_gate: [f32; COEFFS],
}

/// The last frames, newest first.
#[derive(Debug, Clone, PartialEq)]
pub struct GatedAverageState {
    frames: [[f32; COEFFS]; MAX_WINDOW],
    filled: usize,
}

impl Default for GatedAverageState {
    fn default() -> Self {
        Self { frames: [[0.0; COEFFS]; MAX_WINDOW], filled: 0 }
    }
}

impl Default for GatedAverage {
    fn default() -> Self {
        let window = BLENDSHAPES.map(|name| if name.starts_with("eye") { EYE_WINDOW } else { WINDOW });
        Self { window, min_gate: [MIN_GATE; COEFFS] }
    }
}

impl GatedAverage {
    /// Smooths one frame. A new state (after a loss of the face) lets the first frames pass as they are.
    pub fn process(&self, state: &mut GatedAverageState, corrected: &Corrected) -> Smoothed {
        let mut out = corrected.0;
        for (index, value) in out.iter_mut().enumerate() {
            let window = self.window.get(index).map_or(0, |n| usize::from(*n)).min(state.filled);
            let previous = state.frames.iter().take(window).filter_map(|frame| frame.get(index).copied());
            *value = gated(*value, previous, self.min_gate.get(index).copied().unwrap_or(0.0));
        }
        state.push(corrected.0);
        Smoothed(out)
    }
}

impl GatedAverageState {
    fn push(&mut self, frame: [f32; COEFFS]) {
        self.frames.rotate_right(1);
        if let Some(newest) = self.frames.first_mut() {
            *newest = frame;
        }
        self.filled = (self.filled + 1).min(MAX_WINDOW);
    }
}

/// Eq. 11 for one value. Fewer than two previous values have no deviation: the value passes.
fn gated(value: f32, previous: impl Iterator<Item = f32> + Clone, min_gate: f32) -> f32 {
    let (count, sum) = previous.clone().fold((0.0_f32, 0.0), |(count, sum), f| (count + 1.0, sum + f));
    if count < 2.0 {
        return value;
    }
    let average = sum / count;
    let variance = previous.map(|f| (f - average) * (f - average)).sum::<f32>() / (count - 1.0);
    let gate = variance.sqrt().max(min_gate);
    if (value - average).abs() <= gate { (value + sum) / (count + 1.0) } else { value }
}

#[cfg(test)]
#[allow(clippy::indexing_slicing)]
mod tests {
    use super::*;

    const JAW_OPEN: usize = 17;

    fn run(filter: &GatedAverage, signal: &[f32]) -> Vec<f32> {
        let mut state = GatedAverageState::default();
        signal.iter().map(|f| filter.process(&mut state, &Corrected([*f; COEFFS])).0[JAW_OPEN]).collect()
    }

    #[test]
    fn value_within_the_deviation_becomes_the_mean_of_n_plus_one() {
        let out = run(&GatedAverage::default(), &[0.1, 0.3, 0.1, 0.3, 0.2, 0.25]);
        assert!((out[5] - 1.25 / 6.0).abs() < 1e-6);
    }

    #[test]
    fn sudden_move_passes_undelayed() {
        let out = run(&GatedAverage::default(), &[0.0, 0.01, 0.0, 0.01, 0.0, 0.9]);
        assert!((out[5] - 0.9).abs() < 1e-6);
    }

    #[test]
    fn printed_gate_closes_on_a_still_face_and_the_least_gate_keeps_it_open() {
        let signal = [0.2, 0.2, 0.2, 0.2, 0.2, 0.21];
        let printed = GatedAverage { min_gate: [0.0; COEFFS], ..GatedAverage::default() };
        assert!((run(&printed, &signal)[5] - 0.21).abs() < 1e-6);
        assert!((run(&GatedAverage::default(), &signal)[5] - 1.21 / 6.0).abs() < 1e-6);
    }

    #[test]
    fn jitter_of_a_still_face_at_least_halves() {
        let mut seed = 7_u32;
        let signal: Vec<f32> = (0..2000)
            .map(|_| {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                0.3 + 0.02 * (f32::from((seed >> 16) as u8) / 255.0 - 0.5)
            })
            .collect();
        let jitter = |x: &[f32]| x.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f32>();
        assert!(jitter(&run(&GatedAverage::default(), &signal)) < 0.5 * jitter(&signal));
    }

    #[test]
    fn first_frames_after_a_loss_pass_as_they_are() {
        let out = run(&GatedAverage::default(), &[0.4, 0.5]);
        assert!((out[0] - 0.4).abs() < 1e-6 && (out[1] - 0.5).abs() < 1e-6);
    }
}
