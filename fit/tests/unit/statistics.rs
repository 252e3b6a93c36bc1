pub mod events;
mod regression;

use facewire_fit::paper::{AGAINST_ARKIT, AgainstArkit};
use facewire_fit::statistics::*;
use nalgebra::DMatrix;
use nalgebra::vector;
use serde_json::Value;

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
    let mut all: Value = serde_json::from_str(include_str!("../reference.json")).unwrap();
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
