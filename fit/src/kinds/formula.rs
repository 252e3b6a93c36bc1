//! The kinds that the board can run: formulas of model files, fitted by least squares.

use anyhow::{Context, Result, ensure};
use facewire_face::model::{
    FormulaKind, LIFT, MAX_EXPONENT, MAX_MULTIPLIED, Response, product_index, signed_logarithm,
};
use nalgebra::{DMatrix, DVector};

use super::{Fitted, Predictor};

/// Ridge penalty, relative to the mean variance, and the initial damping of the steps to an exponential.
pub const RIDGE: f64 = 0.001;
/// The penalty that keeps ordinary least squares solvable if features repeat each other.
pub const TINY: f64 = 1e-9;
const KEPT: f64 = 0.999;
const COMPONENTS: usize = 16;
/// Smallest length of a new direction relative to the first, before it counts as rounding noise.
const LEAST_LENGTH: f64 = 1e-9;
/// Steps of the fit of an exponential, and factors of the damping after a better and after a worse step.
const STEPS: usize = 12;
const EASE: f64 = 0.3;
const STRAIN: f64 = 5.0;

#[derive(Debug, Clone, PartialEq)]
pub struct Formula {
    pub kind: FormulaKind,
    pub response: Response,
    pub offset: f64,
    pub weights: Vec<f64>,
    /// Weights of the products of the first features, at the places of [`product_index`]. Only quadratic formulas have them.
    pub products: Vec<f64>,
    pub degrees_of_freedom: usize,
}

/// Returns how many of the features are multiplied: the first of them, because all 64 would give 2,080 products.
fn multiplied(features: usize) -> usize {
    features.min(MAX_MULTIPLIED)
}

/// Returns the number of products of so many features.
pub fn products(features: usize) -> usize {
    let multiplied = multiplied(features);
    multiplied * (multiplied + 1) / 2
}

impl Formula {
    fn affine(weights: Vec<f64>, offset: f64) -> Self {
        let degrees_of_freedom = weights.len();
        let (kind, response, products) = (FormulaKind::Affine, Response::Plain, Vec::new());
        Self { kind, response, offset, weights, products, degrees_of_freedom }
    }

    pub fn pairs(&self) -> impl Iterator<Item = ([usize; 2], f64)> {
        let multiplied = if self.products.is_empty() { 0 } else { multiplied(self.weights.len()) };
        let pairs = (0..multiplied).flat_map(move |one| (one..multiplied).map(move |other| [one, other]));
        pairs.map(move |pair| (pair, self.products[product_index(pair[0], pair[1], multiplied)]))
    }

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

pub fn dot<'a>(weights: impl IntoIterator<Item = &'a f64>, values: &[f64]) -> f64 {
    weights.into_iter().zip(values).map(|(weight, value)| weight * value).sum()
}

pub fn least_squares(faces: &DMatrix<f64>, truth: &[f64], ridge: f64) -> Result<Formula> {
    let (faces, truth, centre) = centred(faces, truth);
    let transposed = faces.transpose();
    Ok(centre.affine(&solve(&transposed * faces, &(transposed * truth), ridge)?))
}

fn solve(mut gram: DMatrix<f64>, cross: &DVector<f64>, ridge: f64) -> Result<DVector<f64>> {
    let penalty = ridge * gram.diagonal().mean();
    (0..gram.nrows()).for_each(|index| gram[(index, index)] += penalty);
    Ok(gram.cholesky().context("no feature varies in these faces")?.solve(cross))
}

struct Centre {
    face: DVector<f64>,
    truth: f64,
}

impl Centre {
    fn affine(&self, weights: &DVector<f64>) -> Formula {
        Formula::affine(weights.as_slice().to_vec(), self.truth - weights.dot(&self.face))
    }
}

fn centred(faces: &DMatrix<f64>, truth: &[f64]) -> (DMatrix<f64>, DVector<f64>, Centre) {
    let mut truth = DVector::from_column_slice(truth);
    let centre = Centre { face: faces.row_mean().transpose(), truth: truth.mean() };
    let mut faces = faces.clone();
    faces.column_iter_mut().zip(&centre.face).for_each(|(mut column, mean)| column.add_scalar_mut(-mean));
    truth.add_scalar_mut(-centre.truth);
    (faces, truth, centre)
}

pub fn principal_components(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    let (faces, truth, centre) = centred(faces, truth);
    let transposed = faces.transpose();
    let cross = &transposed * truth;
    let decomposed = (transposed * faces).svd(true, false);
    let directions = decomposed.u.context("the features have no components")?;
    let variances = decomposed.singular_values.as_slice();
    let enough = KEPT * variances.iter().sum::<f64>();
    let mut sum = 0.0;
    let last = variances.iter().position(|variance| {
        sum += variance;
        sum >= enough
    });
    let kept = last.map_or(variances.len(), |last| last + 1);
    let directions = directions.columns(0, kept).into_owned();
    let mut scores = directions.tr_mul(&cross);
    scores.component_div_assign(&decomposed.singular_values.rows(0, kept));
    Ok(Box::new(Formula { degrees_of_freedom: kept, ..centre.affine(&(directions * scores)) }))
}

/// Partial least squares of one dependent variable (PLS1; Wold, Sjöström and Eriksson, 2001): least squares on a few
/// directions with large covariance with the truth.
pub fn partial_least_squares(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    let (faces, truth, centre) = centred(faces, truth);
    let transposed = faces.transpose();
    let (gram, cross) = (&transposed * &faces, transposed * truth);
    let directions = directions(&gram, &cross);
    ensure!(directions.ncols() > 0, "no feature varies with the truth");
    let reduced = directions.transpose() * &gram * &directions;
    let scores = solve(reduced, &directions.tr_mul(&cross), 0.0)?;
    Ok(Box::new(Formula { degrees_of_freedom: directions.ncols(), ..centre.affine(&(&directions * scores)) }))
}

/// Returns an orthonormal basis of the Krylov space of `gram` and `cross`, which the weights of the components span
/// (Helland, 1988). Orthogonalises twice for numerical stability.
fn directions(gram: &DMatrix<f64>, cross: &DVector<f64>) -> DMatrix<f64> {
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let (mut next, mut least) = (cross.clone(), 0.0);
    while basis.len() < COMPONENTS.min(cross.len()) {
        for known in basis.iter().chain(&basis) {
            next -= known * known.dot(&next);
        }
        let length = next.norm();
        if length <= least {
            break;
        }
        let direction = &next / length;
        next = gram * &direction;
        least = LEAST_LENGTH * next.norm();
        basis.push(direction);
    }
    DMatrix::from_fn(cross.len(), basis.len(), |row, column| basis[column][row])
}

/// Exponential regression, `y = exp(w f + b) - c`. The paper names it without an equation. Here the logarithm of the
/// coefficient is linear in the features; `c` ([`LIFT`]) is needed because most coefficients are 0.
pub fn exponential(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    Ok(Box::new(Formula { kind: FormulaKind::Exponential, ..exponent(faces, truth)? }))
}

/// The same of `sign(f) ln(1 + |f|)`, because displacements have signs.
pub fn log_exponential(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    let fitted = exponent(&faces.map(signed_logarithm), truth)?;
    Ok(Box::new(Formula { kind: FormulaKind::LogExponential, ..fitted }))
}

/// Fits the exponent. Least squares on the logarithm would weigh errors near 0 most, so it is only the start of a
/// Levenberg-Marquardt fit of the coefficient itself.
fn exponent(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Formula> {
    let lifted: Vec<f64> = truth.iter().map(|truth| truth.max(0.0) + LIFT).collect();
    let logarithms: Vec<f64> = lifted.iter().map(|truth| truth.ln()).collect();
    let start = least_squares(faces, &logarithms, RIDGE)?;
    let faces = faces.clone().insert_column(faces.ncols(), 1.0);
    let mut weights = DVector::from_vec(start.weights).push(start.offset);
    let truth = DVector::from_vec(lifted);
    let estimate = |weights: &DVector<f64>| {
        let estimates = (&faces * weights).map(|exponent| exponent.min(MAX_EXPONENT).exp());
        (&truth - &estimates, estimates)
    };
    let ((mut residuals, mut estimates), mut damping) = (estimate(&weights), RIDGE);
    for _ in 0..STEPS {
        // A damped Gauss-Newton step. The derivative of the exponential is the exponential.
        let mut slopes = faces.clone();
        slopes.column_iter_mut().for_each(|mut column| column.component_mul_assign(&estimates));
        let transposed = slopes.transpose();
        let next = &weights + solve(&transposed * &slopes, &(transposed * &residuals), damping)?;
        let (next_residuals, next_estimates) = estimate(&next);
        if next_residuals.norm_squared() < residuals.norm_squared() {
            (weights, residuals, estimates, damping) = (next, next_residuals, next_estimates, damping * EASE);
        } else {
            damping *= STRAIN;
        }
    }
    let last = weights.len() - 1;
    Ok(Formula::affine(weights.as_slice()[..last].to_vec(), weights[last]))
}

/// Ridge regression on the features, and on the squares and products of the first of them, in order.
pub fn quadratic(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    let (features, multiplied) = (faces.ncols(), multiplied(faces.ncols()));
    let pairs: Vec<_> = (0..multiplied).flat_map(|one| (one..multiplied).map(move |other| (one, other))).collect();
    let mut all = faces.clone().resize_horizontally(features + pairs.len(), 0.0);
    for (index, (one, other)) in pairs.into_iter().enumerate() {
        all.set_column(features + index, &faces.column(one).component_mul(&faces.column(other)));
    }
    let mut fitted = least_squares(&all, truth, RIDGE)?;
    let products = fitted.weights.split_off(features);
    Ok(Box::new(Formula { kind: FormulaKind::Quadratic, products, ..fitted }))
}
