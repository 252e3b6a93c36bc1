//! How noisy the coefficients are, so that filters can tell noise from movement in a dark picture, too.
//!
//! A camera amplifies its noise with a dark picture: coefficients of a still face then tremble 20 times as much as in good
//! light. A change counts as small up to a few times the noise, so the size of a small change follows the noise.
//!
//! Noise shows in the second differences of a coefficient. So does movement, but only a part of the face moves at a time:
//! the level is the one that 30 % of the coefficients stay below, on average over about a second.

use super::{COEFFS, filter::LONGEST_STEP_S, smoothing::SMALL};

/// Share of the coefficients that stay below the level.
const STILL_SHARE: f32 = 0.3;
/// Second difference that 30 % stay below if the standard deviation of the noise is an eighth of a small change, relative
/// to the small change: `0.385 * sqrt(6) / 8`.
const REFERENCE: f32 = 0.118;
/// Speed at which the level follows, per second.
const RATE: f32 = 10.0;
/// The least and the greatest level.
const LEVELS: [f32; 2] = [1.0, 5.0];

/// The noise of the last frames, relative to that for which the sizes of small changes are meant.
#[derive(Debug, Clone, PartialEq)]
pub struct NoiseLevel {
    level: f32,
    /// The last frame and the one before.
    last: Option<([f32; COEFFS], Option<[f32; COEFFS]>)>,
}

impl Default for NoiseLevel {
    fn default() -> Self {
        Self { level: LEVELS[0], last: None }
    }
}

impl NoiseLevel {
    /// Takes a frame that was captured `dt_s` seconds after the last one, and returns the level.
    pub fn step(&mut self, values: &[f32; COEFFS], dt_s: f32) -> f32 {
        let last = self.last.take().filter(|_| (0.0..=LONGEST_STEP_S).contains(&dt_s));
        if let Some((last, Some(before))) = &last {
            let (mut above, mut count) = (0.0_f32, 0.0_f32);
            for (((value, last), before), small) in values.iter().zip(last).zip(before).zip(&SMALL) {
                let second = (value - 2.0 * last + before).abs();
                // A coefficient that is 0 all the time tells nothing.
                if second > 0.0 {
                    count += 1.0;
                    above += f32::from(second > self.level * REFERENCE * small);
                }
            }
            if count > 0.0 {
                let change = RATE * dt_s * (above / count - (1.0 - STILL_SHARE));
                self.level = (self.level * change.exp()).clamp(LEVELS[0], LEVELS[1]);
            }
        }
        self.last = Some((*values, last.map(|(last, _)| last)));
        self.level
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME_S: f32 = 1.0 / 30.0;

    /// The level after 3 seconds of noise with this deviation in units of a small change, of which the first
    /// `moving` coefficients also swing widely.
    fn level(deviation: f32, moving: usize) -> f32 {
        let mut random = fastrand::Rng::with_seed(2);
        let mut level = NoiseLevel::default();
        let mut frame = |number: u16| {
            let mut values = [0.5; COEFFS];
            for (index, (value, small)) in values.iter_mut().zip(&SMALL).enumerate() {
                // The sum of 12 has a deviation of 1.
                let noise: f32 = (0..12).map(|_| random.f32() - 0.5).sum();
                let swing = if index < moving { 0.3 * (0.9 * f32::from(number)).sin() } else { 0.0 };
                *value += deviation * small * noise + swing;
            }
            level.step(&values, FRAME_S)
        };
        (0..90).map(&mut frame).last().unwrap_or(0.0)
    }

    #[test]
    fn level_follows_the_noise_and_not_the_movement_of_half_of_the_face() {
        assert!((level(0.01, 0) - 1.0).abs() < 0.01 && (level(0.01, 30) - 1.0).abs() < 0.01);
        assert!((1.7..2.3).contains(&level(0.25, 0)), "{}", level(0.25, 0));
        assert!((3.0..=4.0).contains(&level(0.44, 0)), "{}", level(0.44, 0));
    }

    #[test]
    fn values_and_times_that_are_not_numbers_leave_a_level() {
        let mut level = NoiseLevel::default();
        for (value, dt_s) in [(0.1, FRAME_S), (f32::NAN, FRAME_S), (0.3, f32::NAN), (0.1, FRAME_S), (0.2, -1.0)] {
            assert!((1.0..=5.0).contains(&level.step(&[value; COEFFS], dt_s)));
        }
    }
}
