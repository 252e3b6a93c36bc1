//! The models that the board can run: formulas of model files.

use facewire::solve::{FormulaKind, MAX_MULTIPLIED, Response, product_index, signed_logarithm};

use super::Predictor;

/// A formula of standardised features.
#[derive(Debug, Clone, PartialEq)]
pub struct Formula {
    /// What it computes.
    pub kind: FormulaKind,
    /// The transformation of the truth that it was fitted to.
    pub response: Response,
    /// The constant.
    pub offset: f64,
    /// Weights of the features.
    pub weights: Vec<f64>,
    /// Weights of the products of the first features, at the places of [`product_index`]. Only quadratic formulas have them.
    pub products: Vec<f64>,
    /// The number of fitted weights, without the constant.
    pub degrees_of_freedom: usize,
}

/// Returns how many of the features of a quadratic formula are multiplied with each other: the first of them, because all
/// 64 would give 2,080 products.
pub fn multiplied(features: usize) -> usize {
    features.min(MAX_MULTIPLIED)
}

impl Formula {
    /// Returns an affine map of the features.
    pub fn affine(weights: Vec<f64>, offset: f64) -> Self {
        let degrees_of_freedom = weights.len();
        let (kind, response, products) = (FormulaKind::Affine, Response::Plain, Vec::new());
        Self { kind, response, offset, weights, products, degrees_of_freedom }
    }

    /// Returns every product with both of its features.
    pub fn pairs(&self) -> impl Iterator<Item = ([usize; 2], f64)> {
        let multiplied = if self.products.is_empty() { 0 } else { multiplied(self.weights.len()) };
        let pairs = (0..multiplied).flat_map(move |one| (one..multiplied).map(move |other| [one, other]));
        pairs.map(move |pair| (pair, self.products[product_index(pair[0], pair[1], multiplied)]))
    }
}

impl Predictor for Formula {
    fn predict(&self, face: &[f64]) -> f64 {
        let linear: f64 = if self.kind == FormulaKind::LogExponential {
            self.weights.iter().zip(face).map(|(weight, feature)| weight * signed_logarithm(*feature)).sum()
        } else {
            dot(&self.weights, face)
        };
        self.response.restore(self.kind.curve(self.offset + linear + self.product_sum(face)))
    }

    fn weights(&self) -> usize {
        self.degrees_of_freedom
    }

    fn numbers(&self) -> usize {
        self.weights.len() + self.products.len() + 1
    }

    fn formula(&self) -> Option<Self> {
        Some(self.clone())
    }
}

impl Formula {
    fn product_sum(&self, face: &[f64]) -> f64 {
        let mut products = self.products.as_slice();
        let mut sum = 0.0;
        let multiplied = &face[..multiplied(face.len())];
        for (index, value) in multiplied.iter().enumerate() {
            let Some((own, rest)) = products.split_at_checked(multiplied.len() - index) else { break };
            sum += value * dot(own, &multiplied[index..]);
            products = rest;
        }
        sum
    }
}

/// Returns the dot product.
pub fn dot<'a>(weights: impl IntoIterator<Item = &'a f64>, values: &[f64]) -> f64 {
    weights.into_iter().zip(values).map(|(weight, value)| weight * value).sum()
}
