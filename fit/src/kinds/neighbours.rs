//! Regression on the nearest neighbours.

use anyhow::{Context, Result};
use nalgebra::DMatrix;
use smartcore::{
    algorithm::neighbour::KNNAlgorithmName,
    linalg::basic::matrix::DenseMatrix,
    metrics::distance::euclidian::Euclidian,
    neighbors::{
        KNNWeightFunction,
        knn_regressor::{KNNRegressor, KNNRegressorParameters},
    },
};

use super::{
    Form, Kind, Limits, NARROW, Predictor,
    gradient_boosting::{dense, dense_row},
};

/// Neighbours that are asked, each heard by the inverse of its distance.
const NEIGHBOURS: usize = 8;

/// Mean of the nearest faces.
pub struct Neighbours;

struct Fitted {
    found: KNNRegressor<f64, f64, DenseMatrix<f64>, Vec<f64>, Euclidian<f64>>,
    faces: usize,
    numbers: usize,
}

impl Kind for Neighbours {
    fn name(&self) -> &'static str {
        "knn"
    }

    fn form(&self) -> Form {
        Form::Large
    }

    fn limits(&self) -> Limits {
        NARROW
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        let parameters = KNNRegressorParameters::default()
            .with_k(NEIGHBOURS)
            .with_algorithm(KNNAlgorithmName::LinearSearch)
            .with_weight(KNNWeightFunction::Distance);
        let found = KNNRegressor::fit(&dense(faces)?, &truth.to_vec(), parameters).context("too few faces")?;
        Ok(Box::new(Fitted { found, faces: truth.len(), numbers: faces.len() + truth.len() }))
    }
}

impl Predictor for Fitted {
    fn predict(&self, face: &[f64]) -> f64 {
        let estimates = dense_row(face).and_then(|face| self.found.predict(&face).ok());
        estimates.and_then(|estimates| estimates.first().copied()).unwrap_or(f64::NAN)
    }

    /// Effective, as for a smoother: faces over neighbours.
    fn weights(&self) -> usize {
        self.faces / NEIGHBOURS
    }

    fn numbers(&self) -> usize {
        self.numbers
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, unexplained};

    #[test]
    fn face_that_was_seen_has_its_own_truth() {
        let (faces, truth) = faces(100, 3, |face| face[0] * face[1]);
        let model = Neighbours.fit(&faces, &truth).unwrap();
        let row: Vec<f64> = faces.row(17).iter().copied().collect();
        assert!((model.predict(&row) - truth[17]).abs() < 1e-9);
    }

    #[test]
    fn bent_function_is_found_from_many_faces() {
        assert!(unexplained(&Neighbours, 2000, |face| face[0] * face[1] + face[2]) < 0.03);
    }
}
