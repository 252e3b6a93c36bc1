//! Compares the statistics with `SciPy` 1.17.1, statsmodels 0.15.0 and scikit-learn 1.9.1 (`fit/tests/reference.py`).
//!
//! The tolerance is 1e-9 relative, for another order of additions. It is 1e-6 for the Shapiro-Wilk W and 1e-4 relative
//! for its p value, because `SciPy` rounds coefficients and quantiles in another way.

use nalgebra::DMatrix;
use serde::Deserialize;

use super::*;

#[derive(Deserialize)]
struct Reference {
    pairs: Vec<Pair>,
    regressions: Vec<Regression>,
    normalities: Vec<Normality>,
    long_normalities: Vec<LongNormality>,
    features: Features,
}

#[derive(Deserialize)]
struct Pair {
    estimate: Vec<f64>,
    truth: Vec<f64>,
    pearson: f64,
    spearman: f64,
    xi: f64,
    mse: f64,
    deviation: f64,
    r_squared: f64,
}

#[derive(Deserialize)]
struct Regression {
    columns: Vec<Vec<f64>>,
    residuals: Vec<f64>,
    r_squared: f64,
    f: [f64; 2],
    durbin_watson: f64,
    breusch_pagan: [f64; 2],
    breusch_pagan_f: [f64; 2],
    autocorrelation: Vec<f64>,
}

#[derive(Deserialize)]
struct Normality {
    values: Vec<f64>,
    w: f64,
    p: f64,
}

#[derive(Deserialize)]
struct LongNormality {
    count: u32,
    w: f64,
    p: f64,
}

#[derive(Deserialize)]
struct Features {
    columns: Vec<Vec<f64>>,
    groups: Vec<usize>,
    truth: Vec<f64>,
    f_alone: Vec<f64>,
    partial_f: Vec<f64>,
}

fn reference() -> Reference {
    serde_json::from_str(include_str!("../../tests/reference.json")).unwrap()
}

#[track_caller]
fn agree(ours: f64, theirs: f64, relative: f64) {
    let allowed = relative * theirs.abs().max(1e-3);
    assert!((ours - theirs).abs() <= allowed, "{ours} is not {theirs} within {allowed}");
}

#[track_caller]
fn tests_agree(ours: TestResult, theirs: [f64; 2]) {
    agree(ours.statistic, theirs[0], 1e-9);
    agree(ours.p, theirs[1], 1e-9);
}

#[test]
fn correlations_and_deviations_agree_with_scipy() {
    for pair in reference().pairs {
        let (estimate, truth) = (&pair.estimate, &pair.truth);
        agree(pearson(estimate, truth), pair.pearson, 1e-9);
        agree(spearman(estimate, truth), pair.spearman, 1e-9);
        agree(xi(estimate, truth), pair.xi, 1e-9);
        agree(mse(estimate, truth), pair.mse, 1e-9);
        agree(deviation_of_differences(estimate, truth), pair.deviation, 1e-9);
        agree(r_squared(estimate, truth), pair.r_squared, 1e-9);
    }
}

#[test]
fn diagnostics_of_regressions_agree_with_statsmodels() {
    for regression in reference().regressions {
        let (rows, parameters) = (regression.residuals.len(), regression.columns.len());
        let columns = DMatrix::from_fn(rows, parameters, |row, column| regression.columns[column][row]);
        let spread = breusch_pagan(&regression.residuals, &columns).unwrap();
        tests_agree(spread.lagrange, regression.breusch_pagan);
        tests_agree(spread.f, regression.breusch_pagan_f);
        tests_agree(f_statistic(regression.r_squared, rows, parameters).unwrap(), regression.f);
        agree(durbin_watson(&regression.residuals), regression.durbin_watson, 1e-9);
        let lags = autocorrelation(&regression.residuals, 6);
        lags.iter().zip(&regression.autocorrelation).for_each(|(ours, theirs)| agree(*ours, *theirs, 1e-9));
    }
}

#[test]
fn shapiro_wilk_agrees_with_scipy_from_3_to_5000_values() {
    for sample in reference().normalities {
        let tested = shapiro_wilk(&sample.values).unwrap();
        agree(tested.statistic, sample.w, 1e-6);
        agree(tested.p, sample.p, 1e-4);
    }
    for sample in reference().long_normalities {
        let value = |index: u32| (f64::from(index) * 0.618_033_988_749_895 % 1.0).powi(2);
        let tested = shapiro_wilk(&(1..=sample.count).map(value).collect::<Vec<_>>()).unwrap();
        agree(tested.statistic, sample.w, 1e-6);
        agree(tested.p, sample.p, 1e-4);
    }
}

#[test]
fn f_of_single_features_agrees_with_scikit_learn() {
    let Features { columns, truth, f_alone, .. } = reference().features;
    let ours = columns.iter().map(|column| f_regression(pearson(column, &truth), truth.len()));
    ours.zip(&f_alone).for_each(|(ours, theirs)| agree(ours, *theirs, 1e-9));
}

/// The tolerance is 1e-8 because of the ridge that allows constant regressors.
#[test]
fn partial_f_within_groups_agrees_with_statsmodels() {
    let Features { columns, groups, truth, partial_f, .. } = reference().features;
    let regressors = DMatrix::from_fn(truth.len(), columns.len(), |row, column| columns[column][row]);
    let ours = Regressors::new(regressors, &groups).unwrap().partial_f(&truth);
    ours.iter().zip(&partial_f).for_each(|(ours, theirs)| agree(*ours, *theirs, 1e-8));
}
