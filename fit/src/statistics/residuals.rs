//! Diagnostics of the residuals of a regression (truth minus estimate).

use nalgebra::DMatrix;

use super::{TestResult, f_statistic, mean, regression::ColumnSpace};

/// Returns the Durbin-Watson statistic of residuals in their order: 2 if neighbours are uncorrelated, near 0 if they
/// are alike, near 4 if they alternate. Returns 2 if all residuals are 0.
pub fn durbin_watson(residuals: &[f64]) -> f64 {
    let steps: f64 = residuals.windows(2).map(|pair| (pair[1] - pair[0]).powi(2)).sum();
    let squares: f64 = residuals.iter().map(|residual| residual.powi(2)).sum();
    if squares > 0.0 { steps / squares } else { 2.0 }
}

/// The results of the Breusch-Pagan test, which tests whether the spread of the residuals changes with the regressors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BreuschPagan {
    /// Lagrange multiplier, `n R2`: chi-squared with one degree of freedom per regressor.
    pub lagrange: TestResult,
    /// The variant of the test with an F distribution.
    pub f: TestResult,
}

/// Performs the Breusch-Pagan test in Koenker's form, which does not assume normal residuals: regresses the squared
/// residuals on `regressors` (rows x columns, without a constant). Returns `None` if there are too few rows or all
/// values are constant.
pub fn breusch_pagan(residuals: &[f64], regressors: &DMatrix<f64>) -> Option<BreuschPagan> {
    use statrs::distribution::{ChiSquared, ContinuousCDF};
    let squares: Vec<f64> = residuals.iter().map(|residual| residual.powi(2)).collect();
    let space = ColumnSpace::of(regressors)?;
    let (r_squared, rank) = (space.explain(&squares)?, space.rank());
    let statistic = squares.len() as f64 * r_squared;
    let p = ChiSquared::new(rank as f64).ok()?.sf(statistic);
    Some(BreuschPagan { lagrange: TestResult { statistic, p }, f: f_statistic(r_squared, squares.len(), rank)? })
}

/// Returns the autocorrelation at lags 0 to `lags`, relative to lag 0. Returns zeros if the values are constant.
pub fn autocorrelation(values: &[f64], lags: usize) -> Vec<f64> {
    let centre = mean(values.iter().copied());
    let centred: Vec<f64> = values.iter().map(|value| value - centre).collect();
    let product = |lag: usize| -> f64 { centred.iter().skip(lag).zip(&centred).map(|(a, b)| a * b).sum() };
    let variance = product(0);
    (0..=lags).map(|lag| if variance > 0.0 { product(lag) / variance } else { 0.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alternating_residuals_give_a_durbin_watson_near_4_and_equal_ones_0() {
        let alternating: Vec<f64> = (0..1000).map(|i| if i % 2 == 0 { 1.0 } else { -1.0 }).collect();
        assert!((durbin_watson(&alternating) - 4.0).abs() < 0.01);
        assert!(durbin_watson(&[0.3; 50]).abs() < 1e-12);
    }

    #[test]
    fn equal_squares_cannot_be_tested_for_a_changing_spread() {
        let regressors = DMatrix::from_fn(8, 1, |row, _| row as f64);
        assert_eq!(breusch_pagan(&[0.5; 8], &regressors), None);
    }
}
