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

/// R2 of the least-squares regression of `values` on `columns` and a constant, and the rank of the columns.
/// `None` if the values or all columns are constant.
pub fn explained(columns: &DMatrix<f64>, values: &[f64]) -> Option<(f64, usize)> {
    let mut centred = columns.clone();
    centred.column_iter_mut().for_each(|mut column| column.add_scalar_mut(-column.mean()));
    let mut target = DVector::from_column_slice(values);
    target.add_scalar_mut(-target.mean());
    let total = target.norm_squared();
    let scale = values.iter().map(|value| value.powi(2)).sum::<f64>();
    if total <= scale * f64::EPSILON {
        return None;
    }
    let decomposed = centred.svd(true, false);
    let least = decomposed.singular_values.max() * SAME;
    let rank = decomposed.singular_values.iter().filter(|value| **value > least).count();
    let directions = decomposed.u?;
    let along = directions.column_iter().zip(&decomposed.singular_values).filter(|(_, value)| **value > least);
    let part: f64 = along.map(|(direction, _)| direction.dot(&target).powi(2)).sum();
    (rank > 0).then_some((part / total, rank))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_columns_count_once() {
        let columns = DMatrix::from_fn(6, 2, |row, _| row as f64);
        let (r_squared, rank) = explained(&columns, &[1.0, 3.0, 5.0, 7.0, 9.0, 11.0]).unwrap();
        assert!((r_squared - 1.0).abs() < 1e-12 && rank == 1);
    }

    #[test]
    fn regression_with_as_many_weights_as_rows_has_no_f() {
        assert_eq!(f_statistic(0.9, 5, 4), None);
        assert_eq!(f_statistic(0.9, 5, 0), None);
    }
}
