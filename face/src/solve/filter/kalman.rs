//! A Kalman filter for each value by itself.
//!
//! The model is a random walk: `y += w` with a variance of `q dt`, seen as `x = y + v` with the camera's noise `v`. The
//! noise is taken as white with a fixed density, so that frames that come twice as fast are each twice as noisy. Then
//! the filter settles to a time constant of `sqrt(R / q)`, whatever the frame rate, and `q` follows from the time of
//! the settings.
//!
//! A face holds still and then moves suddenly, which a random walk does not. So when a value lies more than
//! [`OUTSIDE`] standard deviations from what the filter expects, the variance of the estimate is raised until the value
//! lies on that limit. The farther a value lies outside, the larger is then the share of it that passes.

use super::{Filter, difference, square, towards};

/// Standard deviations within which a value counts as noise.
const OUTSIDE: f32 = 3.0;
/// Time between frames at which the noise of the settings is meant, seconds.
const FRAME_S: f32 = 1.0 / 30.0;

/// The estimate of a Kalman filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate<const N: usize> {
    value: [f32; N],
    variance: f32,
}

/// Variance of the noise of one frame at 30 frames a second: a change that is no longer small lies outside of it.
fn noise(filter: &Filter) -> f32 {
    (filter.noise_size / OUTSIDE).powi(2).max(f32::MIN_POSITIVE)
}

impl<const N: usize> Estimate<N> {
    pub fn starting_with(filter: &Filter, value: [f32; N]) -> Self {
        Self { value, variance: noise(filter) }
    }

    pub fn step(&mut self, filter: &Filter, x: [f32; N], dt_s: f32) -> [f32; N] {
        // The density of the noise, R. That of one frame is R / dt.
        let density = noise(filter) * FRAME_S;
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

#[cfg(test)]
mod tests {
    use super::super::{FilterKind, FilterState};
    use super::*;

    const FILTER: Filter = Filter { kind: FilterKind::Kalman, time_s: 0.2, noise_size: 0.03 };

    fn run(fps: f32, signal: impl IntoIterator<Item = f32>) -> Vec<f32> {
        let mut state = FilterState::Empty;
        signal.into_iter().map(|x| FILTER.step(&mut state, [x], 1.0 / fps)).map(|[y]| y).collect()
    }

    #[test]
    fn small_step_takes_the_time_constant_at_every_frame_rate() {
        for fps in [30.0_f32, 60.0, 120.0] {
            let out = run(fps, [0.5; 200].into_iter().chain([0.52; 200]));
            let reached = out.iter().skip(200).position(|y| *y > 0.5 + 0.02 * 0.632);
            let seconds = reached.map_or(f32::NAN, |frames| frames as f32 / fps);
            assert!((0.06..0.11).contains(&seconds), "{fps} frames a second: {seconds} s");
        }
    }

    #[test]
    fn first_values_are_averaged_as_equals() {
        let out = run(30.0, [0.50, 0.52]);
        assert!(out.iter().skip(1).all(|y| (0.510..0.515).contains(y)), "{out:?}");
    }

    #[test]
    fn the_farther_outside_of_the_noise_the_larger_the_share_that_passes() {
        let share = |step: f32| (run(30.0, [0.0; 100].into_iter().chain([step])).last().unwrap_or(&0.0)) / step;
        assert!(share(0.02) < 0.4 && share(0.06) > 0.7 && share(0.3) > 0.98);
    }
}
