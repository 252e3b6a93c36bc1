//! `F`: the filters that smooth a value over time.
//!
//! A value is a point of `N` numbers: a coefficient is one number, the head's position three, its rotation four. Every
//! kind returns a weighted mean of what it was given, so that its output lies between the least and the greatest input.
//! A filter goes by the time between frames and not by their number, so that a setting means the same at every frame
//! rate. The settings ([`Filter`]) are separate from what is remembered ([`FilterState`]), so that either can be
//! replaced while the other stays. Nothing is on the heap.
//!
//! All kinds have the same two settings, so that they can be exchanged and compared. The first is the time over which
//! small changes are averaged: the window of the averages. An average over a window of `T` delays by `T / 2`, and so does
//! a low pass with a time constant of `T / 2`, which also reduces noise by as much. The second is how large a change is
//! still small, for the kinds that let large changes pass.

mod gated_average;
mod kalman;
mod one_euro;
#[cfg(test)]
#[allow(clippy::float_cmp)]
pub(super) mod tests;
mod window;

use gated_average::Past;
use kalman::Estimate;
use one_euro::Motion;
use window::Window;

/// Longest time between two frames that belong together, seconds: the longest time of the settings. After a longer one a
/// filter starts anew.
pub(super) const LONGEST_STEP_S: f32 = 0.35;

/// How a value is smoothed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filter {
    /// The kind of filter.
    pub kind: FilterKind,
    /// Time over which small changes are averaged, seconds. 0 turns the filter off.
    pub time_s: f32,
    /// Size of a change that is no longer small. Above 0.
    pub noise_size: f32,
}

/// A kind of filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FilterKind {
    /// Every value passes unchanged.
    Off,
    /// A Kalman filter of a random walk, which trusts a value the more, the farther it lies outside of the noise.
    Kalman,
    /// The mean of the values of a time (eq. 9).
    MovingAverage,
    /// The mean of the values of a time, weighted by their age: after half of the time, the weight has fallen to `1/e`.
    TimeWeightedAverage,
    /// A low pass of first order.
    LowPass,
    /// Small changes are averaged, large ones pass (eq. 9 to 11).
    GatedAverage,
    /// A low pass whose cutoff frequency rises with the speed of the movement.
    OneEuro,
}

/// What a [`Filter`] remembers between frames. A state that another kind of filter left counts as empty,
/// except that both averages over a window share theirs.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) enum FilterState<const N: usize> {
    #[default]
    Empty,
    Kalman(Estimate<N>),
    Window(Window<N>),
    /// The last output.
    LowPass([f32; N]),
    GatedAverage(Past<N>),
    OneEuro(Motion<N>),
}

impl Filter {
    /// The filter that changes nothing.
    pub const OFF: Self = Self { kind: FilterKind::Off, time_s: 0.0, noise_size: 1.0 };

    /// The filter in a picture that is noisier by a factor of `level`: larger changes are small, too.
    pub(super) fn at_noise_level(self, level: f32) -> Self {
        Self { noise_size: level * self.noise_size, ..self }
    }

    /// Filters the value `x` of a frame that was captured `dt_s` seconds after the last one.
    ///
    /// A value that is not finite is returned as it is and empties the state, so that it affects no later frame. After
    /// more than [`LONGEST_STEP_S`] seconds, or a time that is not a number, the filter starts anew.
    pub(super) fn step<const N: usize>(&self, state: &mut FilterState<N>, x: [f32; N], dt_s: f32) -> [f32; N] {
        let kind = if self.time_s > 0.0 { self.kind } else { FilterKind::Off };
        if !x.iter().all(|value| value.is_finite()) {
            *state = FilterState::Empty;
            return x;
        }
        if !(0.0..=LONGEST_STEP_S).contains(&dt_s) {
            *state = FilterState::Empty;
        }
        match (kind, &mut *state) {
            (FilterKind::Kalman, FilterState::Kalman(estimate)) => estimate.step(self, x, dt_s),
            (FilterKind::MovingAverage, FilterState::Window(window)) => {
                window.push(x, dt_s, self.time_s);
                window.mean(self.time_s)
            }
            (FilterKind::TimeWeightedAverage, FilterState::Window(window)) => {
                window.push(x, dt_s, self.time_s);
                window.weighted_mean(self.time_s)
            }
            (FilterKind::LowPass, FilterState::LowPass(last)) => {
                *last = towards(*last, x, passed(dt_s, 0.5 * self.time_s));
                *last
            }
            (FilterKind::GatedAverage, FilterState::GatedAverage(past)) => past.step(self, x, dt_s),
            (FilterKind::OneEuro, FilterState::OneEuro(motion)) => motion.step(self, x, dt_s),
            _ => {
                *state = self.start(kind, x);
                x
            }
        }
    }

    /// The state after a first value.
    fn start<const N: usize>(&self, kind: FilterKind, x: [f32; N]) -> FilterState<N> {
        match kind {
            FilterKind::Off => FilterState::Empty,
            FilterKind::Kalman => FilterState::Kalman(Estimate::starting_with(self, x)),
            FilterKind::MovingAverage | FilterKind::TimeWeightedAverage => {
                FilterState::Window(Window::starting_with(x))
            }
            FilterKind::LowPass => FilterState::LowPass(x),
            FilterKind::GatedAverage => FilterState::GatedAverage(Past::starting_with(x)),
            FilterKind::OneEuro => FilterState::OneEuro(Motion::starting_with(x)),
        }
    }
}

/// The share of a change that a low pass with this time constant lets pass within `dt_s`. The time constant is above 0.
pub(super) fn passed(dt_s: f32, time_constant_s: f32) -> f32 {
    -(-dt_s / time_constant_s).exp_m1()
}

/// The point on the way from `from` to `to` after this share of it.
fn towards<const N: usize>(mut from: [f32; N], to: [f32; N], share: f32) -> [f32; N] {
    approach(&mut from, &to, share);
    from
}

/// Moves values towards others by a share of the difference.
pub(super) fn approach<const N: usize>(values: &mut [f32; N], to: &[f32; N], share: f32) {
    values.iter_mut().zip(to).for_each(|(value, to)| *value += share * (to - *value));
}

/// `a - b`.
pub(super) fn difference<const N: usize>(a: [f32; N], b: [f32; N]) -> [f32; N] {
    let mut out = a;
    out.iter_mut().zip(b).for_each(|(value, b)| *value -= b);
    out
}

/// Adds `weight` times `point` to `sum`.
pub(super) fn add<const N: usize>(sum: &mut [f32; N], weight: f32, point: [f32; N]) {
    sum.iter_mut().zip(point).for_each(|(sum, value)| *sum += weight * value);
}

/// The square of the length of a vector.
pub(super) fn square<const N: usize>(point: [f32; N]) -> f32 {
    point.iter().map(|value| value * value).sum()
}
