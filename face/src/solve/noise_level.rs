//! How noisy the coefficients are, so that filters can tell noise from movement in a dark picture, too.
//!
//! A camera amplifies its noise with a dark picture: coefficients of a still face then tremble 20 times as much as in good
//! light. A change counts as small up to a few times the noise, so the size of a small change follows the noise.
//!
//! Noise throws a value back and forth, so that successive steps of a still face have opposite signs: the mean of their
//! product is the negative variance of the noise. Movement goes on from frame to frame, and its products are positive. The
//! noise is averaged over the coefficients and over about a second.

use super::{
    BLENDSHAPES, COEFFS,
    filter::{LONGEST_STEP_S, difference},
    smoothing::Group,
};

/// Standard deviation of the noise at level 1, that of good light, relative to a small change.
const REFERENCE: f32 = 0.125;
/// Bounds of the product of two steps, relative to the square of a small change. A coefficient that moves widely counts no
/// more than one that hardly moves.
const PRODUCTS: [f32; 2] = [-4.0, 0.5];
/// Time constant of the average, seconds.
const AVERAGE_S: f32 = 1.0;
/// The least and the greatest level. A higher one leaves less jitter in the dark, and takes more of fast expressions in noisy
/// pictures.
const LEVELS: [f32; 2] = [1.0, 2.0];

/// The noise of the last frames, relative to that for which the sizes of small changes are meant.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct NoiseLevel {
    /// From this size on, a change of each coefficient is no longer small in good light.
    sizes: [f32; COEFFS],
    /// Mean product of successive steps, relative to the square of a small change.
    product: f32,
    /// The last frame, and its steps from the one before.
    last: Option<([f32; COEFFS], Option<[f32; COEFFS]>)>,
}

impl Default for NoiseLevel {
    fn default() -> Self {
        Self { sizes: BLENDSHAPES.map(|name| Group::of(name).noise_size()), product: 0.0, last: None }
    }
}

impl NoiseLevel {
    /// Takes a frame that was captured `dt_s` seconds after the last one, and returns the level.
    pub(super) fn step(&mut self, values: &[f32; COEFFS], dt_s: f32) -> f32 {
        let last = self.last.take().filter(|_| (0.0..=LONGEST_STEP_S).contains(&dt_s));
        let steps = last.map(|(last, before)| {
            let steps = difference(*values, last);
            if let Some(product) = before.and_then(|before| mean_product(&steps, &before, &self.sizes)) {
                self.product += (1.0 - (-dt_s / AVERAGE_S).exp()) * (product - self.product);
            }
            steps
        });
        self.last = Some((*values, steps));
        let [lowest, highest] = LEVELS;
        ((-self.product).max(0.0).sqrt() / REFERENCE).clamp(lowest, highest)
    }
}

/// The mean product of the steps of the coefficients that move at all. `None` if none does.
fn mean_product(steps: &[f32; COEFFS], before: &[f32; COEFFS], sizes: &[f32; COEFFS]) -> Option<f32> {
    let [least, greatest] = PRODUCTS;
    let (mut sum, mut count) = (0.0_f32, 0.0_f32);
    for ((step, before), size) in steps.iter().zip(before).zip(sizes) {
        let product = step * before / (size * size);
        // A coefficient that is 0 all the time tells nothing, and neither does a value that is not a number.
        if product != 0.0 && product.is_finite() {
            (sum, count) = (sum + product.clamp(least, greatest), count + 1.0);
        }
    }
    (count > 0.0).then(|| sum / count)
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
            for (index, (value, size)) in values.iter_mut().zip(level.sizes).enumerate() {
                // The sum of 12 has a deviation of 1.
                let noise: f32 = (0..12).map(|_| random.f32() - 0.5).sum();
                let swing = if index < moving { 0.3 * (0.4 * f32::from(number)).sin() } else { 0.0 };
                *value += deviation * size * noise + swing;
            }
            level.step(&values, FRAME_S)
        };
        (0..90).map(&mut frame).last().unwrap_or(0.0)
    }

    #[test]
    fn level_follows_the_noise_and_not_the_movement_even_of_the_whole_face() {
        assert!([0, 30, COEFFS].iter().all(|moving| (level(0.01, *moving) - 1.0).abs() < 0.01));
        assert!((level(0.44, 0) - 2.0).abs() < 0.01, "{}", level(0.44, 0));
        assert!((1.4..1.8).contains(&level(0.2, 0)), "{}", level(0.2, 0));
    }

    #[test]
    fn values_and_times_that_are_not_numbers_leave_a_level() {
        let mut level = NoiseLevel::default();
        for (value, dt_s) in [(0.1, FRAME_S), (f32::NAN, FRAME_S), (0.3, f32::NAN), (0.1, FRAME_S), (0.2, -1.0)] {
            assert!((1.0..=2.0).contains(&level.step(&[value; COEFFS], dt_s)));
        }
    }
}
