//! The numbers of the paper's own regression: for each blendshape a formula of a few selected features.
//!
//! A formula is `T(c(w x + b))`. Its features `x` have mean 0 and deviation 1 over the faces of the fit (eq. 4, 5). The
//! curve `c` depends on the kind of the formula, and `T` undoes the transformation of the coefficients that it was
//! fitted to (eq. 6). Faces with and without a known neutral face have formulas of their own.

use serde::{Deserialize, Serialize};

use super::FeatureId;

/// Most features of a formula.
pub const MAX_FORMULA_INPUTS: usize = 64;
/// Most features of a quadratic formula that are multiplied with each other.
pub const MAX_MULTIPLIED: usize = 24;
/// Most products of a quadratic formula.
pub const MAX_PRODUCTS: usize = MAX_MULTIPLIED * (MAX_MULTIPLIED + 1) / 2;

/// The constant that an exponential formula subtracts, because most coefficients are 0. The slopes of the steepest and
/// the flattest part of its curve are in the ratio `(1 + LIFT) / LIFT`.
pub const LIFT: f64 = 0.25;
/// Largest exponent. Coefficients end at 1, so larger exponents have no use.
pub const MAX_EXPONENT: f64 = 1.0;
/// Coefficients are clamped to this distance from 0 and 1, where the logit is infinite.
const EDGE: f64 = 0.02;

/// What a formula computes of its features.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FormulaKind {
    /// `w x + b`.
    #[default]
    Affine,
    /// `exp(w x + b) - 0.25`.
    Exponential,
    /// `exp(w l + b) - 0.25` of the features' [logarithms](signed_logarithm) `l`.
    LogExponential,
    /// `w x + b` of the features and of products of two features.
    Quadratic,
}

impl FormulaKind {
    /// Applies the curve of this kind to `w x + b`.
    pub fn curve(self, sum: f64) -> f64 {
        match self {
            Self::Affine | Self::Quadratic => sum,
            Self::Exponential | Self::LogExponential => sum.min(MAX_EXPONENT).exp() - LIFT,
        }
    }
}

/// The logarithm of a displacement, which has a sign: `sign(x) ln(1 + |x|)`.
pub fn signed_logarithm(feature: f64) -> f64 {
    feature.signum() * feature.abs().ln_1p()
}

/// The transformation of the coefficients before the fit (eq. 6).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Response {
    /// The coefficient itself.
    #[default]
    Plain,
    /// Its square root.
    SquareRoot,
    /// Its logit, `ln(y / (1 - y))`.
    Logit,
}

impl Response {
    /// Transforms a coefficient.
    pub fn transform(self, coefficient: f64) -> f64 {
        match self {
            Self::Plain => coefficient,
            Self::SquareRoot => coefficient.max(0.0).sqrt(),
            Self::Logit => {
                let inside = coefficient.clamp(EDGE, 1.0 - EDGE);
                (inside / (1.0 - inside)).ln()
            }
        }
    }

    /// Returns the coefficient whose transformation is `value`. The logit stretches what lies between its edges to
    /// `0..=1`.
    pub fn restore(self, value: f64) -> f64 {
        match self {
            Self::Plain => value,
            Self::SquareRoot => value.max(0.0).powi(2),
            Self::Logit => ((1.0 / (1.0 + (-value).exp()) - EDGE) / (1.0 - 2.0 * EDGE)).clamp(0.0, 1.0),
        }
    }
}

/// Formulas of all blendshapes. They take at most 256 KiB.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Formulas {
    /// Formulas of displacements from the wearer's neutral face.
    pub neutral_known: FormulaSet,
    /// Formulas of the measures themselves, for wearers whose neutral face is not known.
    pub neutral_unknown: FormulaSet,
}

/// Formulas of all blendshapes with their features.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FormulaSet {
    /// The features that at least one formula selects.
    pub inputs: Box<[ScaledInput]>,
    /// One formula for each blendshape.
    pub formulas: Box<[Formula]>,
}

/// A feature with its scale over the faces of the fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ScaledInput {
    pub feature: FeatureId,
    pub mean: f32,
    /// The inverse of the standard deviation.
    pub per_deviation: f32,
}

/// The formula of a blendshape. The default is always 0.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Formula {
    pub kind: FormulaKind,
    pub response: Response,
    /// `b`.
    pub offset: f32,
    /// Indices into [`FormulaSet::inputs`], at most [`MAX_FORMULA_INPUTS`].
    pub inputs: Box<[u16]>,
    /// `w`, one for each of the inputs.
    pub weights: Box<[f32]>,
    /// How many of the inputs are multiplied with each other. They come first.
    pub multiplied: usize,
    /// Weights of the products: of the first input with itself and all later ones that are multiplied, then of the
    /// second input with itself and all later ones, and so on.
    pub products: Box<[f32]>,
}

/// Index of the product of two of `multiplied` inputs in [`Formula::products`].
pub fn product_index(one: usize, other: usize, multiplied: usize) -> usize {
    let (first, second) = (one.min(other), one.max(other));
    first * multiplied - first * first.saturating_sub(1) / 2 + second - first
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transforming_there_and_back_restores_the_coefficient() {
        for response in [Response::Plain, Response::SquareRoot, Response::Logit] {
            for coefficient in [0.03, 0.3, 0.9] {
                let back = response.restore(response.transform(coefficient));
                let stretched = (coefficient - EDGE) / (1.0 - 2.0 * EDGE);
                let expected = if response == Response::Logit { stretched } else { coefficient };
                assert!((back - expected).abs() < 1e-12, "{response:?} {coefficient}");
            }
        }
        assert!(Response::Logit.restore(Response::Logit.transform(0.0)).abs() < 1e-12);
    }
}
