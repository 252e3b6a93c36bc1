//! Significance and explanatory power of a regression.

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::TestResult;

/// Singular values below this share of the largest one belong to columns that repeat others.
const SAME: f64 = 1e-10;

/// Returns the overall F statistic of a regression with `parameters` weights and a constant, from its R2 on `rows`
/// rows. Returns `None` if no degree of freedom remains.
///
/// The p value holds for rows that the weights were fitted to by least squares. For other rows, F only measures the
/// size of the effect.
pub fn f_statistic(r_squared: f64, rows: usize, parameters: usize) -> Option<TestResult> {
    let rest = rows.checked_sub(parameters + 1).filter(|rest| *rest > 0 && parameters > 0)? as f64;
    let statistic = (r_squared / parameters as f64) / ((1.0 - r_squared) / rest);
    let p = FisherSnedecor::new(parameters as f64, rest).ok()?.sf(statistic.max(0.0));
    Some(TestResult { statistic, p })
}

/// Returns the F of a regression on a single regressor, from its correlation with the truth in `rows` rows. F is
/// infinite for a perfect correlation, and 0 if no degree of freedom remains.
pub fn f_regression(pearson: f64, rows: usize) -> f64 {
    f_statistic(pearson.powi(2), rows, 1).map_or(0.0, |tested| tested.statistic)
}

/// The column space of the regressors, computed once for any number of regressions on them.
pub struct ColumnSpace(DMatrix<f64>);

impl ColumnSpace {
    /// Computes the space of the centred columns. Returns `None` if they contain NaN.
    pub fn of(columns: &DMatrix<f64>) -> Option<Self> {
        let mut centred = columns.clone();
        centred.column_iter_mut().for_each(|mut column| column.add_scalar_mut(-column.mean()));
        let decomposed = centred.svd(true, false);
        let values = &decomposed.singular_values;
        let least = values.max() * SAME;
        let kept: Vec<usize> = (0..values.len()).filter(|index| values[*index] > least).collect();
        Some(Self(decomposed.u?.select_columns(&kept)))
    }

    /// Returns the rank of the columns: 0 if all of them are constant.
    pub fn rank(&self) -> usize {
        self.0.ncols()
    }

    /// Returns R2 of the least-squares regression of `values` on the columns and a constant. Returns `None` if the
    /// values or all columns are constant.
    pub fn explain(&self, values: &[f64]) -> Option<f64> {
        let mut target = DVector::from_column_slice(values);
        target.add_scalar_mut(-target.mean());
        let total = target.norm_squared();
        let scale = values.iter().map(|value| value.powi(2)).sum::<f64>();
        let varies = total > scale * f64::EPSILON && self.rank() > 0;
        varies.then(|| self.0.tr_mul(&target).norm_squared() / total)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_columns_count_once() {
        let columns = DMatrix::from_fn(6, 2, |row, _| row as f64);
        let space = ColumnSpace::of(&columns).unwrap();
        assert!((space.explain(&[1.0, 3.0, 5.0, 7.0, 9.0, 11.0]).unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(space.rank(), 1);
        assert_eq!(space.explain(&[1.0; 6]), None);
    }

    #[test]
    fn a_regression_with_as_many_weights_as_rows_has_no_f() {
        assert_eq!(f_statistic(0.9, 5, 4), None);
        assert_eq!(f_statistic(0.9, 5, 0), None);
    }
}
