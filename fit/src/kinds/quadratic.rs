//! Polynomial regression of degree 2.

use anyhow::Result;
use facewire::solve::FormulaKind;
use nalgebra::DMatrix;

use super::{
    Form, Kind, Limits, Predictor, WIDE,
    affine::least_squares,
    formula::{Formula, multiplied},
};

/// Ridge penalty on a feature or product, relative to their mean variance.
const RIDGE: f64 = 0.001;

/// Ridge regression on the features, and on the squares and products of the first of them.
pub struct Quadratic;

impl Kind for Quadratic {
    fn name(&self) -> &'static str {
        "poly"
    }

    fn form(&self) -> Form {
        Form::Quadratic
    }

    fn limits(&self) -> Limits {
        WIDE
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        let mut fitted = least_squares(&with_products(faces), truth, RIDGE)?;
        let products = fitted.weights.split_off(faces.ncols());
        Ok(Box::new(Formula { kind: FormulaKind::Quadratic, products, ..fitted }))
    }
}

/// Appends the products to the features: first with first to last, second with second to last, and so on.
fn with_products(faces: &DMatrix<f64>) -> DMatrix<f64> {
    let (features, multiplied) = (faces.ncols(), multiplied(faces.ncols()));
    let pairs: Vec<_> = (0..multiplied).flat_map(|one| (one..multiplied).map(move |other| (one, other))).collect();
    let mut all = faces.clone().resize_horizontally(features + pairs.len(), 0.0);
    for (index, (one, other)) in pairs.into_iter().enumerate() {
        all.set_column(features + index, &faces.column(one).component_mul(&faces.column(other)));
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, unexplained};

    #[test]
    fn squares_and_products_are_found() {
        let truth = |face: &[f64]| 0.2 + 0.1 * face[0] + 0.3 * face[0] * face[2] - 0.2 * face[1].powi(2);
        assert!(unexplained(&Quadratic, 300, truth) < 1e-3);
    }

    #[test]
    fn features_that_are_not_multiplied_enter_linearly() {
        let (faces, truth) = faces(500, 30, |face| face[0] * face[1] + 0.5 * face[29]);
        let model = Quadratic.fit(&faces, &truth).unwrap();
        let row: Vec<f64> = faces.row(3).iter().copied().collect();
        assert!((model.predict(&row) - truth[3]).abs() < 0.02);
        assert_eq!(model.weights(), 30 + 24 * 25 / 2);
    }

    #[test]
    fn the_prediction_is_the_affine_map_of_features_and_products() {
        let (faces, truth) = faces(100, 4, |face| face[0] * face[3] + face[1]);
        let model = Quadratic.fit(&faces, &truth).unwrap();
        let map = least_squares(&with_products(&faces), &truth, RIDGE).unwrap();
        let row: Vec<f64> = with_products(&faces).row(5).iter().copied().collect();
        assert!((model.predict(&row[..4]) - map.predict(&row)).abs() < 1e-12);
        assert_eq!(model.weights(), 14);
    }
}
