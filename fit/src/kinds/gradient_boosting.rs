//! Gradient boosting of regression trees (Friedman, 2001), using the trees of `smartcore`.

use anyhow::{Context, Result};
use nalgebra::{DMatrix, DVector};
use smartcore::{
    linalg::basic::matrix::DenseMatrix,
    tree::decision_tree_regressor::{DecisionTreeRegressor, DecisionTreeRegressorParameters},
};

use super::{Form, Kind, Limits, NARROW, Predictor};

const TREES: usize = 100;
/// Learning rate: the share of each tree's prediction that is added.
const RATE: f64 = 0.1;
const DEPTH: u16 = 3;
/// Numbers of a tree's inner node: feature, threshold, and position of its children.
pub const NODE: usize = 3;

/// Boosted trees. Each tree is fitted to the residuals of the previous trees.
pub struct GradientBoosting;

/// A regression tree on dense rows.
pub type Tree = DecisionTreeRegressor<f64, f64, DenseMatrix<f64>, Vec<f64>>;

struct Fitted {
    mean: f64,
    trees: Vec<Tree>,
}

impl Kind for GradientBoosting {
    fn name(&self) -> &'static str {
        "gb"
    }

    fn form(&self) -> Form {
        Form::Large
    }

    fn limits(&self) -> Limits {
        NARROW
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        let faces = dense(faces)?;
        let mean = DVector::from_column_slice(truth).mean();
        let mut residuals: Vec<f64> = truth.iter().map(|truth| truth - mean).collect();
        let trees = (0..TREES).map(|_| {
            let tree = tree(&faces, &residuals, DEPTH)?;
            let estimates = tree.predict(&faces).context("a tree does not accept the faces that it was fitted to")?;
            residuals.iter_mut().zip(estimates).for_each(|(residual, estimate)| *residual -= RATE * estimate);
            Ok(tree)
        });
        Ok(Box::new(Fitted { mean, trees: trees.collect::<Result<_>>()? }))
    }
}

/// Fits a tree with at most `depth` splits from root to leaf. `smartcore` counts nodes instead.
pub fn tree(faces: &DenseMatrix<f64>, truth: &Vec<f64>, depth: u16) -> Result<Tree> {
    let parameters = DecisionTreeRegressorParameters::default().with_max_depth(depth + 1);
    Tree::fit(faces, truth, parameters).context("cannot grow a tree")
}

/// Converts faces to a `smartcore` matrix.
pub fn dense(faces: &DMatrix<f64>) -> Result<DenseMatrix<f64>> {
    DenseMatrix::new(faces.nrows(), faces.ncols(), faces.as_slice().to_vec(), true).context("there are no faces")
}

/// Converts one face to a `smartcore` matrix.
pub fn dense_row(face: &[f64]) -> Option<DenseMatrix<f64>> {
    DenseMatrix::new(1, face.len(), face.to_vec(), true).ok()
}

/// Predicts the value of one face.
pub fn estimate(tree: &Tree, face: &DenseMatrix<f64>) -> f64 {
    tree.predict(face).ok().and_then(|estimates| estimates.first().copied()).unwrap_or(f64::NAN)
}

impl Predictor for Fitted {
    fn predict(&self, face: &[f64]) -> f64 {
        let Some(face) = dense_row(face) else { return f64::NAN };
        self.mean + RATE * self.trees.iter().map(|tree| estimate(tree, &face)).sum::<f64>()
    }

    fn weights(&self) -> usize {
        self.trees.len() << DEPTH
    }

    /// Counts every tree as complete.
    fn numbers(&self) -> usize {
        self.trees.len() * ((1 << DEPTH) + NODE * ((1 << DEPTH) - 1)) + 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, unexplained};

    #[test]
    fn a_step_is_found() {
        let (faces, truth) = faces(300, 2, |face| if face[1] > 0.3 { 1.0 } else { 0.0 });
        let model = GradientBoosting.fit(&faces, &truth).unwrap();
        assert!((model.predict(&[0.0, 0.2])).abs() < 0.01 && (model.predict(&[0.0, 0.4]) - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_nonlinear_function_is_found_from_many_faces() {
        let truth = |face: &[f64]| face[0] * face[1] + (3.0 * face[2]).sin();
        assert!(unexplained(&GradientBoosting, 1500, truth) < 0.09);
    }
}
