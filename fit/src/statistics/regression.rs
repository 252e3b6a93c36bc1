//! Significance and explanatory power of a regression.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor, Normal};

use super::mean;

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TestResult {
    pub statistic: f64,
    /// The probability of a statistic at least as large under the null hypothesis.
    pub p: f64,
}

/// Singular values below this share of the largest one belong to columns that repeat others.
const SAME: f64 = 1e-10;

/// Returns the overall F of a regression with `parameters` weights and a constant, or `None` if no freedom remains.
/// The p value holds for rows that the weights were fitted to. For others, F only measures the size of the effect.
pub fn f_statistic(r_squared: f64, rows: usize, parameters: usize) -> Option<TestResult> {
    let rest = rows.checked_sub(parameters + 1).filter(|rest| *rest > 0 && parameters > 0)? as f64;
    let statistic = (r_squared / parameters as f64) / ((1.0 - r_squared) / rest);
    let p = FisherSnedecor::new(parameters as f64, rest).ok()?.sf(statistic.max(0.0));
    Some(TestResult { statistic, p })
}

/// Returns the F of a single regressor: infinite for a perfect correlation, 0 if no degree of freedom remains.
pub fn f_regression(pearson: f64, rows: usize) -> f64 {
    f_statistic(pearson.powi(2), rows, 1).map_or(0.0, |tested| tested.statistic)
}

pub struct ColumnSpace(DMatrix<f64>);

impl ColumnSpace {
    pub fn of(columns: &DMatrix<f64>) -> Option<Self> {
        let mut centred = columns.clone();
        centred.column_iter_mut().for_each(|mut column| column.add_scalar_mut(-column.mean()));
        let decomposed = centred.svd(true, false);
        let values = &decomposed.singular_values;
        let least = values.max() * SAME;
        let kept: Vec<usize> = (0..values.len()).filter(|index| values[*index] > least).collect();
        Some(Self(decomposed.u?.select_columns(&kept)))
    }

    /// Returns R2 of the regression of `values` on the columns, or `None` if either is constant.
    pub fn explain(&self, values: &[f64]) -> Option<f64> {
        let mut target = DVector::from_column_slice(values);
        target.add_scalar_mut(-target.mean());
        let total = target.norm_squared();
        let scale = values.iter().map(|value| value.powi(2)).sum::<f64>();
        let varies = total > scale * f64::EPSILON && self.0.ncols() > 0;
        varies.then(|| self.0.tr_mul(&target).norm_squared() / total)
    }
}

/// Returns the Durbin-Watson statistic: 2 if neighbours are uncorrelated, near 0 if alike, near 4 if they alternate.
pub fn durbin_watson(residuals: &[f64]) -> f64 {
    let steps: f64 = residuals.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
    let squares: f64 = residuals.iter().map(|residual| residual.powi(2)).sum();
    if squares > 0.0 { steps / squares } else { 2.0 }
}

/// Tests by Breusch and Pagan whether the spread of the residuals changes with `regressors` (rows x columns, without a
/// constant). Koenker's form does not assume normal residuals: `n R2` of the squared residuals is chi-squared with one
/// degree of freedom per regressor. Returns `None` if there are too few rows or all values are constant.
pub fn breusch_pagan(residuals: &[f64], regressors: &DMatrix<f64>) -> Option<TestResult> {
    let squares: Vec<f64> = residuals.iter().map(|residual| residual.powi(2)).collect();
    let space = ColumnSpace::of(regressors)?;
    let statistic = squares.len() as f64 * space.explain(&squares)?;
    squares.len().checked_sub(space.0.ncols() + 1).filter(|rest| *rest > 0)?;
    Some(TestResult { statistic, p: ChiSquared::new(space.0.ncols() as f64).ok()?.sf(statistic) })
}

pub fn autocorrelation(values: &[f64], lags: usize) -> Vec<f64> {
    let centre = mean(values.iter().copied());
    let centred: Vec<f64> = values.iter().map(|value| value - centre).collect();
    let product = |lag: usize| -> f64 { centred.iter().skip(lag).zip(&centred).map(|(a, b)| a * b).sum() };
    let variance = product(0);
    (0..=lags).map(|lag| if variance > 0.0 { product(lag) / variance } else { 0.0 }).collect()
}

/// Added to the moments of standardised regressors, so that constant regressors do not make them singular.
const RIDGE: f64 = 1e-12;
/// Variance inflation factor above which a regressor counts as a linear combination of the others.
const MAX_INFLATION: f64 = 1e8;
/// Share of the variance below which a remainder is rounding error.
const ROUNDING: f64 = 1e-12;

/// Regressors with rows in groups that each have a mean of their own (fixed effects), prepared for any number of tests.
pub struct Regressors {
    /// The regressors without the group means, scaled to length 1.
    columns: DMatrix<f64>,
    inverse: DMatrix<f64>,
    groups: Groups,
    degrees_of_freedom: f64,
}

impl Regressors {
    /// Prepares regressors (rows x columns) with the group of each row. Returns `None` if no degree of freedom remains.
    pub fn new(mut regressors: DMatrix<f64>, groups: &[usize]) -> Option<Self> {
        let groups = Groups::new(groups);
        for mut column in regressors.column_iter_mut() {
            let whole = column.norm();
            groups.centre(column.as_mut_slice());
            let length = column.norm();
            let scale = if length > whole * ROUNDING { length.recip() } else { 0.0 };
            column *= scale;
        }
        let moments = regressors.tr_mul(&regressors);
        let rank = moments.symmetric_eigenvalues().iter().filter(|value| **value > MAX_INFLATION.recip()).count();
        let used = groups.sizes.len() + rank;
        let degrees_of_freedom = regressors.nrows().checked_sub(used).filter(|rest| *rest > 0)? as f64;
        let ridge = DMatrix::identity(moments.nrows(), moments.ncols()) * RIDGE;
        let inverse = (moments + ridge).cholesky()?.inverse();
        Some(Self { columns: regressors, inverse, groups, degrees_of_freedom })
    }

    /// Returns the partial F of `values` with every regressor, controlling for all others and the groups. It is
    /// symmetric, and 0 for a regressor that is constant or a combination of the others.
    pub fn partial_f(&self, values: &[f64]) -> Vec<f64> {
        let mut values = DVector::from_column_slice(values);
        self.groups.centre(values.as_mut_slice());
        let along = self.columns.tr_mul(&values);
        let weights = &self.inverse * &along;
        let total = values.norm_squared();
        let unexplained = (total - along.dot(&weights)).max(total * ROUNDING);
        let f = |(weight, inflation): (&f64, f64)| {
            let tested = inflation < MAX_INFLATION && total > 0.0;
            if tested { weight.powi(2) / inflation / (unexplained / self.degrees_of_freedom) } else { 0.0 }
        };
        weights.iter().zip(self.inverse.diagonal().iter().copied()).map(f).collect()
    }
}

struct Groups {
    of_row: Vec<usize>,
    sizes: Vec<f64>,
}

impl Groups {
    fn new(groups: &[usize]) -> Self {
        let mut sizes: BTreeMap<usize, f64> = BTreeMap::new();
        for group in groups {
            *sizes.entry(*group).or_default() += 1.0;
        }
        let ranks: BTreeMap<usize, usize> = sizes.keys().enumerate().map(|(rank, group)| (*group, rank)).collect();
        Self { of_row: groups.iter().map(|group| ranks[group]).collect(), sizes: sizes.into_values().collect() }
    }

    fn centre(&self, values: &mut [f64]) {
        let mut sums = vec![0.0; self.sizes.len()];
        self.of_row.iter().zip(values.iter()).for_each(|(group, value)| sums[*group] += value);
        let means: Vec<f64> = sums.iter().zip(&self.sizes).map(|(sum, size)| sum / size).collect();
        self.of_row.iter().zip(values).for_each(|(group, value)| *value -= means[*group]);
    }
}

// The Shapiro-Wilk test for normal residuals, by Royston's approximation.
//
// Coefficients: P. Royston, "Approximating the Shapiro-Wilk W-test for non-normality" (1992) and algorithm AS R94
// (1995).

/// Largest sample for which Royston's approximation holds.
pub const SHAPIRO_WILK_MAX: usize = 5000;
const FEWEST: usize = 3;
/// Up to this sample size, only the last weight is corrected, and above it the last two.
const FEW: usize = 5;
/// Up to this sample size, `ln(1 - W)` is transformed in another way.
const SMALL: usize = 11;

/// Corrections of the last weight and of the weight before it: polynomials in `1 / sqrt(n)`.
const LAST: [f64; 6] = [0.0, 0.221_157, -0.147_981, -2.071_19, 4.434_685, -2.706_056];
const BEFORE_LAST: [f64; 6] = [0.0, 0.042_981, -0.293_762, -1.752_461, 5.682_633, -3.582_633];
/// For samples up to [`SMALL`], polynomials in n: a bound, the mean, and the logarithm of the standard deviation.
const SMALL_BOUND: [f64; 2] = [-2.273, 0.459];
const SMALL_MEAN: [f64; 4] = [0.544, -0.399_78, 0.025_054, -6.714e-4];
const SMALL_DEVIATION: [f64; 4] = [1.3822, -0.778_57, 0.062_767, -0.002_032_2];
/// For larger samples, the same mean and logarithm of the standard deviation as polynomials in ln n.
const LARGE_MEAN: [f64; 4] = [-1.5861, -0.310_82, -0.083_751, 0.003_891_5];
const LARGE_DEVIATION: [f64; 3] = [-0.4803, -0.082_676, 0.003_030_2];

/// Returns W, which is 1 for a normal sample, and its p. `None` for constant values, and for too few or too many.
pub fn shapiro_wilk(values: &[f64]) -> Option<TestResult> {
    if !(FEWEST..=SHAPIRO_WILK_MAX).contains(&values.len()) {
        return None;
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let centre = mean(sorted.iter().copied());
    let squares: f64 = sorted.iter().map(|value| (value - centre).powi(2)).sum();
    let span: f64 = weights(sorted.len())?.iter().zip(&sorted).map(|(weight, value)| weight * (value - centre)).sum();
    if !(squares > 0.0) {
        return None;
    }
    let statistic = (span.powi(2) / squares).min(1.0);
    Some(TestResult { statistic, p: p_of(statistic, sorted.len())? })
}

fn weights(count: usize) -> Option<Vec<f64>> {
    let normal = Normal::standard();
    let n = count as f64;
    let score = |rank: usize| normal.inverse_cdf((rank as f64 - 0.375) / (n + 0.25));
    let mut weights: Vec<f64> = (1..=count).map(score).collect();
    let squares: f64 = weights.iter().map(|score| score.powi(2)).sum();
    let corrected: &[&[f64]] = match count {
        FEWEST => return Some(vec![-0.5_f64.sqrt(), 0.0, 0.5_f64.sqrt()]),
        ..=FEW => &[&LAST],
        _ => &[&LAST, &BEFORE_LAST],
    };
    let end = |(terms, score): (&&[f64], &f64)| (*score, score / squares.sqrt() + polynomial(terms, n.sqrt().recip()));
    let ends: Vec<(f64, f64)> = corrected.iter().zip(weights.iter().rev()).map(end).collect();
    let rest_of_scores = squares - 2.0 * ends.iter().map(|(score, _)| score.powi(2)).sum::<f64>();
    let rest_of_weights = 1.0 - 2.0 * ends.iter().map(|(_, weight)| weight.powi(2)).sum::<f64>();
    let scale = (rest_of_scores / rest_of_weights).sqrt();
    for weight in &mut weights {
        *weight /= scale;
    }
    for (index, (_, weight)) in ends.iter().enumerate() {
        *weights.get_mut(index)? = -weight;
        *weights.get_mut(count - 1 - index)? = *weight;
    }
    Some(weights)
}

fn p_of(w: f64, count: usize) -> Option<f64> {
    use core::f64::consts::{FRAC_PI_3, PI};
    if count == FEWEST {
        return Some((6.0 / PI * (w.sqrt().asin() - FRAC_PI_3)).max(0.0));
    }
    let (n, y) = (count as f64, (1.0 - w).ln());
    let (y, centre, log_deviation) = if count > SMALL {
        (y, polynomial(&LARGE_MEAN, n.ln()), polynomial(&LARGE_DEVIATION, n.ln()))
    } else {
        let above = polynomial(&SMALL_BOUND, n) - y;
        if above <= 0.0 {
            return Some(0.0);
        }
        (-above.ln(), polynomial(&SMALL_MEAN, n), polynomial(&SMALL_DEVIATION, n))
    };
    Some(Normal::new(centre, log_deviation.exp()).ok()?.sf(y))
}

fn polynomial(terms: &[f64], x: f64) -> f64 {
    terms.iter().rev().fold(0.0, |sum, term| sum * x + term)
}
