//! The kinds of model that the paper compares.
//!
//! A [`Kind`] is fitted to one blendshape. Faces are rows of standardised features: displacements from the wearer's
//! neutral face, with mean 0 and standard deviation 1. The truth is a coefficient from 0 to 1, or its transformation by
//! a [`Response`]. Predictions are not clamped here. Random numbers have fixed seeds, so that the same faces give the
//! same model.

pub mod formula;
pub mod memory;
pub mod trees;

use anyhow::{Context, Result};
use facewire_face::model::{MAX_FORMULA_INPUTS, Response};
use nalgebra::DMatrix;
use serde::Serialize;

pub use formula::Formula;
use formula::{RIDGE, TINY, least_squares};
use memory::Kernel;

pub type Fitted = Box<dyn Predictor>;

#[derive(Clone, Copy)]
pub struct Kind {
    pub name: &'static str,
    pub form: Form,
    pub limits: Limits,
    pub fit: Fit,
}

impl Kind {
    /// Takes fewer features, but at least one, if the formula of all has more than so many bytes.
    pub fn within(mut self, bytes: usize) -> Self {
        let fits = |features: &usize| self.form.formula_bytes(*features).is_none_or(|needed| needed <= bytes);
        self.limits.features = (1..=self.limits.features).rev().find(fits).unwrap_or(1);
        self
    }
}

pub trait Predictor: Send + Sync {
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

/// What a number, and the index of a feature, take on a board.
pub const NUMBER_BYTES: usize = 4;
pub const INDEX_BYTES: usize = 2;

/// The function that a model computes. Simpler forms compare as less.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// `w f + b`, however it was fitted.
    #[default]
    Affine,
    /// `exp(w f + b) - c`.
    Exponential,
    /// `exp(w f + b) - c` of the features' logarithms.
    LogExponential,
    Quadratic,
    /// The hidden layer shared by all blendshapes.
    HiddenLayer,
    /// A model that stores faces or trees, and is too large or too slow for a board.
    Large,
}

impl Form {
    /// Returns the bytes of a formula with so many features, or `None` if the form is no formula.
    fn formula_bytes(self, features: usize) -> Option<usize> {
        let products = if self == Self::Quadratic { formula::products(features) } else { 0 };
        self.is_formula().then(|| NUMBER_BYTES * (1 + features + products) + INDEX_BYTES * features)
    }

    pub fn is_formula(self) -> bool {
        !matches!(self, Self::HiddenLayer | Self::Large)
    }

    /// Returns the transformations of the truth to try. Forms that are nonlinear themselves need none.
    pub fn responses(self) -> &'static [Response] {
        match self {
            Self::Affine | Self::Quadratic => &[Response::Plain, Response::SquareRoot, Response::Logit],
            _ => &[Response::Plain],
        }
    }
}

/// Limits on the number of features, the best first, and of faces that a kind is fitted to.
#[derive(Clone, Copy)]
pub struct Limits {
    pub features: usize,
    pub faces: usize,
}

/// Limits of kinds whose cost is linear in the number of faces; that pass over the features many times; that compare all
/// faces with each other, or sort them; and that solve a system of equations with one unknown per face.
const WIDE: Limits = Limits { features: MAX_FORMULA_INPUTS, faces: usize::MAX };
const MIDDLE: Limits = Limits { features: 24, faces: usize::MAX };
const NARROW: Limits = Limits { features: 24, faces: 2000 };
const NARROWEST: Limits = Limits { features: 24, faces: 1000 };

type Fit = fn(&DMatrix<f64>, &[f64]) -> Result<Fitted>;

pub const fn kind(name: &'static str, form: Form, limits: Limits, fit: Fit) -> Kind {
    Kind { name, form, limits, fit }
}

pub const ALL: [Kind; 15] = [
    kind("ols", Form::Affine, WIDE, |f, t| Ok(Box::new(least_squares(f, t, TINY)?))),
    kind("ridge", Form::Affine, WIDE, |f, t| Ok(Box::new(least_squares(f, t, RIDGE)?))),
    kind("pca", Form::Affine, WIDE, formula::principal_components),
    kind("pls", Form::Affine, WIDE, formula::partial_least_squares),
    kind("exp", Form::Exponential, WIDE, formula::exponential),
    kind("log-exp", Form::LogExponential, WIDE, formula::log_exponential),
    kind("poly", Form::Quadratic, WIDE, formula::quadratic),
    kind("gp-rbf", Form::Large, NARROWEST, |f, t| memory::gaussian_process(Kernel::Rbf, f, t)),
    kind("gp-matern", Form::Large, NARROWEST, |f, t| memory::gaussian_process(Kernel::Matern, f, t)),
    kind("svr-rbf", Form::Large, NARROW, support_vectors),
    kind("svr-poly", Form::Large, NARROW, |f, t| memory::support_vectors(Kernel::Polynomial, f, t)),
    kind("hist-gb", Form::Large, MIDDLE, trees::histogram_boosting),
    kind("gb", Form::Large, NARROW, trees::gradient_boosting),
    kind("ada", Form::Large, NARROW, trees::ada_boost),
    kind("knn", Form::Large, NARROW, memory::neighbours),
];

pub fn support_vectors(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    memory::support_vectors(Kernel::Rbf, faces, truth)
}

pub fn suffix(response: Response) -> &'static str {
    match response {
        Response::Plain => "",
        Response::SquareRoot => " of sqrt",
        Response::Logit => " of logit",
    }
}

/// Fits a kind to the transformed truth (eq. 6 of the paper). Predictions are transformed back.
pub fn with_response(kind: &Kind, response: Response, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    if response == Response::Plain {
        return (kind.fit)(faces, truth);
    }
    let transformed: Vec<f64> = truth.iter().map(|truth| response.transform(*truth)).collect();
    let fitted = (kind.fit)(faces, &transformed)?.formula();
    let formula = fitted.with_context(|| format!("{} is no formula, so its truth cannot be transformed", kind.name))?;
    Ok(Box::new(Formula { response, ..formula }))
}
