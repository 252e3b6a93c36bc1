//! How much a regression explains.

use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::Tested;

/// Singular values below this part of the largest one belong to columns that repeat others.
const SAME: f64 = 1e-10;

/// Overall F statistic of a regression with `parameters` weights beside its constant, from its R2 on `rows` rows.
/// `None` if no row is left over.
///
/// Its p value holds for rows that the weights were fitted to by least squares; for others F is a measure of size only.
pub fn f_statistic(r_squared: f64, rows: usize, parameters: usize) -> Option<Tested> {
    let left = rows.checked_sub(parameters + 1).filter(|left| *left > 0 && parameters > 0)? as f64;
    let statistic = (r_squared / parameters as f64) / ((1.0 - r_squared) / left);
    let p = FisherSnedecor::new(parameters as f64, left).ok()?.sf(statistic.max(0.0));
    Some(Tested { statistic, p })
}

/// F of a regression on one value alone, from its correlation with the truth in `rows` rows; infinite where they are one.
/// 0 if no row is left over.
pub fn f_regression(pearson: f64, rows: usize) -> f64 {
    f_statistic(pearson.powi(2), rows, 1).map_or(0.0, |tested| tested.statistic)
}

/// What the columns of a regression span: worked out once, for any number of regressions on them.
pub struct Directions(DMatrix<f64>);

impl Directions {
    /// Of columns about their means. None are left of constant columns; `None` if they are not numbers.
    pub fn of(columns: &DMatrix<f64>) -> Option<Self> {
        let mut centred = columns.clone();
        centred.column_iter_mut().for_each(|mut column| column.add_scalar_mut(-column.mean()));
        let decomposed = centred.svd(true, false);
        let values = &decomposed.singular_values;
        let least = values.max() * SAME;
        let kept: Vec<usize> = (0..values.len()).filter(|index| values[*index] > least).collect();
        Some(Self(decomposed.u?.select_columns(&kept)))
    }

    /// Rank of the columns.
    pub fn rank(&self) -> usize {
        self.0.ncols()
    }

    /// R2 of the least-squares regression of `values` on the columns and a constant. `None` if the values or all
    /// columns are constant.
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
        let directions = Directions::of(&columns).unwrap();
        assert!((directions.explain(&[1.0, 3.0, 5.0, 7.0, 9.0, 11.0]).unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(directions.rank(), 1);
        assert_eq!(directions.explain(&[1.0; 6]), None);
    }

    #[test]
    fn regression_with_as_many_weights_as_rows_has_no_f() {
        assert_eq!(f_statistic(0.9, 5, 4), None);
        assert_eq!(f_statistic(0.9, 5, 0), None);
    }
}
