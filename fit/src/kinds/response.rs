//! Transformations of the dependent variable (eq. 6 of the paper). A kind is fitted to the transformed truth, and its
//! predictions are transformed back.

use anyhow::{Context, Result};
use facewire::solve::Response;
use nalgebra::DMatrix;

use super::{Form, Kind, Predictor, formula::Formula};

/// Returns the responses to try with a form. Forms that are nonlinear themselves need no transformation.
pub fn suited_to(form: Form) -> &'static [Response] {
    match form {
        Form::Affine | Form::Quadratic => &[Response::Plain, Response::SquareRoot, Response::Logit],
        Form::Exponential | Form::LogExponential | Form::HiddenLayer | Form::Large => &[Response::Plain],
    }
}

/// Returns what tables append to the name of a kind.
pub fn suffix(response: Response) -> &'static str {
    match response {
        Response::Plain => "",
        Response::SquareRoot => " of sqrt",
        Response::Logit => " of logit",
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
    let transformed: Vec<f64> = truth.iter().map(|truth| response.transform(*truth)).collect();
    let fitted = kind.fit(faces, &transformed)?.formula();
    let formula =
        fitted.with_context(|| format!("{} is no formula, so its truth cannot be transformed", kind.name()))?;
    Ok(Box::new(Formula { response, ..formula }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::{affine::LeastSquares, test_faces::faces};

    #[test]
    fn the_square_of_an_affine_map_is_found_by_the_square_root() {
        let (faces, truth) = faces(100, 2, |face| (0.5 + 0.2 * face[0] - 0.1 * face[1]).powi(2));
        let model = with_response(&LeastSquares, Response::SquareRoot, &faces, &truth).unwrap();
        assert!((model.predict(&[0.5, -0.5]) - 0.65_f64.powi(2)).abs() < 1e-7);
    }
}
