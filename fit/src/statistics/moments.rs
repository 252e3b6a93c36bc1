//! Sums over pairs of estimate and truth, from which the figures of any union of pictures follow.

use std::ops::AddAssign;

/// Variances up to this value count as 0.
const STILL: f64 = 1e-12;

/// Sums over pairs of estimate and truth. Figures that are not defined are not a number.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moments {
    count: f64,
    estimate: f64,
    truth: f64,
    estimate_squared: f64,
    truth_squared: f64,
    product: f64,
}

/// A mean squared error taken apart: the parts add up to it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ErrorParts {
    /// What subtracting the mean error would remove.
    pub bias: f64,
    /// What scaling the estimates by the best factor would remove after that.
    pub gain: f64,
    /// What is left: the variance of the truth that no straight line through the estimates explains.
    pub rest: f64,
}

impl Moments {
    /// Adds a pair.
    pub fn add(&mut self, estimate: f64, truth: f64) {
        *self += Self {
            count: 1.0,
            estimate,
            truth,
            estimate_squared: estimate.powi(2),
            truth_squared: truth.powi(2),
            product: estimate * truth,
        };
    }

    /// Returns the number of pairs.
    pub fn count(&self) -> f64 {
        self.count
    }

    fn variances(&self) -> [f64; 2] {
        let variance = |sum: f64, squares: f64| (squares / self.count - (sum / self.count).powi(2)).max(0.0);
        [variance(self.estimate, self.estimate_squared), variance(self.truth, self.truth_squared)]
    }

    fn covariance(&self) -> f64 {
        self.product / self.count - self.estimate / self.count * self.truth / self.count
    }

    /// Returns the standard deviation (n - 1) of the truth, or 0 if there are fewer than two pairs.
    pub fn truth_deviation(&self) -> f64 {
        if self.count < 2.0 { 0.0 } else { (self.variances()[1] * self.count / (self.count - 1.0)).sqrt() }
    }

    /// Returns Pearson's correlation: 0 if only the estimate is constant, undefined if the truth is.
    pub fn pearson(&self) -> f64 {
        let [estimate, truth] = self.variances();
        match (estimate > STILL, truth > STILL) {
            (true, true) => self.covariance() / (estimate * truth).sqrt(),
            (false, true) => 0.0,
            (_, false) => f64::NAN,
        }
    }

    /// Returns the mean squared error.
    pub fn mse(&self) -> f64 {
        (self.estimate_squared - 2.0 * self.product + self.truth_squared) / self.count
    }

    /// Returns the mean error, estimate minus truth.
    pub fn bias(&self) -> f64 {
        (self.estimate - self.truth) / self.count
    }

    /// Returns the standard deviation of the estimates divided by that of the truth.
    pub fn gain(&self) -> f64 {
        let [estimate, truth] = self.variances();
        if truth > STILL { (estimate / truth).sqrt() } else { f64::NAN }
    }

    /// Returns the slope of the straight line through the estimates over the truth (least squares).
    pub fn slope(&self) -> f64 {
        let truth = self.variances()[1];
        if truth > STILL { self.covariance() / truth } else { f64::NAN }
    }

    /// Takes the mean squared error apart.
    pub fn error_parts(&self) -> ErrorParts {
        let [estimate, truth] = self.variances();
        let explained = if estimate > STILL { self.covariance() / estimate.sqrt() } else { 0.0 };
        ErrorParts {
            bias: self.bias().powi(2),
            gain: (estimate.sqrt() - explained).powi(2),
            rest: (truth - explained.powi(2)).max(0.0),
        }
    }
}

impl AddAssign for Moments {
    fn add_assign(&mut self, other: Self) {
        self.count += other.count;
        self.estimate += other.estimate;
        self.truth += other.truth;
        self.estimate_squared += other.estimate_squared;
        self.truth_squared += other.truth_squared;
        self.product += other.product;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::statistics::{mse, pearson, standard_deviation};

    const TRUTH: [f64; 6] = [0.0, 0.2, 0.9, 0.4, 0.0, 0.6];
    const ESTIMATE: [f64; 6] = [0.1, 0.2, 0.5, 0.4, 0.0, 0.2];

    fn moments(estimate: &[f64], truth: &[f64]) -> Moments {
        let mut moments = Moments::default();
        estimate.iter().zip(truth).for_each(|(estimate, truth)| moments.add(*estimate, *truth));
        moments
    }

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() < 1e-12
    }

    #[test]
    fn sums_of_two_halves_give_the_figures_of_the_whole() {
        let mut sums = moments(&ESTIMATE[..2], &TRUTH[..2]);
        sums += moments(&ESTIMATE[2..], &TRUTH[2..]);
        assert!(close(sums.pearson(), pearson(&ESTIMATE, &TRUTH)));
        assert!(close(sums.mse(), mse(&ESTIMATE, &TRUTH)));
        assert!(close(sums.truth_deviation(), standard_deviation(&TRUTH)));
        let gain = standard_deviation(&ESTIMATE) / standard_deviation(&TRUTH);
        assert!(close(sums.gain(), gain) && close(sums.slope(), gain * sums.pearson()));
    }

    #[test]
    fn an_offset_is_bias_a_factor_is_gain_and_the_parts_add_up() {
        let offset = TRUTH.map(|truth| truth + 0.1);
        let ErrorParts { bias, gain, rest } = moments(&offset, &TRUTH).error_parts();
        assert!(close(bias, 0.01) && close(gain, 0.0) && close(rest, 0.0));
        let half = TRUTH.map(|truth| 0.5 * truth);
        let halved = moments(&half, &TRUTH);
        let ErrorParts { bias, gain, rest } = halved.error_parts();
        assert!(close(halved.gain(), 0.5) && close(halved.slope(), 0.5));
        assert!(gain > 0.01 && close(rest, 0.0) && close(bias + gain, halved.mse()));
        let both = moments(&ESTIMATE, &TRUTH);
        let ErrorParts { bias, gain, rest } = both.error_parts();
        assert!(rest > 0.001 && close(bias + gain + rest, both.mse()));
    }

    #[test]
    fn figures_that_need_a_moving_truth_are_undefined_without_one() {
        let still = moments(&ESTIMATE, &[0.5; 6]);
        assert!(still.pearson().is_nan() && still.gain().is_nan() && still.slope().is_nan());
        assert!(close(moments(&[0.5; 6], &TRUTH).pearson(), 0.0));
    }
}
