//! `F`: one filter per coefficient smooths it over time.
//!
//! A filter goes by the time between frames and not by their number, so that a setting means the same at every frame
//! rate. The settings ([`Filters`]) are separate from what is remembered ([`FiltersState`]), so that either can be
//! replaced while the other stays. Nothing is on the heap.

use super::{
    BLENDSHAPES, COEFFS,
    correction::Corrected,
    gated_average::{GatedAverage, Past},
};

/// Coefficients ready to be sent, each within `0..=1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Smoothed(pub [f32; COEFFS]);

/// How one coefficient is smoothed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Filter {
    /// Every value passes unchanged.
    Off,
    /// Small changes are averaged, large ones pass.
    GatedAverage(GatedAverage),
}

/// What a [`Filter`] remembers between frames. A state that another kind of filter left counts as empty.
#[derive(Debug, Clone, PartialEq, Default)]
#[expect(clippy::large_enum_variant, reason = "one for each coefficient, made once, never on the heap")]
pub enum FilterState {
    /// Nothing: the next value is the first.
    #[default]
    Empty,
    /// The last values of a [`GatedAverage`].
    GatedAverage(Past),
}

impl Filter {
    /// Filters the value `x` of a frame that was captured `dt_s` seconds after the last one.
    ///
    /// A value that is not finite is returned as it is and empties the state, so that it affects no later frame.
    pub fn step(&self, state: &mut FilterState, x: f32, dt_s: f32) -> f32 {
        match (self, &mut *state) {
            (Self::GatedAverage(filter), FilterState::GatedAverage(past)) if x.is_finite() => {
                filter.step(past, x, dt_s)
            }
            (Self::GatedAverage(_), _) if x.is_finite() => {
                *state = FilterState::GatedAverage(Past::starting_with(x));
                x
            }
            _ => {
                *state = FilterState::Empty;
                x
            }
        }
    }
}

/// The filters of all coefficients, in the order of [`BLENDSHAPES`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filters(pub [Filter; COEFFS]);

/// The states of all filters, in the same order.
#[derive(Debug, Clone, PartialEq)]
pub struct FiltersState([FilterState; COEFFS]);

impl Default for FiltersState {
    fn default() -> Self {
        Self([const { FilterState::Empty }; COEFFS])
    }
}

impl Filters {
    /// Gated averages over the last `window_s` seconds, or less for the eyes, which need little smoothing. A window of
    /// 0 turns all filters off.
    #[must_use]
    pub fn gated_average(window_s: f32) -> Self {
        let filter = |name: &str| match name.starts_with("eye") {
            _ if window_s <= 0.0 => Filter::Off,
            true => Filter::GatedAverage(GatedAverage::of_the_eyes(window_s)),
            false => Filter::GatedAverage(GatedAverage::of_the_face(window_s)),
        };
        Self(BLENDSHAPES.map(filter))
    }

    /// Filters the coefficients of a frame that was captured `dt_s` seconds after the last one.
    pub fn step(&self, state: &mut FiltersState, corrected: &Corrected, dt_s: f32) -> Smoothed {
        let mut out = corrected.0;
        for (value, (filter, state)) in out.iter_mut().zip(self.0.iter().zip(&mut state.0)) {
            *value = filter.step(state, *value, dt_s);
        }
        Smoothed(out)
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, clippy::indexing_slicing)]
mod tests {
    use super::*;

    const FRAME_S: f32 = 1.0 / 30.0;
    /// Every kind of filter.
    const KINDS: [Filter; 2] = [Filter::Off, Filter::GatedAverage(GatedAverage { window_s: 0.18, min_gate: 0.05 })];

    /// What a filter makes of pairs of a value and the time since the one before.
    fn run(filter: &Filter, signal: impl IntoIterator<Item = (f32, f32)>) -> Vec<f32> {
        let mut state = FilterState::Empty;
        signal.into_iter().map(|(x, dt_s)| filter.step(&mut state, x, dt_s)).collect()
    }

    /// Values from 0 to 1 at irregular times, with pauses, repeated times and far too many frames a second.
    fn irregular(seed: u64) -> impl Iterator<Item = (f32, f32)> {
        let mut random = fastrand::Rng::with_seed(seed);
        core::iter::repeat_with(move || (random.f32(), [0.0, 1e-6, 0.004, FRAME_S, 0.2, 9.0][random.usize(..6)]))
    }

    #[test]
    fn outputs_lie_between_the_least_and_the_greatest_input_whatever_the_times() {
        for (filter, seed) in KINDS.iter().flat_map(|filter| (0..20).map(move |seed| (filter, seed))) {
            let signal = irregular(seed).map(|(x, dt_s)| (0.3 + 0.1 * x, dt_s));
            let out = run(filter, signal.take(500));
            assert!(out.iter().all(|y| (0.3 - 1e-6..=0.4 + 1e-6).contains(y)), "{filter:?}, seed {seed}");
        }
    }

    #[test]
    fn value_that_is_not_finite_affects_no_later_frame() {
        for (filter, wrong) in KINDS.iter().flat_map(|filter| [f32::NAN, f32::INFINITY].map(|wrong| (filter, wrong))) {
            let (before, after): (Vec<_>, Vec<_>) = (irregular(1).take(50).collect(), irregular(2).take(50).collect());
            let out = run(filter, before.into_iter().chain([(wrong, FRAME_S)]).chain(after.clone()));
            assert!(!out[50].is_finite(), "{filter:?} hides a fault");
            assert_eq!(out[51..], run(filter, after));
        }
    }

    #[test]
    fn time_step_that_is_not_a_number_affects_no_later_second() {
        for filter in &KINDS {
            let (before, after): (Vec<_>, Vec<_>) = (irregular(1).take(50).collect(), irregular(2).take(99).collect());
            let out = run(filter, before.into_iter().chain([(0.5, f32::NAN)]).chain(after));
            assert!(out.iter().all(|y| y.is_finite()));
        }
    }

    #[test]
    fn long_gap_starts_a_filter_anew() {
        for filter in &KINDS {
            let after = [(0.30, 10.0), (0.32, FRAME_S), (0.31, FRAME_S), (0.33, FRAME_S)];
            let out = run(filter, irregular(3).take(50).chain(after));
            assert_eq!(out[50..], run(filter, after));
        }
    }

    #[test]
    fn filter_of_another_kind_starts_anew() {
        let mut state = FilterState::Empty;
        for x in [0.1, 0.2, 0.3] {
            KINDS[1].step(&mut state, x, FRAME_S);
        }
        KINDS[0].step(&mut state, 0.4, FRAME_S);
        assert_eq!(state, FilterState::Empty);
    }

    #[test]
    fn window_of_0_turns_every_filter_off() {
        assert_eq!(Filters::gated_average(0.0), Filters([Filter::Off; COEFFS]));
        assert!(!Filters::gated_average(0.1).0.contains(&Filter::Off));
    }
}
