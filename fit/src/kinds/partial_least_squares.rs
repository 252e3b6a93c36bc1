//! Partial least squares regression of one dependent variable (PLS1; Wold, Sjöström and Eriksson, 2001).

use anyhow::{Result, ensure};
use nalgebra::{DMatrix, DVector};

use super::{
    Form, Kind, Limits, Predictor, WIDE,
    affine::{centred, solve},
    formula::Formula,
};

/// Number of components.
const COMPONENTS: usize = 16;
/// Smallest length of a new direction relative to the first, before it counts as rounding noise.
const LEAST_LENGTH: f64 = 1e-9;

/// Least squares on a few directions with large covariance with the truth. The result is an affine map.
pub struct PartialLeastSquares;

impl Kind for PartialLeastSquares {
    fn name(&self) -> &'static str {
        "pls"
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
        let (gram, cross) = (&transposed * &faces, transposed * truth);
        let directions = directions(&gram, &cross);
        ensure!(directions.ncols() > 0, "no feature varies with the truth");
        let reduced = directions.transpose() * &gram * &directions;
        let scores = solve(reduced, &directions.tr_mul(&cross), 0.0)?;
        Ok(Box::new(Formula { degrees_of_freedom: directions.ncols(), ..centre.affine(&(&directions * scores)) }))
    }
}

/// Returns an orthonormal basis of the Krylov space of `gram` and `cross`, which the weights of the components span
/// (Helland, 1988). Orthogonalises twice for numerical stability.
fn directions(gram: &DMatrix<f64>, cross: &DVector<f64>) -> DMatrix<f64> {
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let (mut next, mut least) = (cross.clone(), 0.0);
    while basis.len() < COMPONENTS.min(cross.len()) {
        for _ in 0..2 {
            for known in &basis {
                next -= known * known.dot(&next);
            }
        }
        let length = next.norm();
        if length <= least {
            break;
        }
        let direction = &next / length;
        next = gram * &direction;
        least = LEAST_LENGTH * next.norm();
        basis.push(direction);
    }
    DMatrix::from_fn(cross.len(), basis.len(), |row, column| basis[column][row])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, largest_error};

    #[test]
    fn an_affine_map_is_found_again_by_as_many_components_as_features() {
        assert!(largest_error(&PartialLeastSquares, |face| 0.3 + 0.2 * face[0] - 0.1 * face[2]) < 1e-9);
    }

    #[test]
    fn one_feature_takes_one_component() {
        let (faces, truth) = faces(50, 1, |face| 0.5 * face[0]);
        let model = PartialLeastSquares.fit(&faces, &truth).unwrap();
        assert_eq!(model.weights(), 1);
        assert!((model.predict(&[0.4]) - 0.2).abs() < 1e-9);
    }
}
