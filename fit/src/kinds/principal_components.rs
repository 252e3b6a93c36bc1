//! Regression on the principal components of the features.

use anyhow::{Context, Result};
use nalgebra::DMatrix;

use super::{Form, Kind, Limits, Predictor, WIDE, affine::centred, formula::Formula};

/// Share of the variance that the kept components carry.
const KEPT: f64 = 0.999;

/// Least squares on the largest principal components. The result is an affine map.
pub struct PrincipalComponents;

impl Kind for PrincipalComponents {
    fn name(&self) -> &'static str {
        "pca"
    }

    fn form(&self) -> Form {
        Form::Affine
    }

    fn limits(&self) -> Limits {
        WIDE
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        let (faces, truth, centre) = centred(faces, truth);
        let transposed = faces.transpose();
        let cross = &transposed * truth;
        let decomposed = (transposed * faces).svd(true, false);
        let directions = decomposed.u.context("the features have no components")?;
        let kept = kept(decomposed.singular_values.as_slice());
        let directions = directions.columns(0, kept).into_owned();
        let mut scores = directions.tr_mul(&cross);
        scores.component_div_assign(&decomposed.singular_values.rows(0, kept));
        Ok(Box::new(Formula { degrees_of_freedom: kept, ..centre.affine(&(directions * scores)) }))
    }
}

/// Returns how many of the descending variances make up [`KEPT`] of their sum.
fn kept(variances: &[f64]) -> usize {
    let enough = KEPT * variances.iter().sum::<f64>();
    let mut sum = 0.0;
    let last = variances.iter().position(|variance| {
        sum += variance;
        sum >= enough
    });
    last.map_or(variances.len(), |last| last + 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, largest_error};

    #[test]
    fn an_affine_map_is_found_again_if_all_components_are_large() {
        assert!(largest_error(&PrincipalComponents, |face| 0.3 + 0.2 * face[0] - 0.1 * face[2]) < 1e-9);
    }

    #[test]
    fn a_direction_that_hardly_varies_is_left_out() {
        let (mut faces, _) = faces(200, 2, |_| 0.0);
        let truth: Vec<f64> = faces.column(1).iter().copied().collect();
        faces.column_mut(1).scale_mut(0.01);
        let model = PrincipalComponents.fit(&faces, &truth).unwrap();
        assert_eq!(model.weights(), 1);
        assert!((model.predict(&[0.0, 0.01]) - model.predict(&[0.0, -0.01])).abs() < 0.05);
    }
}
