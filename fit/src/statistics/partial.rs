//! Partial F tests: the relation of a value to one of several correlated regressors, controlling for the others.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

/// Added to the moments of standardised regressors, so that constant regressors do not make them singular.
const RIDGE: f64 = 1e-12;
/// Variance inflation factor above which a regressor counts as a linear combination of the others.
const MAX_INFLATION: f64 = 1e8;
/// Share of the variance below which a remainder is rounding error.
const ROUNDING: f64 = 1e-12;

/// Correlated regressors, with rows in groups that each have a mean of their own (fixed effects). They are prepared
/// once to test any number of values.
pub struct Regressors {
    /// The regressors without the group means, scaled to length 1.
    columns: DMatrix<f64>,
    /// Inverse of their second moments.
    inverse: DMatrix<f64>,
    groups: Groups,
    /// Residual degrees of freedom.
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

    /// Returns the partial F of `values` with every regressor, controlling for all other regressors and the groups,
    /// with 1 and the residual degrees of freedom. It is symmetric: regressing the values on the regressor or the
    /// regressor on the values gives the same F. It is 0 for a regressor that is constant or a combination of the
    /// others.
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

/// The division of the rows into groups.
struct Groups {
    /// Index of the group of each row.
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

    /// Subtracts the mean of every group.
    fn centre(&self, values: &mut [f64]) {
        let mut sums = vec![0.0; self.sizes.len()];
        self.of_row.iter().zip(values.iter()).for_each(|(group, value)| sums[*group] += value);
        let means: Vec<f64> = sums.iter().zip(&self.sizes).map(|(sum, size)| sum / size).collect();
        self.of_row.iter().zip(values).for_each(|(group, value)| *value -= means[*group]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tests two strongly correlated regressors and a value that follows only the first.
    #[test]
    fn a_value_has_no_partial_f_with_a_regressor_that_merely_accompanies_its_cause() {
        let first = |row: usize| (row as f64 * 0.7).sin();
        let regressors = DMatrix::from_fn(200, 2, |row, column| {
            first(row) + if column == 1 { 0.3 * (row as f64 * 1.9).cos() } else { 0.0 }
        });
        let values: Vec<f64> = (0..200).map(|row| first(row) + 0.1 * (row as f64 * 2.3).sin()).collect();
        let f = Regressors::new(regressors, &[0; 200]).unwrap().partial_f(&values);
        assert!(f[0] > 1000.0 && f[1] < 5.0, "{f:?}");
    }

    #[test]
    fn constant_and_repeated_regressors_have_no_f_and_do_not_change_the_others() {
        let regressors = DMatrix::from_fn(50, 4, |row, column| match column {
            0 => (row as f64 * 0.7).sin(),
            1 => 0.3,
            _ => (row as f64 * 1.3).cos(),
        });
        let values: Vec<f64> = (0..50).map(|row| (f64::from(row) * 0.7).sin() + 0.1 * f64::from(row % 3)).collect();
        let alone = Regressors::new(regressors.columns(0, 3).into_owned(), &[0; 50]).unwrap().partial_f(&values);
        let all = Regressors::new(regressors, &[0; 50]).unwrap().partial_f(&values);
        assert!((all[0] / alone[0] - 1.0).abs() < 1e-4 && alone[2] > 0.0, "{alone:?} {all:?}");
        assert!(all[1] + all[2] + all[3] < f64::EPSILON);
    }

    #[test]
    fn as_many_groups_as_rows_leave_nothing_to_test() {
        assert!(Regressors::new(DMatrix::identity(3, 1), &[0, 1, 2]).is_none());
    }
}
