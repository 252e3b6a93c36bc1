//! Statistics of curves and of regressions, by which estimates are judged.
//!
//! The functions take slices, with the estimate before the truth. Tests compare each of them with `SciPy`, statsmodels
//! or scikit-learn (`fit/tests/reference.py` makes the values).

mod events;
mod regression;

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

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;
    use serde_json::Value;

    use super::*;
    use crate::paper::{AGAINST_ARKIT, AgainstArkit};

    #[test]
    fn accuracy_is_defined_as_the_papers_table_implies() {
        for AgainstArkit { blendshape, agreement, .. } in &AGAINST_ARKIT {
            let [_, _, _, accuracy, msd, _] = agreement;
            // Half a unit of the last digit that the paper prints.
            let implied = 1.0 - (msd + 0.001).sqrt() - 0.0005..=1.0 - msd.sqrt() + 0.0005;
            assert!(implied.contains(accuracy), "{blendshape}: {accuracy} in {implied:?}");
        }
    }

    #[test]
    fn an_estimate_at_rest_has_no_xi_with_a_truth_that_moves_slowly() {
        let truth: Vec<f64> = (0..1000).map(|i| (f64::from(i) / 100.0).sin()).collect();
        assert!(xi(&[0.0; 1000], &truth).abs() < 0.1);
    }

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
        let still = moments(&ESTIMATE, &[0.5; 6]);
        assert!([still.pearson(), still.gain(), still.slope()].iter().all(|figure| figure.is_nan()));
        let gain = standard_deviation(&ESTIMATE) / standard_deviation(&TRUTH);
        assert!(close(sums.gain(), gain) && close(sums.slope(), gain * sums.pearson()));
    }

    #[test]
    fn an_offset_is_bias_a_factor_is_gain_and_the_parts_add_up() {
        let offset = TRUTH.map(|truth| truth + 0.1);
        let parts = moments(&offset, &TRUTH).error_parts();
        assert!((parts - vector![0.01, 0.0, 0.0]).amax() < 1e-12, "{parts}");
        let halved = moments(&TRUTH.map(|truth| 0.5 * truth), &TRUTH);
        let parts = halved.error_parts();
        assert!(close(halved.gain(), 0.5) && close(halved.slope(), 0.5));
        assert!(parts[1] > 0.01 && close(parts[2], 0.0) && close(parts.sum(), halved.mse()));
        let both = moments(&ESTIMATE, &TRUTH);
        assert!(both.error_parts()[2] > 0.001 && close(both.error_parts().sum(), both.mse()));
    }

    #[test]
    fn only_frames_at_rest_count() {
        let truth: Vec<f64> = (0..60).map(|i| if i < 30 { 0.0 } else { f64::from(i - 30) / 30.0 }).collect();
        let shaken: Vec<f64> = (0..60).map(|i| truth[i] + if i % 2 == 0 { 0.01 } else { -0.01 }).collect();
        let jitter = jitter_at_rest(&shaken, &truth).unwrap();
        assert!((jitter - 0.02).abs() < 1e-12, "{jitter}");
        let slow: Vec<f64> = (0..60).map(|i| f64::from(i) / 60.0).collect();
        assert_eq!(jitter_at_rest(&slow, &slow), None, "a truth that never rests");
    }

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
    fn an_interval_ends_at_the_percentiles_and_ignores_undefined_values() {
        let interval = Interval::of((0..=1000).rev().map(|value| f64::from(value) / 1000.0).chain([f64::NAN]));
        assert!((interval.low - 0.025).abs() < 1e-12 && (interval.high - 0.975).abs() < 1e-12);
        assert!(interval.excludes_zero() && !Interval { low: -0.1, high: 0.1 }.excludes_zero());
        assert!(Interval::of([].into_iter()).low.is_nan());
    }
    /// Returns a part of the values according to `SciPy` 1.17.1, statsmodels 0.15.0 and scikit-learn 1.9.1.
    fn reference(part: &str) -> Value {
        let mut all: Value = serde_json::from_str(include_str!("../tests/reference.json")).unwrap();
        all[part].take()
    }

    fn samples(part: &str) -> Vec<Value> {
        serde_json::from_value(reference(part)).unwrap()
    }

    fn numbers(value: &Value) -> Vec<f64> {
        serde_json::from_value(value.clone()).unwrap()
    }

    fn matrix(columns: &Value) -> DMatrix<f64> {
        let columns: Vec<Vec<f64>> = serde_json::from_value(columns.clone()).unwrap();
        DMatrix::from_fn(columns[0].len(), columns.len(), |row, column| columns[column][row])
    }

    #[track_caller]
    fn agree(ours: f64, theirs: &Value, relative: f64) {
        let theirs = theirs.as_f64().unwrap();
        let allowed = relative * theirs.abs().max(1e-3);
        assert!((ours - theirs).abs() <= allowed, "{ours} is not {theirs} within {allowed}");
    }

    /// The tolerance of 1e-9 is for another order of additions.
    #[track_caller]
    fn tests_agree(ours: TestResult, theirs: &Value) {
        agree(ours.statistic, &theirs[0], 1e-9);
        agree(ours.p, &theirs[1], 1e-9);
    }

    #[test]
    fn correlations_and_deviations_agree_with_scipy() {
        let figures: [(&str, fn(&[f64], &[f64]) -> f64); 6] = [
            ("pearson", pearson),
            ("spearman", spearman),
            ("xi", xi),
            ("mse", mse),
            ("deviation", deviation_of_differences),
            ("r_squared", r_squared),
        ];
        for pair in samples("pairs") {
            for (name, figure) in figures {
                agree(figure(&numbers(&pair["estimate"]), &numbers(&pair["truth"])), &pair[name], 1e-9);
            }
        }
    }

    #[test]
    fn diagnostics_of_regressions_agree_with_statsmodels() {
        for known in samples("regressions") {
            let (columns, residuals) = (matrix(&known["columns"]), numbers(&known["residuals"]));
            tests_agree(breusch_pagan(&residuals, &columns).unwrap(), &known["breusch_pagan"]);
            let r_squared = known["r_squared"].as_f64().unwrap();
            tests_agree(f_statistic(r_squared, columns.nrows(), columns.ncols()).unwrap(), &known["f"]);
            agree(durbin_watson(&residuals), &known["durbin_watson"], 1e-9);
            for (lag, value) in autocorrelation(&residuals, 6).into_iter().enumerate() {
                agree(value, &known["autocorrelation"][lag], 1e-9);
            }
        }
    }

    /// W agrees within 1e-6 and its p value within 1e-4, because `SciPy` rounds coefficients and quantiles in another way.
    #[test]
    fn shapiro_wilk_agrees_with_scipy_from_3_to_5000_values() {
        for sample in samples("normalities").into_iter().chain(samples("long_normalities")) {
            let value = |index: u64| (index as f64 * 0.618_033_988_749_895 % 1.0).powi(2);
            let long = || (1..=sample["count"].as_u64().unwrap()).map(value).collect();
            let values = sample.get("values").map_or_else(long, numbers);
            let tested = shapiro_wilk(&values).unwrap();
            agree(tested.statistic, &sample["w"], 1e-6);
            agree(tested.p, &sample["p"], 1e-4);
        }
    }

    /// The tolerance of partial F is 1e-8 because of the ridge that allows constant regressors.
    #[test]
    fn f_of_features_agrees_with_scikit_learn_and_partial_f_within_groups_with_statsmodels() {
        let known = reference("features");
        let (columns, truth) = (matrix(&known["columns"]), numbers(&known["truth"]));
        let groups: Vec<usize> = serde_json::from_value(known["groups"].clone()).unwrap();
        let partial_f = Regressors::new(columns.clone(), &groups).unwrap().partial_f(&truth);
        for (index, (column, partial_f)) in columns.column_iter().zip(partial_f).enumerate() {
            let f_alone = f_regression(pearson(column.as_slice(), &truth), truth.len());
            agree(f_alone, &known["f_alone"][index], 1e-9);
            agree(partial_f, &known["partial_f"][index], 1e-8);
        }
    }
}
