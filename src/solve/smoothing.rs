//! `F`: the gated moving average (eq. 9 to 11).
//!
//! Within one standard deviation of the last N values a new one is averaged with them, `(f_t + N avg) / (N + 1)`;
//! outside it passes as it is, so that a blink is not delayed. Eq. 10 is a standard deviation (it has the root).
//! As printed the gate has a step at its edge and closes to nothing on a face that holds still. Values then jump
//! between smoothed and not. So by default the share of the new value grows smoothly from `1 / (N + 1)` in the middle of
//! the gate to 1 at its edge, and the gate is never narrower than a few times the jitter of a still face.
//! N is 5, for the eyes 2: they want little smoothing.

use super::{BLENDSHAPES, COEFFS, correction::Corrected};

/// Most frames that are remembered.
pub const MAX_WINDOW: usize = 10;
const WINDOW: u8 = 5;
const EYE_WINDOW: u8 = 2;
const MIN_GATE: f32 = 0.05;
const EYE_MIN_GATE: f32 = 0.03;

/// Coefficients ready to be sent, each within `0..=1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothed(pub [f32; COEFFS]);

/// How the gate ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GateEdge {
    /// A step, as eq. 11 is printed.
    Step,
    /// Without a step.
    #[default]
    Smooth,
}

/// Settings of the gated moving average, per blendshape in the order of [`BLENDSHAPES`].
#[derive(Debug, Clone, PartialEq)]
pub struct Filters {
    /// N: how many previous values are averaged, at most [`MAX_WINDOW`]; below 2 turns smoothing off.
    pub window: [u8; COEFFS],
    /// Half width below which the gate never closes.
    pub min_gate: [f32; COEFFS],
    /// How all gates end.
    pub edge: GateEdge,
}

/// The last smoothed frames, newest first.
#[derive(Debug, Clone, PartialEq)]
pub struct FiltersState {
    frames: [[f32; COEFFS]; MAX_WINDOW],
    filled: usize,
}

impl Default for FiltersState {
    fn default() -> Self {
        Self { frames: [[0.0; COEFFS]; MAX_WINDOW], filled: 0 }
    }
}

impl Default for Filters {
    fn default() -> Self {
        let by_region = BLENDSHAPES
            .map(|name| if name.starts_with("eye") { (EYE_WINDOW, EYE_MIN_GATE) } else { (WINDOW, MIN_GATE) });
        Self {
            window: by_region.map(|(window, _)| window),
            min_gate: by_region.map(|(_, gate)| gate),
            edge: GateEdge::default(),
        }
    }
}

impl Filters {
    /// Averages over `window` previous values, at most [`MAX_WINDOW`], where the default has more than the eyes' few.
    #[must_use]
    pub fn with_window(window: u32) -> Self {
        let default = Self::default();
        let window = u8::try_from(window).unwrap_or(u8::MAX);
        let window = default.window.map(|usual| if usual == WINDOW { window } else { window.min(usual) });
        Self { window, ..default }
    }

    /// Smooths one frame. A new state (after a loss of the face) lets the first frames pass as they are.
    pub fn process(&self, state: &mut FiltersState, corrected: &Corrected, _dt_s: f32) -> Smoothed {
        let mut out = corrected.0;
        let settings = self.window.iter().zip(&self.min_gate);
        for (index, (value, (window, min_gate))) in out.iter_mut().zip(settings).enumerate() {
            let window = usize::from(*window).min(state.filled);
            let previous = state.frames.iter().take(window).filter_map(|frame| frame.get(index).copied());
            *value = gated(*value, previous, *min_gate, self.edge);
        }
        state.push(out);
        Smoothed(out)
    }
}

impl FiltersState {
    fn push(&mut self, frame: [f32; COEFFS]) {
        self.frames.rotate_right(1);
        if let Some(newest) = self.frames.first_mut() {
            *newest = frame;
        }
        self.filled = (self.filled + 1).min(MAX_WINDOW);
    }
}

/// Eq. 11 for one value. Fewer than two previous values have no deviation: the value passes.
fn gated(value: f32, previous: impl Iterator<Item = f32> + Clone, min_gate: f32, edge: GateEdge) -> f32 {
    let (count, sum) = previous.clone().fold((0.0_f32, 0.0), |(count, sum), f| (count + 1.0, sum + f));
    if count < 2.0 {
        return value;
    }
    let average = sum / count;
    let variance = previous.map(|f| (f - average) * (f - average)).sum::<f32>() / (count - 1.0);
    let gate = variance.sqrt().max(min_gate).max(f32::EPSILON);
    average + share(((value - average) / gate).abs(), count, edge) * (value - average)
}

/// Share of the new value, `distance` gates away from the average of `count` previous ones.
fn share(distance: f32, count: f32, edge: GateEdge) -> f32 {
    let inside = 1.0 / (count + 1.0);
    match edge {
        _ if distance > 1.0 => 1.0,
        GateEdge::Step => inside,
        GateEdge::Smooth => inside + (1.0 - inside) * distance.powi(4),
    }
}

#[cfg(test)]
#[allow(clippy::indexing_slicing)]
mod tests {
    use super::*;

    const JAW_OPEN: usize = 17;

    fn run(filter: &Filters, signal: &[f32]) -> Vec<f32> {
        let mut state = FiltersState::default();
        signal.iter().map(|f| filter.process(&mut state, &Corrected([*f; COEFFS]), 0.03).0[JAW_OPEN]).collect()
    }

    fn printed() -> Filters {
        Filters { min_gate: [0.0; COEFFS], edge: GateEdge::Step, ..Filters::default() }
    }

    #[test]
    fn printed_form_averages_within_the_deviation_and_passes_what_is_outside() {
        let mut state = FiltersState::default();
        for f in [0.1, 0.3, 0.1, 0.3, 0.2] {
            state.push([f; COEFFS]);
        }
        let inside = printed().process(&mut state.clone(), &Corrected([0.25; COEFFS]), 0.03);
        assert!((inside.0[JAW_OPEN] - (0.25 + 5.0 * 0.2) / 6.0).abs() < 1e-6);
        let outside = printed().process(&mut state, &Corrected([0.35; COEFFS]), 0.03);
        assert!((outside.0[JAW_OPEN] - 0.35).abs() < 1e-6);
    }

    #[test]
    fn sudden_move_passes_undelayed() {
        let out = run(&Filters::default(), &[0.0, 0.01, 0.0, 0.01, 0.0, 0.9]);
        assert!((out[5] - 0.9).abs() < 1e-6);
    }

    #[test]
    fn smooth_edge_lets_near_values_come_out_near() {
        let signal = |last| [0.2, 0.2, 0.2, 0.2, 0.2, last];
        let out = |last| run(&Filters::default(), &signal(last))[5];
        assert!((out(0.251) - out(0.249)).abs() < 0.015, "across the edge of the gate");
        assert!(out(0.21) < 0.203, "well inside");
    }

    #[test]
    fn still_value_is_reached_in_the_end() {
        let mut signal = vec![0.5; 6];
        signal.extend([0.53; 60]);
        assert!((run(&Filters::default(), &signal)[65] - 0.53).abs() < 1e-3);
    }

    #[test]
    fn jitter_of_a_still_face_at_least_halves() {
        let mut seed = 7_u32;
        let signal: Vec<f32> = (0..2000)
            .map(|_| {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                0.3 + 0.02 * (f32::from(seed.to_be_bytes()[0]) / 255.0 - 0.5)
            })
            .collect();
        let jitter = |x: &[f32]| x.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f32>();
        assert!(jitter(&run(&Filters::default(), &signal)) < 0.5 * jitter(&signal));
    }

    #[test]
    fn first_frames_after_a_loss_pass_as_they_are() {
        let out = run(&Filters::default(), &[0.4, 0.5]);
        assert!((out[0] - 0.4).abs() < 1e-6 && (out[1] - 0.5).abs() < 1e-6);
    }
}
