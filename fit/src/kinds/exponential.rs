//! Multiple exponential and log-exponential regression.
//!
//! The paper names both without an equation. Here, exponential regression means `y = exp(w f + b) - c`, so that the
//! logarithm of the coefficient is linear in the features; `c` ([`LIFT`]) is needed because most coefficients are 0.
//! Log-exponential regression applies the same to `sign(f) ln(1 + |f|)`, because displacements have signs.
//! Least squares on the logarithm would weigh errors near 0 most, so it is only the start of a Levenberg-Marquardt fit
//! of the coefficient itself.

use anyhow::Result;
use facewire::solve::{FormulaKind, LIFT, MAX_EXPONENT, signed_logarithm};
use nalgebra::{DMatrix, DVector};

use super::{
    Form, Kind, Limits, Predictor, WIDE,
    affine::{least_squares, solve},
    formula::Formula,
};

/// Ridge penalty of the least-squares start, and initial damping of the steps, relative to the mean variance.
const RIDGE: f64 = 0.001;
/// Number of steps of the fit.
const STEPS: usize = 12;
/// Factors of the damping after a step that reduced the error, and after one that did not.
const EASE: f64 = 0.3;
const STRAIN: f64 = 5.0;

/// Regression by the exponential of an affine map.
pub struct Exponential;

/// Regression by the exponential of an affine map of the features' logarithms.
pub struct LogExponential;

impl Kind for Exponential {
    fn name(&self) -> &'static str {
        "exp"
    }

    fn form(&self) -> Form {
        Form::Exponential
    }

    fn limits(&self) -> Limits {
        WIDE
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        Ok(Box::new(Formula { kind: FormulaKind::Exponential, ..fit(faces, truth)? }))
    }
}

impl Kind for LogExponential {
    fn name(&self) -> &'static str {
        "log-exp"
    }

    fn form(&self) -> Form {
        Form::LogExponential
    }

    fn limits(&self) -> Limits {
        WIDE
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        Ok(Box::new(Formula { kind: FormulaKind::LogExponential, ..fit(&faces.map(signed_logarithm), truth)? }))
    }
}

/// Fits the exponent.
fn fit(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Formula> {
    let lifted: Vec<f64> = truth.iter().map(|truth| truth.max(0.0) + LIFT).collect();
    let logarithms: Vec<f64> = lifted.iter().map(|truth| truth.ln()).collect();
    let start = least_squares(faces, &logarithms, RIDGE)?;
    let faces = faces.clone().insert_column(faces.ncols(), 1.0);
    let mut weights = DVector::from_vec(start.weights).push(start.offset);
    let truth = DVector::from_vec(lifted);
    let (mut errors, mut damping) = (errors(&faces, &weights, &truth), RIDGE);
    for _ in 0..STEPS {
        let next = &weights + step(&faces, &errors, damping)?;
        let next_errors = self::errors(&faces, &next, &truth);
        if next_errors.residuals.norm_squared() < errors.residuals.norm_squared() {
            (weights, errors, damping) = (next, next_errors, damping * EASE);
        } else {
            damping *= STRAIN;
        }
    }
    let last = weights.len() - 1;
    Ok(Formula::affine(weights.as_slice()[..last].to_vec(), weights[last]))
}

/// The predictions of an exponent and its residuals.
struct Errors {
    estimates: DVector<f64>,
    residuals: DVector<f64>,
}

fn errors(faces: &DMatrix<f64>, weights: &DVector<f64>, truth: &DVector<f64>) -> Errors {
    let estimates = (faces * weights).map(|exponent| exponent.min(MAX_EXPONENT).exp());
    Errors { residuals: truth - &estimates, estimates }
}

/// Returns a damped Gauss-Newton step. The derivative of the exponential is the exponential.
fn step(faces: &DMatrix<f64>, errors: &Errors, damping: f64) -> Result<DVector<f64>> {
    let mut slopes = faces.clone();
    slopes.column_iter_mut().for_each(|mut column| column.component_mul_assign(&errors.estimates));
    let transposed = slopes.transpose();
    solve(&transposed * &slopes, &(transposed * &errors.residuals), damping)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::largest_error;

    #[test]
    fn the_exponential_of_an_affine_map_is_found_again() {
        let truth = |face: &[f64]| (-0.6 + 0.3 * face[0] - 0.2 * face[1]).exp() - LIFT;
        assert!(largest_error(&Exponential, truth) < 1e-6);
    }

    #[test]
    fn exponential_of_logarithms_is_found_again() {
        let truth =
            |face: &[f64]| (-0.6 + 0.5 * signed_logarithm(face[0]) - 0.3 * signed_logarithm(face[2])).exp() - LIFT;
        assert!(largest_error(&LogExponential, truth) < 1e-6);
        assert!(largest_error(&Exponential, truth) > 1e-3);
    }
}
