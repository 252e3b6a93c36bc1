//! Gaussian process regression (Rasmussen and Williams, 2006, algorithm 2.1).
//!
//! Length scale and noise are chosen from a grid by their marginal likelihood on some of the faces. The signal variance
//! is the most likely one for each of them (their equation 5.8).

use anyhow::{Context, Result};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::{Form, Kind, Limits, NARROWEST, Predictor};

/// Length scales to try, relative to the root of the number of features, and noise variances, relative to the signal's.
const LENGTHS: [f64; 4] = [0.7, 1.4, 2.8, 5.6];
const NOISES: [f64; 4] = [0.003, 0.03, 0.15, 0.6];
/// Number of faces for choosing length scale and noise.
const SELECTION_FACES: usize = 300;

/// A Gaussian process with one of two kernels.
#[derive(Clone, Copy)]
pub enum GaussianProcess {
    /// The squared exponential kernel, `exp(-d2 / 2)`.
    Rbf,
    /// The Matérn kernel with parameter 5/2, which is twice differentiable.
    Matern,
}

struct Fitted {
    kernel: GaussianProcess,
    length: f64,
    /// One column per face.
    faces: DMatrix<f64>,
    weights: DVector<f64>,
    mean: f64,
}

impl Kind for GaussianProcess {
    fn name(&self) -> &'static str {
        match self {
            Self::Rbf => "gp-rbf",
            Self::Matern => "gp-matern",
        }
    }

    fn form(&self) -> Form {
        Form::Large
    }

    fn limits(&self) -> Limits {
        NARROWEST
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        let mut truth = DVector::from_column_slice(truth);
        let mean = truth.mean();
        truth.add_scalar_mut(-mean);
        let squares = squared_distances(faces);
        let (length, noise) = self.choose(&squares, &truth, (faces.ncols() as f64).sqrt());
        let decomposed = self.decompose(&squares, length, noise).context("the faces repeat each other")?;
        let weights = decomposed.solve(&truth);
        Ok(Box::new(Fitted { kernel: *self, length, faces: faces.transpose(), weights, mean }))
    }
}

impl GaussianProcess {
    /// Returns the covariance of two faces from their squared distance in units of the length scale.
    fn covariance(self, squared: f64) -> f64 {
        match self {
            Self::Rbf => (-squared / 2.0).exp(),
            Self::Matern => {
                let distance = (5.0 * squared).sqrt();
                (1.0 + distance + distance * distance / 3.0) * (-distance).exp()
            }
        }
    }

    fn decompose(self, squares: &DMatrix<f64>, length: f64, noise: f64) -> Option<Cholesky<f64, Dyn>> {
        let mut covariance = squares.map(|squared| self.covariance(squared / (length * length)));
        (0..squares.nrows()).for_each(|index| covariance[(index, index)] += noise);
        covariance.cholesky()
    }

    /// Returns the length scale and noise with the highest likelihood on the first faces.
    fn choose(self, squares: &DMatrix<f64>, truth: &DVector<f64>, unit: f64) -> (f64, f64) {
        let count = truth.len().min(SELECTION_FACES);
        let squares = squares.view((0, 0), (count, count)).into_owned();
        let truth = truth.rows(0, count).into_owned();
        let all = LENGTHS.iter().flat_map(|length| NOISES.map(|noise| (length * unit, noise)));
        let likelihood = |(length, noise)| self.log_likelihood(&squares, &truth, length, noise);
        let best = all.max_by(|a, b| likelihood(*a).total_cmp(&likelihood(*b)));
        best.unwrap_or((unit, NOISES[0]))
    }

    fn log_likelihood(self, squares: &DMatrix<f64>, truth: &DVector<f64>, length: f64, noise: f64) -> f64 {
        let Some(decomposed) = self.decompose(squares, length, noise) else { return f64::NEG_INFINITY };
        let variance = truth.dot(&decomposed.solve(truth)) / truth.len() as f64;
        let half_log_determinant: f64 = decomposed.l_dirty().diagonal().iter().map(|value| value.ln()).sum();
        -0.5 * truth.len() as f64 * variance.max(f64::MIN_POSITIVE).ln() - half_log_determinant
    }
}

/// Returns the squared distances between all pairs of rows.
pub fn squared_distances(faces: &DMatrix<f64>) -> DMatrix<f64> {
    let products = faces * faces.transpose();
    DMatrix::from_fn(faces.nrows(), faces.nrows(), |one, other| {
        (products[(one, one)] + products[(other, other)] - 2.0 * products[(one, other)]).max(0.0)
    })
}

/// Returns the squared distance between two faces.
pub fn squared_distance<'a>(one: impl IntoIterator<Item = &'a f64>, other: &[f64]) -> f64 {
    one.into_iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum()
}

impl Predictor for Fitted {
    fn predict(&self, face: &[f64]) -> f64 {
        let scale = self.length * self.length;
        let kept = self.faces.column_iter().zip(&self.weights);
        let covariance = |(other, weight): (nalgebra::DVectorView<f64>, &f64)| {
            weight * self.kernel.covariance(squared_distance(other.iter(), face) / scale)
        };
        self.mean + kept.map(covariance).sum::<f64>()
    }

    fn weights(&self) -> usize {
        self.weights.len()
    }

    fn numbers(&self) -> usize {
        self.faces.len() + self.weights.len() + 2
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::unexplained;

    #[test]
    fn a_smooth_function_is_found_between_the_faces() {
        let truth = |face: &[f64]| (2.0 * face[0]).sin() * face[1];
        assert!(unexplained(&GaussianProcess::Rbf, 200, truth) < 0.01);
        assert!(unexplained(&GaussianProcess::Matern, 200, truth) < 0.02);
    }

    #[test]
    fn far_from_all_faces_the_prediction_is_the_mean() {
        let faces = DMatrix::from_column_slice(3, 1, &[0.0, 1.0, 2.0]);
        let model = GaussianProcess::Rbf.fit(&faces, &[0.1, 0.2, 0.6]).unwrap();
        assert!((model.predict(&[100.0]) - 0.3).abs() < 1e-12);
    }
}
