//! The One Euro filter: a low pass whose cutoff frequency rises with the speed of the movement.
//!
//! > Géry Casiez, Nicolas Roussel, Daniel Vogel: *1€ Filter: A Simple Speed-based Low-pass Filter for Noisy Input in
//! > Interactive Systems.* CHI 2012.
//!
//! The speed is measured from the last output, and is itself smoothed by a low pass of 1 Hz. The time constant of the
//! filter is `1 / (2/T + |speed| / small)`: half of the time of the settings for a face at rest, and one frame for a
//! movement of one small change a frame.

use super::{Filter, add, difference, passed, square, towards};

/// Time constant of the low pass of the speed, seconds: 1 Hz.
const SPEED_TIME_CONSTANT_S: f32 = 0.159;

/// The last output and its speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion<const N: usize> {
    value: [f32; N],
    /// Units a second.
    speed: [f32; N],
}

impl<const N: usize> Motion<N> {
    pub fn starting_with(value: [f32; N]) -> Self {
        Self { value, speed: [0.0; N] }
    }

    pub fn step(&mut self, filter: &Filter, x: [f32; N], dt_s: f32) -> [f32; N] {
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

#[cfg(test)]
mod tests {
    use super::super::{FilterKind, FilterState};
    use super::*;

    const FILTER: Filter = Filter { kind: FilterKind::OneEuro, time_s: 0.2, noise_size: 0.03 };

    fn run(signal: impl IntoIterator<Item = f32>) -> Vec<f32> {
        let mut state = FilterState::Empty;
        signal.into_iter().map(|x| FILTER.step(&mut state, [x], 1.0 / 30.0)).map(|[y]| y).collect()
    }

    #[test]
    fn fast_movement_is_followed_within_a_frame_and_noise_is_smoothed() {
        let blink = run([0.0, 0.0, 0.5, 1.0, 1.0, 0.5, 0.0, 0.0]);
        assert!(blink[3] > 0.95 && blink[7] < 0.05, "{blink:?}");
        let mut random = fastrand::Rng::with_seed(5);
        let noise: Vec<f32> = (0..500).map(|_| 0.3 + 0.01 * (random.f32() - 0.5)).collect();
        let deviation = |x: &[f32]| (x.iter().map(|x| (x - 0.3).powi(2)).sum::<f32>() / x.len() as f32).sqrt();
        assert!(deviation(&run(noise.clone())) < 0.5 * deviation(&noise));
    }
}
