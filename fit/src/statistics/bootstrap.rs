//! Confidence intervals by the bootstrap over people (Efron, 1979; percentile method).
//!
//! Pictures of one person resemble each other, so that whole people are drawn, with replacement, and never single
//! pictures. Two models that are judged on the same draws can be compared in pairs: what is hard about a person then
//! cancels out. Percentile intervals of few people are too narrow, by about a tenth for ten people.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

/// The seed of the draws, so that the same data give the same intervals.
const SEED: u64 = 1;
/// The share of the draws that lies below an interval, and above it.
const TAIL: f64 = 0.025;

/// A 95 % confidence interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    /// The lower end.
    pub low: f64,
    /// The upper end.
    pub high: f64,
}

impl Interval {
    /// Returns the interval between the percentiles of the values. Values that are not a number are left out; without
    /// any other values, the ends are not a number.
    pub fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        Self { low: quantile(&values, TAIL), high: quantile(&values, 1.0 - TAIL) }
    }

    /// Returns whether the interval excludes 0, so that a difference is certain.
    pub fn excludes_zero(&self) -> bool {
        self.low > 0.0 || self.high < 0.0
    }

    /// Returns half of the width.
    pub fn half_width(&self) -> f64 {
        (self.high - self.low) / 2.0
    }
}

/// Interpolates between the two sorted values that are nearest.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let place = share * last as f64;
    #[expect(clippy::cast_sign_loss, reason = "the share is not negative")]
    let below = (place.floor() as usize).min(last);
    let above = (below + 1).min(last);
    sorted[below] + (sorted[above] - sorted[below]) * (place - below as f64)
}

/// Draws as many people as there are, with replacement. Returns their indices. The draw depends on its number only.
pub fn draw(number: u64, people: usize) -> Vec<usize> {
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    rng.set_stream(number);
    (0..people).map(|_| rng.random_range(0..people)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::mean;

    #[test]
    fn the_interval_of_a_mean_has_the_width_that_theory_gives() {
        let people: Vec<f64> = (0..200).map(|person| f64::from(person % 20) / 19.0).collect();
        let means = (0..2000).map(|number| mean(draw(number, 200).into_iter().map(|person| people[person])));
        let interval = Interval::of(means);
        // A uniform distribution of 20 values from 0 to 1 has the deviation 0.3035.
        let wanted = 1.96 * 0.3035 / 200.0_f64.sqrt();
        assert!((interval.half_width() / wanted - 1.0).abs() < 0.06, "{} {wanted}", interval.half_width());
        assert!(interval.low < 0.5 && interval.high > 0.5);
    }

    #[test]
    fn draws_are_the_same_in_every_run_and_differ_from_each_other() {
        assert_eq!(draw(3, 50), draw(3, 50));
        assert_ne!(draw(3, 50), draw(4, 50));
        assert!(draw(0, 50).iter().all(|person| *person < 50));
    }

    #[test]
    fn an_interval_ends_at_the_percentiles_and_ignores_undefined_values() {
        let interval = Interval::of((0..=1000).rev().map(|value| f64::from(value) / 1000.0).chain([f64::NAN]));
        assert!((interval.low - 0.025).abs() < 1e-12 && (interval.high - 0.975).abs() < 1e-12);
        assert!(interval.excludes_zero() && !Interval { low: -0.1, high: 0.1 }.excludes_zero());
        assert!(Interval::of([].into_iter()).low.is_nan());
    }
}
