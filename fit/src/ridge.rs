//! Linear regression with forward selection, on the second moments of the data.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Ridge penalty relative to the variance of a standardised column: enough to keep near-equal columns from
/// fighting, too little to shrink an estimate.
const RIDGE: f64 = 0.003;

/// Second moments of standardised columns with one another and with the centred targets.
pub struct Moments {
    /// Columns x columns, summed over rows.
    gram: DMatrix<f64>,
    /// Columns x targets, summed over rows.
    cross: DMatrix<f64>,
    rows: f64,
}

/// Centre and scale of each column, centre of each target.
pub struct Scale {
    mean: Vec<f64>,
    deviation: Vec<f64>,
    target_mean: Vec<f64>,
}

/// One target as an affine map of a few columns.
pub struct Fit {
    /// What it gives where all columns are 0.
    pub bias: f64,
    /// Column and weight, most correlated first.
    pub weights: Vec<(usize, f64)>,
}

impl Scale {
    /// Of the given rows. A column that deviates less than `least` is scaled as if it deviated by that, so that the
    /// ridge keeps its weight small: what hardly ever moves must not decide when it does.
    pub fn of(columns: &DMatrix<f64>, targets: &DMatrix<f64>, least: f64) -> Self {
        let mean: Vec<f64> = columns.column_iter().map(|column| column.mean()).collect();
        let deviation = columns.column_iter().map(|column| column.variance().sqrt().max(least)).collect();
        Self { mean, deviation, target_mean: targets.column_iter().map(|column| column.mean()).collect() }
    }

    fn standardise(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = columns.clone();
        for ((mut column, mean), deviation) in out.column_iter_mut().zip(&self.mean).zip(&self.deviation) {
            column.apply(|value| *value = (*value - mean) / deviation);
        }
        out
    }

    fn centre(&self, targets: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = targets.clone();
        for (mut column, mean) in out.column_iter_mut().zip(&self.target_mean) {
            column.add_scalar_mut(-mean);
        }
        out
    }
}

impl Moments {
    /// Of the given rows.
    pub fn of(scale: &Scale, columns: &DMatrix<f64>, targets: &DMatrix<f64>) -> Self {
        let standard = scale.standardise(columns);
        let transposed = standard.transpose();
        #[expect(clippy::cast_precision_loss, reason = "thousands of rows")]
        let rows = columns.nrows() as f64;
        Self { gram: &transposed * &standard, cross: &transposed * scale.centre(targets), rows }
    }

    /// Sum of several parts.
    pub fn sum<'a>(mut parts: impl Iterator<Item = &'a Self>) -> Option<Self> {
        let first = parts.next()?;
        let mut total = Self { gram: first.gram.clone(), cross: first.cross.clone(), rows: first.rows };
        for part in parts {
            total.gram += &part.gram;
            total.cross += &part.cross;
            total.rows += part.rows;
        }
        Some(total)
    }

    /// For every target the columns that forward selection takes: again and again the one that correlates most with
    /// what the chosen ones leave unexplained (F-regression, conditional on those before).
    pub fn select(&self, count: usize) -> Vec<Vec<usize>> {
        (0..self.cross.ncols()).into_par_iter().map(|target| self.select_for(target, count)).collect()
    }

    fn select_for(&self, target: usize, count: usize) -> Vec<usize> {
        let mut chosen: Vec<usize> = Vec::with_capacity(count);
        let mut residual: DVector<f64> = self.cross.column(target).into_owned();
        while chosen.len() < count.min(self.gram.ncols()) {
            for index in &chosen {
                residual[*index] = 0.0;
            }
            chosen.push(residual.iamax());
            residual = self.cross.column(target).into_owned();
            for (index, weight) in chosen.iter().zip(&self.solve(target, &chosen)) {
                residual.axpy(-weight, &self.gram.column(*index), 1.0);
            }
        }
        chosen
    }

    /// Weights of the chosen standardised columns.
    fn solve(&self, target: usize, chosen: &[usize]) -> Vec<f64> {
        let mut gram = self.gram.select_rows(chosen).select_columns(chosen);
        (0..chosen.len()).for_each(|index| gram[(index, index)] += RIDGE * self.rows);
        let cross = self.cross.column(target).select_rows(chosen);
        gram.cholesky().map_or_else(|| vec![0.0; chosen.len()], |cholesky| cholesky.solve(&cross).as_slice().to_vec())
    }

    /// Fits every target on its chosen columns.
    pub fn fit(&self, scale: &Scale, chosen: &[Vec<usize>]) -> Vec<Fit> {
        chosen.par_iter().enumerate().map(|(target, columns)| self.fit_one(scale, target, columns)).collect()
    }

    fn fit_one(&self, scale: &Scale, target: usize, columns: &[usize]) -> Fit {
        let unscaled = |(column, weight): (&usize, f64)| (*column, weight / scale.deviation[*column]);
        let weights: Vec<_> = columns.iter().zip(self.solve(target, columns)).map(unscaled).collect();
        let shift: f64 = weights.iter().map(|(column, weight)| weight * scale.mean[*column]).sum();
        Fit { bias: scale.target_mean[target] - shift, weights }
    }
}

impl Fit {
    /// The fitted value for every row.
    pub fn predict(&self, columns: &DMatrix<f64>) -> DVector<f64> {
        let mut out = DVector::from_element(columns.nrows(), self.bias);
        self.weights.iter().for_each(|(column, weight)| out.axpy(*weight, &columns.column(*column), 1.0));
        out
    }
}
