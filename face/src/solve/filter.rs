//! The filters (`F` in the paper) that smooth a value over time. A value is a point of `N` numbers.
//!
//! Every kind returns a weighted mean of its inputs and has the same two settings, and every kind but the gated average as
//! printed goes by the time between frames and not by their number. An average over a window of `T` delays by `T / 2`, and so
//! does a low pass with a time constant of `T / 2`, which also reduces noise by as much. The gated average as printed counts
//! the values within its time instead.

mod averages;

use averages::{Past, Window};

/// Longest time between two frames that belong together, seconds. After a longer one a filter starts anew.
pub(super) const LONGEST_STEP_S: f32 = 0.35;
/// Time between frames to which [`Filter::noise_size`] refers, seconds.
pub(super) const FRAME_S: f32 = 1.0 / 30.0;

/// How a value is smoothed.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub struct Filter {
    /// The kind of filter.
    pub kind: FilterKind,
    /// Time over which small changes are averaged, seconds. 0 turns the filter off.
    pub time_s: f32,
    /// Size of a change that is no longer small, for the kinds that let large changes pass. Above 0.
    pub noise_size: f32,
}

/// A kind of filter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
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
    /// The gated average exactly as the paper prints it, for comparison. On a still face its gate closes, and noise passes.
    GatedAsPrinted,
    /// A low pass whose cutoff frequency rises with the speed of the movement.
    OneEuro,
}

impl FilterKind {
    /// Every kind with its name in the settings.
    pub const NAMES: &[(&str, Self)] = &[
        ("off", Self::Off),
        ("kalman", Self::Kalman),
        ("moving-average", Self::MovingAverage),
        ("time-weighted-average", Self::TimeWeightedAverage),
        ("low-pass", Self::LowPass),
        ("gated-average", Self::GatedAverage),
        ("gated-as-printed", Self::GatedAsPrinted),
        ("one-euro", Self::OneEuro),
    ];
}

/// What a [`Filter`] remembers. A state that another kind left counts as empty; both averages over a window share theirs,
/// and so do both gated averages.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) enum FilterState<const N: usize> {
    #[default]
    Empty,
    Kalman(Estimate<N>),
    Window(Window<N>),
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

    /// Filters the value `x` of a frame that was captured `dt_s` seconds after the last one. A value that is not finite
    /// is returned as it is and affects no later frame.
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
                window.push(x, dt_s, self.time_s).mean(self.time_s)
            }
            (FilterKind::TimeWeightedAverage, FilterState::Window(window)) => {
                window.push(x, dt_s, self.time_s).weighted_mean(self.time_s)
            }
            (FilterKind::LowPass, FilterState::LowPass(last)) => {
                *last = towards(*last, x, passed(dt_s, 0.5 * self.time_s));
                *last
            }
            (FilterKind::GatedAverage, FilterState::GatedAverage(past)) => past.step(self, x, dt_s),
            (FilterKind::GatedAsPrinted, FilterState::GatedAverage(past)) => past.step_as_printed(self.time_s, x, dt_s),
            (FilterKind::OneEuro, FilterState::OneEuro(motion)) => motion.step(self, x, dt_s),
            _ => {
                *state = self.start(kind, x);
                x
            }
        }
    }

    fn start<const N: usize>(&self, kind: FilterKind, x: [f32; N]) -> FilterState<N> {
        match kind {
            FilterKind::Off => FilterState::Empty,
            FilterKind::Kalman => FilterState::Kalman(Estimate { value: x, variance: self.noise_variance() }),
            FilterKind::MovingAverage | FilterKind::TimeWeightedAverage => FilterState::Window(Window::new(x)),
            FilterKind::LowPass => FilterState::LowPass(x),
            FilterKind::GatedAverage | FilterKind::GatedAsPrinted => FilterState::GatedAverage(Past::new(x)),
            FilterKind::OneEuro => FilterState::OneEuro(Motion { value: x, speed: [0.0; N] }),
        }
    }

    /// Variance of the noise of one frame at 30 frames a second: a change that is no longer small lies outside of it.
    fn noise_variance(&self) -> f32 {
        (self.noise_size / OUTSIDE).powi(2).max(f32::MIN_POSITIVE)
    }
}

/// Standard deviations within which a value counts as noise for the Kalman filter.
const OUTSIDE: f32 = 3.0;

/// The estimate of a Kalman filter of a random walk, `y += w` with a variance of `q dt`, seen as `x = y + v` with white
/// noise `v` of a fixed density `R`. It settles to a time constant of `sqrt(R / q)`, whatever the frame rate.
///
/// A face holds still and then moves suddenly, which a random walk does not. So when a value lies more than
/// [`OUTSIDE`] standard deviations from what is expected, the variance is raised until the value lies on that limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Estimate<const N: usize> {
    value: [f32; N],
    variance: f32,
}

impl<const N: usize> Estimate<N> {
    fn step(&mut self, filter: &Filter, x: [f32; N], dt_s: f32) -> [f32; N] {
        // The density of the noise, R. That of one frame is R / dt.
        let density = filter.noise_variance() * FRAME_S;
        let time_constant_s = 0.5 * filter.time_s;
        let expected = self.variance + density * dt_s / (time_constant_s * time_constant_s);
        let needed = square(difference(x, self.value)) / (OUTSIDE * OUTSIDE) - density / dt_s.max(f32::MIN_POSITIVE);
        let variance = expected.max(needed);
        let gain = variance * dt_s / (variance * dt_s + density);
        self.value = towards(self.value, x, gain);
        self.variance = (1.0 - gain) * variance;
        self.value
    }
}

/// Time constant of One Euro's low pass of the speed, seconds: 1 Hz.
const SPEED_TIME_CONSTANT_S: f32 = 0.159;

/// The last output of a One Euro filter (Casiez, Roussel, Vogel, CHI 2012), and its speed in units a second, which is
/// measured from the last output and smoothed by a low pass of 1 Hz. The time constant is
/// `1 / (2/time_s + |speed|/noise_size)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion<const N: usize> {
    value: [f32; N],
    speed: [f32; N],
}

impl<const N: usize> Motion<N> {
    fn step(&mut self, filter: &Filter, x: [f32; N], dt_s: f32) -> [f32; N] {
        let change = difference(x, self.value);
        // The speed is the change divided by the time, which may be 0.
        let share = passed(dt_s, SPEED_TIME_CONSTANT_S);
        let per_second = if dt_s > 1e-4 { share / dt_s } else { 1.0 / SPEED_TIME_CONSTANT_S };
        self.speed = towards(self.speed, [0.0; N], share);
        add(&mut self.speed, per_second, change);
        let speed = square(self.speed).sqrt() / filter.noise_size;
        self.value = towards(self.value, x, passed(dt_s, 1.0 / (2.0 / filter.time_s + speed)));
        self.value
    }
}

/// The share of a change that a low pass with this time constant lets pass within `dt_s`. The time constant is above 0.
pub(super) fn passed(dt_s: f32, time_constant_s: f32) -> f32 {
    -(-dt_s / time_constant_s).exp_m1()
}

/// The point on the way from `from` to `to` after this share of it, and exactly `from` or `to` for 0 or 1.
pub(super) fn towards<const N: usize>(mut from: [f32; N], to: [f32; N], share: f32) -> [f32; N] {
    if share > 0.0 {
        approach(&mut from, &to, share);
    }
    if share < 1.0 { from } else { to }
}

/// Moves values towards others by a share of the difference.
pub(super) fn approach<const N: usize>(values: &mut [f32; N], to: &[f32; N], share: f32) {
    values.iter_mut().zip(to).for_each(|(value, to)| *value += share * (to - *value));
}

pub(super) fn distance<const N: usize>(a: &[f32; N], b: &[f32; N]) -> f32 {
    square(difference(*a, *b)).sqrt()
}

pub(super) fn difference<const N: usize>(mut a: [f32; N], b: [f32; N]) -> [f32; N] {
    a.iter_mut().zip(b).for_each(|(value, b)| *value -= b);
    a
}

pub(super) fn add<const N: usize>(sum: &mut [f32; N], weight: f32, point: [f32; N]) {
    sum.iter_mut().zip(point).for_each(|(sum, value)| *sum += weight * value);
}

pub(super) fn square<const N: usize>(point: [f32; N]) -> f32 {
    point.iter().map(|value| value * value).sum()
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
pub(super) mod tests {
    use super::*;

    /// Every kind of filter.
    pub(in crate::solve) const KINDS: [FilterKind; 8] = {
        use FilterKind::{
            GatedAsPrinted, GatedAverage, Kalman, LowPass, MovingAverage, Off, OneEuro, TimeWeightedAverage,
        };
        [Off, Kalman, MovingAverage, TimeWeightedAverage, LowPass, GatedAverage, GatedAsPrinted, OneEuro]
    };

    fn filters() -> impl Iterator<Item = Filter> {
        KINDS.into_iter().map(|kind| Filter { kind, time_s: 0.18, noise_size: 0.05 })
    }

    /// What a filter makes of pairs of a value and the time since the one before.
    fn run(filter: &Filter, signal: impl IntoIterator<Item = (f32, f32)>) -> Vec<f32> {
        let mut state = FilterState::Empty;
        signal.into_iter().map(|(x, dt_s)| filter.step(&mut state, [x], dt_s)).map(|[y]| y).collect()
    }

    /// Values from 0 to 1 at irregular times, with pauses, repeated times and far too many frames a second.
    fn irregular(seed: u64) -> impl Iterator<Item = (f32, f32)> {
        let mut random = fastrand::Rng::with_seed(seed);
        core::iter::repeat_with(move || (random.f32(), [0.0, 1e-6, 0.004, FRAME_S, 0.2, 9.0][random.usize(..6)]))
    }

    #[test]
    fn outputs_lie_between_the_least_and_the_greatest_input_whatever_the_times() {
        for (filter, seed) in filters().flat_map(|filter| (0..20).map(move |seed| (filter, seed))) {
            let out = run(&filter, irregular(seed).map(|(x, dt_s)| (0.3 + 0.1 * x, dt_s)).take(500));
            assert!(out.iter().all(|y| (0.3 - 1e-6..=0.4 + 1e-6).contains(y)), "{filter:?}, seed {seed}");
        }
    }

    #[test]
    fn filter_starts_anew_after_a_value_that_is_not_finite_and_after_an_impossible_or_long_time() {
        let steps = [(f32::NAN, FRAME_S), (f32::INFINITY, FRAME_S), (0.5, 10.0), (0.5, f32::NAN), (0.5, -0.02)];
        for (filter, step) in filters().flat_map(|filter| steps.map(|step| (filter, step))) {
            let after: Vec<_> = [step].into_iter().chain(irregular(2).take(50)).collect();
            let out = run(&filter, irregular(1).take(50).chain(after.clone()));
            assert_eq!(out[50].is_finite(), step.0.is_finite(), "{filter:?} hides a fault");
            assert_eq!(out[51..], run(&filter, after)[1..], "{filter:?} {step:?}");
        }
    }

    #[test]
    fn filter_of_another_kind_starts_anew() {
        for [before, after] in filters().flat_map(|a| filters().map(move |b| [a, b])) {
            let start = |filter: Filter| core::mem::discriminant(&filter.start(filter.kind, [0.0]));
            if start(before) == start(after) {
                continue;
            }
            let mut state = FilterState::Empty;
            (1_u8..9).for_each(|x| _ = before.step(&mut state, [f32::from(x)], FRAME_S));
            assert_eq!(after.step(&mut state, [0.4], FRAME_S), [0.4], "{before:?}, then {after:?}");
            let off = Filter { time_s: 0.0, ..before };
            (1_u8..9).for_each(|x| assert_eq!(off.step(&mut state, [x.into()], FRAME_S), [f32::from(x)], "{off:?}"));
        }
    }

    #[test]
    fn value_that_stays_is_reached_within_a_second_at_every_frame_rate() {
        for (filter, fps) in filters().flat_map(|filter| [10_u16, 30, 60, 240].map(|fps| (filter, fps))) {
            for step in [0.02, 0.5] {
                let frame_s = 1.0 / f32::from(fps);
                let signal = [(0.1, frame_s); 300].into_iter().chain([(0.1 + step, frame_s); 480]);
                let after_1_s = run(&filter, signal)[300 + usize::from(fps)];
                assert!((after_1_s - 0.1 - step).abs() < 0.15 * step, "{filter:?}, {fps} frames a second: {after_1_s}");
            }
        }
    }

    #[test]
    fn noise_of_a_value_that_stays_is_smoothed_to_less_than_two_thirds_but_by_the_printed_gate() {
        let mut random = fastrand::Rng::with_seed(4);
        let noise: Vec<f32> = (0..900).map(|_| 0.5 + 0.02 * (random.f32() - 0.5)).collect();
        let deviation = |x: &[f32]| (x.iter().map(|x| (x - 0.5).powi(2)).sum::<f32>() / x.len() as f32).sqrt();
        for (filter, fps) in filters().skip(1).flat_map(|filter| [30.0, 60.0].map(|fps| (filter, fps))) {
            let out = run(&filter, noise.iter().map(|x| (*x, 1.0 / fps)));
            let left = deviation(&out[30..]) / deviation(&noise);
            let closes = filter.kind == FilterKind::GatedAsPrinted;
            assert_eq!(left < 0.66, !closes, "{filter:?}, {fps} frames a second: {left}");
        }
    }

    /// The response, frame by frame, to a step from 0.5.
    pub(super) fn step_response(kind: FilterKind, fps: f32, size: f32) -> Vec<f32> {
        let filter = Filter { kind, time_s: 0.2, noise_size: 0.03 };
        let signal = [0.5; 200].into_iter().chain([0.5 + size; 400]);
        run(&filter, signal.map(|x| (x, 1.0 / fps))).split_off(200)
    }

    #[test]
    fn small_step_is_followed_as_fast_at_every_frame_rate() {
        let times_s = [
            (FilterKind::LowPass, [0.06..0.14, 0.19..0.28]),
            (FilterKind::Kalman, [0.06..0.11, 0.15..0.28]),
            (FilterKind::GatedAverage, [0.4..0.6, 1.3..1.7]),
        ];
        for ((kind, [nearly, all]), fps) in
            times_s.into_iter().flat_map(|row| [30.0_f32, 60.0, 120.0].map(|fps| (row.clone(), fps)))
        {
            let out = step_response(kind, fps, 0.02);
            let reached_s =
                |share: f32| out.iter().position(|y| *y > 0.5 + 0.02 * share).map_or(9.9, |frames| frames as f32 / fps);
            let [mostly_s, nearly_s] = [0.632, 0.9].map(reached_s);
            assert!(nearly.contains(&mostly_s) && all.contains(&nearly_s), "{kind:?}, {fps}: {mostly_s} {nearly_s} s");
        }
    }

    #[test]
    fn the_farther_outside_of_the_noise_the_larger_the_share_that_passes() {
        for (kind, least) in [(FilterKind::Kalman, [0.7, 0.98]), (FilterKind::OneEuro, [0.5, 0.88])] {
            let share = |size: f32| (step_response(kind, 30.0, size)[0] - 0.5) / size;
            assert!(share(0.02) < 0.4 && share(0.06) > least[0] && share(0.3) > least[1], "{kind:?}");
        }
        let filter = Filter { kind: FilterKind::Kalman, time_s: 0.2, noise_size: 0.03 };
        let second = run(&filter, [(0.50, FRAME_S), (0.52, FRAME_S)])[1];
        assert!((0.510..0.515).contains(&second), "the first values are averaged as equals: {second}");
    }
}
