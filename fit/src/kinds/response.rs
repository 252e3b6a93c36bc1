//! Transformations of the dependent variable (eq. 6 of the paper). A kind is fitted to the transformed truth, and its
//! predictions are transformed back.

use anyhow::Result;
use nalgebra::DMatrix;
use serde::Serialize;

use super::{Form, Kind, Predictor};

/// Coefficients are clamped to this distance from 0 and 1, where the logit is infinite.
const EDGE: f64 = 0.02;

/// A transformation of the truth before the fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Response {
    /// The truth itself.
    Plain,
    /// Its square root.
    SquareRoot,
    /// Its logit, `ln(y / (1 - y))`.
    Logit,
}

impl Response {
    /// Returns the responses to try with a form. Forms that are nonlinear themselves need no transformation.
    pub fn suited_to(form: Form) -> &'static [Self] {
        match form {
            Form::Affine | Form::Quadratic => &[Self::Plain, Self::SquareRoot, Self::Logit],
            Form::Exponential | Form::LogExponential | Form::HiddenLayer | Form::Large => &[Self::Plain],
        }
    }

    fn forward(self, truth: f64) -> f64 {
        match self {
            Self::Plain => truth,
            Self::SquareRoot => truth.max(0.0).sqrt(),
            Self::Logit => {
                let inside = truth.clamp(EDGE, 1.0 - EDGE);
                (inside / (1.0 - inside)).ln()
            }
        }
    }

    fn back(self, estimate: f64) -> f64 {
        match self {
            Self::Plain => estimate,
            Self::SquareRoot => estimate.max(0.0).powi(2),
            Self::Logit => ((1.0 / (1.0 + (-estimate).exp()) - EDGE) / (1.0 - 2.0 * EDGE)).clamp(0.0, 1.0),
        }
    }

    /// Returns what tables append to the name of a kind.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Plain => "",
            Self::SquareRoot => " of sqrt",
            Self::Logit => " of logit",
        }
    }
}

/// Fits a kind to the transformed truth.
pub fn with_response(
    kind: &dyn Kind,
    response: Response,
    faces: &DMatrix<f64>,
    truth: &[f64],
) -> Result<Box<dyn Predictor>> {
    if response == Response::Plain {
        return kind.fit(faces, truth);
    }
    let transformed: Vec<f64> = truth.iter().map(|truth| response.forward(*truth)).collect();
    Ok(Box::new(Transformed { response, inner: kind.fit(faces, &transformed)? }))
}

struct Transformed {
    response: Response,
    inner: Box<dyn Predictor>,
}

impl Predictor for Transformed {
    fn predict(&self, face: &[f64]) -> f64 {
        self.response.back(self.inner.predict(face))
    }

    fn weights(&self) -> usize {
        self.inner.weights()
    }

    fn numbers(&self) -> usize {
        self.inner.numbers()
    }

    fn needs_scale(&self) -> bool {
        self.inner.needs_scale()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::{affine::LeastSquares, test_faces::faces};

    #[test]
    fn transforming_there_and_back_restores_the_truth() {
        for response in [Response::Plain, Response::SquareRoot, Response::Logit] {
            for truth in [0.03, 0.3, 0.9] {
                let back = response.back(response.forward(truth));
                let expected = if response == Response::Logit { (truth - EDGE) / (1.0 - 2.0 * EDGE) } else { truth };
                assert!((back - expected).abs() < 1e-12, "{response:?} {truth}");
            }
        }
        assert!(Response::Logit.back(Response::Logit.forward(0.0)).abs() < 1e-12);
    }

    #[test]
    fn the_square_of_an_affine_map_is_found_by_the_square_root() {
        let (faces, truth) = faces(100, 2, |face| (0.5 + 0.2 * face[0] - 0.1 * face[1]).powi(2));
        let model = with_response(&LeastSquares, Response::SquareRoot, &faces, &truth).unwrap();
        assert!((model.predict(&[0.5, -0.5]) - 0.65_f64.powi(2)).abs() < 1e-7);
    }
}
