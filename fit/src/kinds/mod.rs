//! The kinds of model that the paper compares, with one file per family.
//!
//! A [`Kind`] is fitted to one blendshape. Faces are rows of standardised features: displacements from the wearer's
//! neutral face, with mean 0 and standard deviation 1. The truth is a coefficient from 0 to 1, or its transformation by
//! a [`Response`](facewire::solve::Response). Predictions are not clamped here. Random numbers have fixed seeds, so that the same faces give the
//! same model.

mod ada_boost;
mod affine;
mod exponential;
mod formula;
mod gaussian_process;
mod gradient_boosting;
mod histogram_boosting;
mod neighbours;
mod partial_least_squares;
mod principal_components;
mod quadratic;
#[cfg(test)]
mod reference_values;
mod response;
mod support_vectors;
#[cfg(test)]
mod test_faces;

use anyhow::Result;
use facewire::solve::MAX_FORMULA_INPUTS;
use nalgebra::DMatrix;
use serde::Serialize;

pub use formula::Formula;
pub use response::{suffix, suited_to, with_response};
pub use support_vectors::SupportVectors;

/// A method to fit a model of one blendshape.
pub trait Kind: Sync {
    /// Returns the short name, as used on the command line.
    fn name(&self) -> &'static str;

    /// Returns the form of the fitted model.
    fn form(&self) -> Form;

    /// Returns the limits on the data that this kind is fitted to.
    fn limits(&self) -> Limits;

    /// Fits the model to `faces`, one row per face, and their `truth`.
    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>>;
}

/// A fitted model.
pub trait Predictor: Send + Sync {
    /// Predicts the coefficient of a face from its standardised features.
    fn predict(&self, face: &[f64]) -> f64;

    /// Returns the number of fitted weights without the constant: the degrees of freedom of the F statistic.
    fn weights(&self) -> usize;

    /// Returns the number of values that a board has to store. Each takes 4 bytes.
    fn numbers(&self) -> usize;

    /// Returns the formula of the board that computes the same, or `None` if there is none.
    fn formula(&self) -> Option<Formula> {
        None
    }
}

/// The function that a model computes. Simpler forms compare as less.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// `w f + b`, however it was fitted.
    Affine,
    /// `exp(w f + b) - c`.
    Exponential,
    /// `exp(w f + b) - c` of the features' logarithms.
    LogExponential,
    /// An affine map of the features and their products.
    Quadratic,
    /// The hidden layer shared by all blendshapes.
    HiddenLayer,
    /// A model that stores faces or trees, and is too large or too slow for a board.
    Large,
}

impl Form {
    /// Returns whether model files can hold the model as a formula.
    pub fn is_formula(self) -> bool {
        !matches!(self, Self::HiddenLayer | Self::Large)
    }

    /// Returns whether a board can compute the model in every frame.
    pub fn runs_on_board(self) -> bool {
        self != Self::Large
    }
}

/// Limits on the data that a kind is fitted to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Number of features, the best first.
    pub features: usize,
    /// Largest number of faces.
    pub faces: usize,
}

/// Limits of kinds whose cost is linear in the number of faces.
const WIDE: Limits = Limits { features: MAX_FORMULA_INPUTS, faces: usize::MAX };
/// Limits of kinds that pass over the features many times.
const MIDDLE: Limits = Limits { features: 24, faces: usize::MAX };
/// Limits of kinds that compare all faces with each other, or sort them.
const NARROW: Limits = Limits { features: 24, faces: 2000 };
/// Limits of kinds that solve a system of equations with one unknown per face.
const NARROWEST: Limits = Limits { features: 24, faces: 1000 };

/// Returns all kinds that are fitted to one blendshape at a time, the simplest first.
pub fn all() -> Vec<Box<dyn Kind>> {
    vec![
        Box::new(affine::LeastSquares),
        Box::new(affine::Ridge),
        Box::new(principal_components::PrincipalComponents),
        Box::new(partial_least_squares::PartialLeastSquares),
        Box::new(exponential::Exponential),
        Box::new(exponential::LogExponential),
        Box::new(quadratic::Quadratic),
        Box::new(gaussian_process::GaussianProcess::Rbf),
        Box::new(gaussian_process::GaussianProcess::Matern),
        Box::new(support_vectors::SupportVectors::Rbf),
        Box::new(support_vectors::SupportVectors::Polynomial),
        Box::new(histogram_boosting::HistogramBoosting),
        Box::new(gradient_boosting::GradientBoosting),
        Box::new(ada_boost::AdaBoost),
        Box::new(neighbours::Neighbours),
    ]
}
