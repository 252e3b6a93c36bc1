//! Statistics of curves and of regressions, by which estimates are judged.
//!
//! The functions take slices, with the estimate before the truth. Tests compare each of them with `SciPy`, statsmodels
//! or scikit-learn (`fit/tests/reference.py` makes the values).

pub mod events;
pub mod regression;

use std::ops::AddAssign;

use nalgebra::{Vector3, vector};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use statrs::statistics::{Data, OrderStatistics, RankTieBreaker};

pub use events::{Event, EventCounts, EventLimits, count_events, events_of};
pub use regression::{
    ColumnSpace, Regressors, SHAPIRO_WILK_MAX, TestResult, autocorrelation, breusch_pagan, durbin_watson, f_regression,
    f_statistic, shapiro_wilk,
};

/// Variances and products of standard deviations up to this value count as 0.
const STILL: f64 = 1e-12;

pub fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (count, sum) = values.fold((0.0, 0.0), |(count, sum), value| (count + 1.0, sum + value));
    if count > 0.0 { sum / count } else { 0.0 }
}

pub fn column_means<const N: usize>(rows: &[[Option<f64>; N]]) -> [Option<f64>; N] {
    core::array::from_fn(|column| {
        let values = || rows.iter().filter_map(|row| row[column]);
        values().next().map(|_| mean(values()))
    })
}

fn differences<'a>(estimate: &'a [f64], truth: &'a [f64]) -> impl Iterator<Item = f64> + Clone + 'a {
    estimate.iter().zip(truth).map(|(a, b)| a - b)
}

pub fn pearson(estimate: &[f64], truth: &[f64]) -> f64 {
    let pairs = || estimate.iter().zip(truth);
    let (a, b) = (mean(pairs().map(|p| *p.0)), mean(pairs().map(|p| *p.1)));
    let covariance = mean(pairs().map(|p| (p.0 - a) * (p.1 - b)));
    let variances = [mean(pairs().map(|p| (p.0 - a).powi(2))), mean(pairs().map(|p| (p.1 - b).powi(2)))];
    let deviations = (variances[0] * variances[1]).sqrt();
    if deviations > STILL { covariance / deviations } else { 0.0 }
}

/// Returns the mean squared error. Between two trackers it is called mean squared deviation.
pub fn mse(estimate: &[f64], truth: &[f64]) -> f64 {
    mean(differences(estimate, truth).map(|difference| difference.powi(2)))
}

/// Returns the standard deviation (n - 1) of the differences: the error without its mean. The paper does not define its
/// "Deviation", which in some rows exceeds the root of the MSD, as this one can only by `sqrt(n / (n - 1))`.
pub fn deviation_of_differences(estimate: &[f64], truth: &[f64]) -> f64 {
    standard_deviation(&differences(estimate, truth).collect::<Vec<_>>())
}

pub fn standard_deviation(values: &[f64]) -> f64 {
    let centre = mean(values.iter().copied());
    let squares: f64 = values.iter().map(|value| (value - centre).powi(2)).sum();
    (squares / values.len().saturating_sub(1).max(1) as f64).sqrt()
}

/// Returns `1 - sqrt(MSD)`. The paper does not define the accuracy that it reports, but all fifteen rows of its table
/// agree with this definition if its MSD is truncated to three decimals.
pub fn accuracy(estimate: &[f64], truth: &[f64]) -> f64 {
    1.0 - mse(estimate, truth).sqrt()
}

/// Returns the share of the truth's variance that the estimate explains: below 0 if its mean is better, 0 at rest.
pub fn r_squared(estimate: &[f64], truth: &[f64]) -> f64 {
    let centre = mean(truth.iter().copied());
    let variance = mean(truth.iter().map(|value| (value - centre).powi(2)));
    if variance > STILL { 1.0 - mse(estimate, truth) / variance } else { 0.0 }
}

const SEED: u64 = 1;

/// Returns Spearman's correlation, with the mean rank for equal values, or 0 if one side is constant.
pub fn spearman(estimate: &[f64], truth: &[f64]) -> f64 {
    let ranks = |values: &[f64]| Data::new(values.to_vec()).ranks(RankTieBreaker::Average);
    pearson(&ranks(estimate), &ranks(truth))
}

/// Returns Chatterjee's correlation (2021, eq. 1.2): 1 if the truth is a function of the estimate, about 0 if they are
/// independent, and 0 if the truth is constant. Equal estimates are put in a random order, the same in every run: in
/// order of time, a curve that rests at 0 would seem to follow any truth that changes slowly.
pub fn xi(estimate: &[f64], truth: &[f64]) -> f64 {
    let count = estimate.len().min(truth.len());
    let mut order: Vec<usize> = (0..count).collect();
    fastrand::Rng::with_seed(SEED).shuffle(&mut order);
    order.sort_by(|a, b| estimate[*a].total_cmp(&estimate[*b]));
    let mut sorted = truth[..count].to_vec();
    sorted.sort_by(f64::total_cmp);
    let at_most: Vec<f64> = truth[..count].iter().map(|y| sorted.partition_point(|other| other <= y) as f64).collect();
    let at_least = truth[..count].iter().map(|y| (count - sorted.partition_point(|other| other < y)) as f64);
    let steps: f64 = order.windows(2).map(|pair| (at_most[pair[1]] - at_most[pair[0]]).abs()).sum();
    let n = count as f64;
    let scale: f64 = at_least.map(|least| least * (n - least)).sum::<f64>() * 2.0;
    if scale > 0.0 { 1.0 - n * steps / scale } else { 0.0 }
}

/// Upper ends of the levels of the truth. The first one is that of a blendshape at rest.
pub const LEVELS: [f64; 6] = [0.02, 0.2, 0.4, 0.6, 0.8, 1.0];

pub fn level_of(truth: f64) -> usize {
    LEVELS.iter().position(|end| truth <= *end).unwrap_or(LEVELS.len() - 1)
}

/// Sums over pairs of estimate and truth. Figures that are not defined are not a number.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Moments {
    pub count: f64,
    estimate: f64,
    truth: f64,
    estimate_squared: f64,
    truth_squared: f64,
    product: f64,
}

impl Moments {
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

    pub fn mse(&self) -> f64 {
        (self.estimate_squared - 2.0 * self.product + self.truth_squared) / self.count
    }

    pub fn bias(&self) -> f64 {
        (self.estimate - self.truth) / self.count
    }

    pub fn gain(&self) -> f64 {
        let [estimate, truth] = self.variances();
        if truth > STILL { (estimate / truth).sqrt() } else { f64::NAN }
    }

    /// Returns the slope of the straight line through the estimates over the truth (least squares).
    pub fn slope(&self) -> f64 {
        let truth = self.variances()[1];
        if truth > STILL { self.covariance() / truth } else { f64::NAN }
    }

    /// Takes the mean squared error apart: the bias, what scaling the estimates by the best factor would remove after that,
    /// and the variance of the truth that no straight line through the estimates explains.
    pub fn error_parts(&self) -> Vector3<f64> {
        let [estimate, truth] = self.variances();
        let explained = if estimate > STILL { self.covariance() / estimate.sqrt() } else { 0.0 };
        let gain = (estimate.sqrt() - explained).powi(2);
        vector![self.bias().powi(2), gain, (truth - explained.powi(2)).max(0.0)]
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

/// Number of frames for which the truth has to rest before a frame counts, so that a smoothed curve has settled.
const REST_FRAMES: usize = 6;
/// Largest range of a truth at rest: too little to be visible on a face, and more than the noise of a sensor.
const REST_RANGE: f64 = 0.01;
const LEAST_FRAMES: usize = 10;

/// Returns the root mean square of the steps from frame to frame, over the frames at which the truth has stayed within
/// [`REST_RANGE`] for [`REST_FRAMES`], or `None` if there are fewer than [`LEAST_FRAMES`] of them.
pub fn jitter_at_rest(estimate: &[f64], truth: &[f64]) -> Option<f64> {
    let windows = truth.windows(REST_FRAMES).zip(estimate.windows(REST_FRAMES));
    let range = |values: &[f64]| {
        let ends = values.iter().fold((f64::MAX, f64::MIN), |(a, b), value| (a.min(*value), b.max(*value)));
        ends.1 - ends.0
    };
    let at_rest = windows.filter(|(truth, _)| range(truth) <= REST_RANGE);
    let steps: Vec<f64> = at_rest.map(|(_, estimate)| estimate[REST_FRAMES - 1] - estimate[REST_FRAMES - 2]).collect();
    let squares: f64 = steps.iter().map(|step| step.powi(2)).sum();
    (steps.len() >= LEAST_FRAMES).then(|| (squares / steps.len() as f64).sqrt())
}

// Confidence intervals by the bootstrap over people (Efron, 1979; percentile method).
//
// Pictures of one person resemble each other, so that whole people are drawn, with replacement, and never single
// pictures. Two models that are judged on the same draws can be compared in pairs: what is hard about a person then
// cancels out. Percentile intervals of few people are too narrow, by about a tenth for ten people.

const TAIL: f64 = 0.025;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Interval {
    pub low: f64,
    pub high: f64,
}

impl Interval {
    /// Returns the interval between the percentiles of the finite values. It is not a number without any.
    pub fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        Self { low: quantile(&values, TAIL), high: quantile(&values, 1.0 - TAIL) }
    }

    pub fn excludes_zero(&self) -> bool {
        self.low > 0.0 || self.high < 0.0
    }

    pub fn half_width(&self) -> f64 {
        (self.high - self.low) / 2.0
    }
}

fn quantile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let place = share * last as f64;
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

pub fn subsample<T: Copy>(values: &[T], most: usize) -> Vec<T> {
    values.iter().step_by(values.len().div_ceil(most).max(1)).copied().collect()
}
