//! Multiple exponential and log-exponential regression.
//!
//! The paper names both without an equation. Here, exponential regression means `y = exp(w f + b) - c`, so that the
//! logarithm of the coefficient is linear in the features; `c` is needed because most coefficients are 0.
//! Log-exponential regression applies the same to `sign(f) ln(1 + |f|)`, because displacements have signs.
//! Least squares on the logarithm would weigh errors near 0 most, so it is only the start of a Levenberg-Marquardt fit
//! of the coefficient itself.

use anyhow::Result;
use nalgebra::{DMatrix, DVector};

use super::{
    Form, Kind, Limits, Predictor, WIDE,
    affine::{Affine, dot, solve},
};

/// The constant `c`. The slopes of the steepest and the flattest part of the curve are in the ratio `(1 + c) / c`.
const LIFT: f64 = 0.25;
/// Largest exponent. Coefficients end at 1, so larger exponents have no use.
const MOST: f64 = 1.0;
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

struct Fitted {
    weights: DVector<f64>,
    offset: f64,
    of_logarithms: bool,
}

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
        let (weights, offset) = fit(faces, truth)?;
        Ok(Box::new(Fitted { weights, offset, of_logarithms: false }))
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
        let (weights, offset) = fit(&faces.map(logarithm), truth)?;
        Ok(Box::new(Fitted { weights, offset, of_logarithms: true }))
    }
}

fn logarithm(feature: f64) -> f64 {
    feature.signum() * feature.abs().ln_1p()
}

/// Returns weights and offset of the exponent.
fn fit(faces: &DMatrix<f64>, truth: &[f64]) -> Result<(DVector<f64>, f64)> {
    let lifted: Vec<f64> = truth.iter().map(|truth| truth.max(0.0) + LIFT).collect();
    let logarithms: Vec<f64> = lifted.iter().map(|truth| truth.ln()).collect();
    let (weights, offset) = Affine::least_squares(faces, &logarithms, RIDGE)?.parts();
    let faces = faces.clone().insert_column(faces.ncols(), 1.0);
    let mut weights = weights.push(offset);
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
    let offset = weights[last];
    Ok((weights.remove_row(last), offset))
}

/// The predictions of an exponent and its residuals.
struct Errors {
    estimates: DVector<f64>,
    residuals: DVector<f64>,
}

fn errors(faces: &DMatrix<f64>, weights: &DVector<f64>, truth: &DVector<f64>) -> Errors {
    let estimates = (faces * weights).map(|exponent| exponent.min(MOST).exp());
    Errors { residuals: truth - &estimates, estimates }
}

/// Returns a damped Gauss-Newton step. The derivative of the exponential is the exponential.
fn step(faces: &DMatrix<f64>, errors: &Errors, damping: f64) -> Result<DVector<f64>> {
    let mut slopes = faces.clone();
    slopes.column_iter_mut().for_each(|mut column| column.component_mul_assign(&errors.estimates));
    let transposed = slopes.transpose();
    solve(&transposed * &slopes, &(transposed * &errors.residuals), damping)
}

impl Predictor for Fitted {
    fn predict(&self, face: &[f64]) -> f64 {
        let sum = if self.of_logarithms {
            self.weights.iter().zip(face).map(|(weight, feature)| weight * logarithm(*feature)).sum()
        } else {
            dot(self.weights.as_slice(), face)
        };
        (self.offset + sum).min(MOST).exp() - LIFT
    }

    fn weights(&self) -> usize {
        self.weights.len()
    }

    fn numbers(&self) -> usize {
        self.weights.len() + 1
    }

    fn needs_scale(&self) -> bool {
        self.of_logarithms
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, largest_error};

    #[test]
    fn the_exponential_of_an_affine_map_is_found_again() {
        let truth = |face: &[f64]| (-0.6 + 0.3 * face[0] - 0.2 * face[1]).exp() - LIFT;
        assert!(largest_error(&Exponential, truth) < 1e-6);
    }

    #[test]
    fn only_logarithms_need_the_scale_of_their_features() {
        let (faces, truth) = faces(50, 3, |face| 0.1 + 0.1 * face[0].abs());
        let needs = |kind: &dyn Kind| kind.fit(&faces, &truth).unwrap().needs_scale();
        assert_eq!([needs(&Exponential), needs(&LogExponential)], [false, true]);
    }

    #[test]
    fn exponential_of_logarithms_is_found_again() {
        let truth = |face: &[f64]| (-0.6 + 0.5 * logarithm(face[0]) - 0.3 * logarithm(face[2])).exp() - LIFT;
        assert!(largest_error(&LogExponential, truth) < 1e-6);
        assert!(largest_error(&Exponential, truth) > 1e-3);
    }
}
