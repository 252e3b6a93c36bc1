//! The kinds of model that the paper compares, one file for each family.
//!
//! A [`Kind`] is fitted to one blendshape. Faces are rows of standardised features (mean 0, deviation 1, as
//! displacements from the wearer's neutral face); the truth is a coefficient of 0 to 1, or what a [`Response`] makes
//! of it. Estimates are not clamped here. The same faces give the same model: whatever is drawn has a fixed seed.

mod ada_boost;
mod affine;
mod exponential;
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
use nalgebra::DMatrix;
use serde::Serialize;

pub use response::{Response, with_response};
pub use support_vectors::SupportVectors;

/// A way to make a model of one blendshape.
pub trait Kind: Sync {
    /// Short name, as it is given on the command line.
    fn name(&self) -> &'static str;

    /// What the fitted model computes.
    fn form(&self) -> Form;

    /// How much of the data it is given.
    fn limits(&self) -> Limits;

    /// Fits the model to `faces` (a row each) and their `truth`.
    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>>;
}

/// A fitted model.
pub trait Predictor: Send + Sync {
    /// The coefficient of a face, from its standardised features.
    fn predict(&self, face: &[f64]) -> f64;

    /// Fitted weights beside the constant: the degrees of freedom of its F statistic.
    fn weights(&self) -> usize;

    /// Numbers it must keep, each of which takes 4 bytes on a board.
    fn numbers(&self) -> usize;

    /// Whether a board must keep mean and deviation of every feature beside them, and apply them to each face. What is
    /// affine or quadratic in the features takes them into its weights, and a tree into its thresholds.
    fn needs_scale(&self) -> bool {
        false
    }
}

/// What a model computes, the simplest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// `w f + b`, whatever it was fitted by.
    Affine,
    /// `exp(w f + b) - c`.
    Exponential,
    /// The same of logarithms of the features.
    LogExponential,
    /// Affine in the features and their products.
    Quadratic,
    /// The hidden layer that all blendshapes share.
    HiddenLayer,
    /// Keeps faces or trees: too large or too slow for a board.
    Large,
}

impl Form {
    /// Whether it is arithmetic that a board does at every frame.
    pub fn runs_on_board(self) -> bool {
        self != Self::Large
    }
}

/// How much of the data a kind is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// So many of the features that explain most.
    pub features: usize,
    /// At most so many faces.
    pub faces: usize,
}

/// For kinds whose cost grows in step with features and faces.
const WIDE: Limits = Limits { features: 64, faces: usize::MAX };
/// For kinds that look at one feature at a time, and again and again.
const MIDDLE: Limits = Limits { features: 24, faces: usize::MAX };
/// For kinds that compare faces with faces, or sort them.
const NARROW: Limits = Limits { features: 24, faces: 2000 };
/// For kinds that solve an equation for each face.
const NARROWEST: Limits = Limits { features: 24, faces: 1000 };

/// All kinds that are fitted to one blendshape at a time, the simplest first.
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
