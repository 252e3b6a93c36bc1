//! What one of several things that go together has to do with a value, when the others are held.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

/// Added to the moments of standardised regressors, so that constant ones do not stop the others.
const RIDGE: f64 = 1e-12;
/// Variance inflation above which a regressor is no more than what the others make up.
const MOST_INFLATION: f64 = 1e8;
/// Part of the variance below which what is left is rounding.
const ROUNDING: f64 = 1e-12;

/// Regressors that go together, in groups of rows that each have a mean of their own: worked out once, to test any
/// number of values.
pub struct Together {
    /// Of length 1, about the means of the groups.
    regressors: DMatrix<f64>,
    /// Inverse of their moments.
    inverse: DMatrix<f64>,
    groups: Groups,
    /// Degrees of freedom left.
    left: f64,
}

impl Together {
    /// Of regressors (rows x columns) and the group of each row. `None` if no row is left over.
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
        let rank = moments.symmetric_eigenvalues().iter().filter(|value| **value > MOST_INFLATION.recip()).count();
        let left = regressors.nrows().checked_sub(groups.sizes.len() + rank).filter(|left| *left > 0)? as f64;
        let ridge = DMatrix::identity(moments.nrows(), moments.ncols()) * RIDGE;
        let inverse = (moments + ridge).cholesky()?.inverse();
        Some(Self { regressors, inverse, groups, left })
    }

    /// Partial F of `values` with every regressor, on 1 and the degrees of freedom that are left: what adding either
    /// to a regression of the other on all other regressors and the groups explains. 0 where a regressor does
    /// not vary or cannot be told from the others.
    pub fn partial_f(&self, values: &[f64]) -> Vec<f64> {
        let mut values = DVector::from_column_slice(values);
        self.groups.centre(values.as_mut_slice());
        let along = self.regressors.tr_mul(&values);
        let weights = &self.inverse * &along;
        let total = values.norm_squared();
        let unexplained = (total - along.dot(&weights)).max(total * ROUNDING);
        let f = |(weight, inflation): (&f64, f64)| {
            let told = inflation < MOST_INFLATION && total > 0.0;
            if told { weight.powi(2) / inflation / (unexplained / self.left) } else { 0.0 }
        };
        weights.iter().zip(self.inverse.diagonal().iter().copied()).map(f).collect()
    }
}

/// Which rows belong together.
struct Groups {
    /// Rank of the group of each row.
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

    /// Takes its mean off every group.
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

    /// Two regressors that mostly go together, and a value that follows the first only.
    #[test]
    fn value_that_follows_one_of_two_that_go_together_has_little_to_do_with_the_other() {
        let first = |row: usize| (row as f64 * 0.7).sin();
        let regressors = DMatrix::from_fn(200, 2, |row, column| {
            first(row) + if column == 1 { 0.3 * (row as f64 * 1.9).cos() } else { 0.0 }
        });
        let values: Vec<f64> = (0..200).map(|row| first(row) + 0.1 * (row as f64 * 2.3).sin()).collect();
        let f = Together::new(regressors, &[0; 200]).unwrap().partial_f(&values);
        assert!(f[0] > 1000.0 && f[1] < 5.0, "{f:?}");
    }

    #[test]
    fn constants_and_repeated_regressors_have_no_f_and_leave_the_others_theirs() {
        let regressors = DMatrix::from_fn(50, 4, |row, column| match column {
            0 => (row as f64 * 0.7).sin(),
            1 => 0.3,
            _ => (row as f64 * 1.3).cos(),
        });
        let values: Vec<f64> = (0..50).map(|row| (f64::from(row) * 0.7).sin() + 0.1 * f64::from(row % 3)).collect();
        let alone = Together::new(regressors.columns(0, 3).into_owned(), &[0; 50]).unwrap().partial_f(&values);
        let all = Together::new(regressors, &[0; 50]).unwrap().partial_f(&values);
        assert!((all[0] / alone[0] - 1.0).abs() < 1e-4 && alone[2] > 0.0, "{alone:?} {all:?}");
        assert!(all[1] + all[2] + all[3] < f64::EPSILON);
    }

    #[test]
    fn as_many_groups_as_rows_leave_nothing_to_test() {
        assert!(Together::new(DMatrix::identity(3, 1), &[0, 1, 2]).is_none());
    }
}
