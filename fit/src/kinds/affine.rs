//! Multiple linear regression: ordinary least squares and ridge regression.

use anyhow::{Context, Result};
use nalgebra::{DMatrix, DVector};

use super::{Form, Kind, Limits, Predictor, WIDE, formula::Formula};

/// Ridge penalty on a standardised feature, relative to its variance.
const RIDGE: f64 = 0.001;
/// The penalty that keeps ordinary least squares solvable if features repeat each other.
const TINY: f64 = 1e-9;

/// Ordinary least squares.
pub struct LeastSquares;

/// Ridge regression: least squares with a penalty on the squared weights.
pub struct Ridge;

impl Kind for LeastSquares {
    fn name(&self) -> &'static str {
        "ols"
    }

    fn form(&self) -> Form {
        Form::Affine
    }

    fn limits(&self) -> Limits {
        WIDE
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        Ok(Box::new(least_squares(faces, truth, TINY)?))
    }
}

impl Kind for Ridge {
    fn name(&self) -> &'static str {
        "ridge"
    }

    fn form(&self) -> Form {
        Form::Affine
    }

    fn limits(&self) -> Limits {
        WIDE
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        Ok(Box::new(least_squares(faces, truth, RIDGE)?))
    }
}

/// Fits an affine map by least squares, with a penalty of `ridge` times the mean variance on the squared weights.
pub fn least_squares(faces: &DMatrix<f64>, truth: &[f64], ridge: f64) -> Result<Formula> {
    let (faces, truth, centre) = centred(faces, truth);
    let transposed = faces.transpose();
    Ok(centre.affine(&solve(&transposed * faces, &(transposed * truth), ridge)?))
}

/// Solves `(A + ridge mean(diag A)) w = c`.
pub fn solve(mut gram: DMatrix<f64>, cross: &DVector<f64>, ridge: f64) -> Result<DVector<f64>> {
    let penalty = ridge * gram.diagonal().mean();
    (0..gram.nrows()).for_each(|index| gram[(index, index)] += penalty);
    Ok(gram.cholesky().context("no feature varies in these faces")?.solve(cross))
}

/// The means that centring subtracts.
pub struct Centre {
    /// Mean of each feature.
    pub face: DVector<f64>,
    /// Mean of the truth.
    pub truth: f64,
}

impl Centre {
    /// Returns the affine map of features whose weights were fitted to centred data.
    pub fn affine(&self, weights: &DVector<f64>) -> Formula {
        Formula::affine(weights.as_slice().to_vec(), self.truth - weights.dot(&self.face))
    }
}

/// Subtracts the means of faces and truth.
pub fn centred(faces: &DMatrix<f64>, truth: &[f64]) -> (DMatrix<f64>, DVector<f64>, Centre) {
    let mut truth = DVector::from_column_slice(truth);
    let centre = Centre { face: faces.row_mean().transpose(), truth: truth.mean() };
    let mut faces = faces.clone();
    faces.column_iter_mut().zip(&centre.face).for_each(|(mut column, mean)| column.add_scalar_mut(-mean));
    truth.add_scalar_mut(-centre.truth);
    (faces, truth, centre)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, largest_error};

    #[test]
    fn an_affine_map_is_found_again() {
        let truth = |face: &[f64]| 0.3 + 0.2 * face[0] - 0.1 * face[2];
        assert!(largest_error(&LeastSquares, truth) < 1e-7);
    }

    #[test]
    fn ridge_shrinks_the_weight_of_a_single_feature_by_a_thousandth() {
        let (faces, truth) = faces(200, 1, |face| face[0]);
        let [line, ridge] = [&LeastSquares as &dyn Kind, &Ridge].map(|kind| kind.fit(&faces, &truth).unwrap());
        let slope = |model: &dyn Predictor| model.predict(&[1.0]) - model.predict(&[0.0]);
        assert!((slope(&*line) / slope(&*ridge) - 1.0 - RIDGE).abs() < 1e-6);
    }

    #[test]
    fn repeated_features_share_a_weight() {
        let (one, truth) = faces(50, 1, |face| face[0]);
        let twice = DMatrix::from_fn(50, 2, |row, _| one[(row, 0)]);
        assert!((LeastSquares.fit(&twice, &truth).unwrap().predict(&[0.5, 0.5]) - 0.5).abs() < 1e-6);
    }
}
