//! Kinds that keep the faces that they were fitted to: Gaussian processes, support vectors, and nearest neighbours.

use anyhow::{Context, Result};
use nalgebra::{Cholesky, DMatrix, DVector, DVectorView, Dyn};

use super::{Fitted, Predictor, formula::dot};

/// Length scales to try, relative to the root of the number of features, and noise variances, relative to the signal's.
const LENGTHS: [f64; 4] = [0.7, 1.4, 2.8, 5.6];
const NOISES: [f64; 4] = [0.003, 0.03, 0.15, 0.6];
const SELECTION_FACES: usize = 300;
/// Errors of support vectors up to this size cost nothing (epsilon).
const ZONE: f64 = 0.05;
/// Largest multiplier (the cost C).
const MOST: f64 = 1.0;
/// Largest number of passes over the faces, and the largest change of a multiplier in a pass that counts as converged.
const PASSES: usize = 200;
const CONVERGED: f64 = 1e-4;
/// Number of neighbours, each weighted by the inverse of its distance.
const NEIGHBOURS: usize = 8;
/// Squared distance below which two faces count as the same.
const SAME: f64 = 1e-18;

#[derive(Clone, Copy, PartialEq)]
pub enum Kernel {
    /// The squared exponential, `exp(-d2 / 2)`.
    Rbf,
    /// The Matérn kernel with parameter 5/2, which is twice differentiable.
    Matern,
    /// `(f g / n + 1)^3` with n features.
    Polynomial,
}

/// The sum of the likenesses to the kept faces, each with a weight.
struct Likeness {
    likeness: Box<dyn Fn(DVectorView<f64>, &[f64]) -> f64 + Send + Sync>,
    faces: DMatrix<f64>,
    weights: Vec<f64>,
    mean: f64,
    constants: usize,
}

impl Predictor for Likeness {
    fn predict(&self, face: &[f64]) -> f64 {
        let kept = self.faces.column_iter().zip(&self.weights);
        self.mean + kept.map(|(other, weight)| weight * (self.likeness)(other, face)).sum::<f64>()
    }

    fn weights(&self) -> usize {
        self.weights.len()
    }

    fn numbers(&self) -> usize {
        self.faces.len() + self.weights.len() + self.constants
    }
}

fn squared_distances(faces: &DMatrix<f64>) -> DMatrix<f64> {
    let products = faces * faces.transpose();
    DMatrix::from_fn(faces.nrows(), faces.nrows(), |one, other| {
        (products[(one, one)] + products[(other, other)] - 2.0 * products[(one, other)]).max(0.0)
    })
}

fn squared_distance(one: DVectorView<f64>, other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum()
}

/// Gaussian process regression (Rasmussen and Williams, 2006, algorithm 2.1). Length scale and noise are chosen from a
/// grid by their marginal likelihood on some of the faces. The signal variance is the most likely one for each of them
/// (their equation 5.8).
pub struct GaussianProcess {
    kernel: Kernel,
    faces: DMatrix<f64>,
    decomposed: Cholesky<f64, Dyn>,
    weights: DVector<f64>,
    mean: f64,
    length: f64,
    noise: f64,
    variance: f64,
}

impl GaussianProcess {
    pub fn fit(kernel: Kernel, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Self> {
        let mut truth = DVector::from_column_slice(truth);
        let mean = truth.mean();
        truth.add_scalar_mut(-mean);
        let squares = squared_distances(faces);
        let (length, noise) = kernel.choose(&squares, &truth, (faces.ncols() as f64).sqrt());
        let decomposed = kernel.decompose(&squares, length, noise).context("the faces repeat each other")?;
        let weights = decomposed.solve(&truth);
        let variance = truth.dot(&weights) / truth.len() as f64;
        Ok(Self { kernel, faces: faces.transpose(), decomposed, weights, mean, length, noise, variance })
    }

    /// Returns the mean of what a face may show, and its standard deviation with the noise of a single picture.
    pub fn distribution(&self, face: &[f64]) -> [f64; 2] {
        let likeness = |other: DVectorView<f64>| self.likeness(other, face);
        let likenesses = DVector::from_iterator(self.weights.len(), self.faces.column_iter().map(likeness));
        let explained = likenesses.dot(&self.decomposed.solve(&likenesses));
        let variance = self.variance * (1.0 + self.noise - explained).max(0.0);
        [self.mean + likenesses.dot(&self.weights), variance.sqrt()]
    }

    fn likeness(&self, other: DVectorView<f64>, face: &[f64]) -> f64 {
        self.kernel.covariance(squared_distance(other, face) / (self.length * self.length))
    }
}

impl Predictor for GaussianProcess {
    fn predict(&self, face: &[f64]) -> f64 {
        let kept = self.faces.column_iter().zip(&self.weights);
        self.mean + kept.map(|(other, weight)| weight * self.likeness(other, face)).sum::<f64>()
    }

    fn weights(&self) -> usize {
        self.weights.len()
    }

    fn numbers(&self) -> usize {
        self.faces.len() + self.weights.len() + 2
    }
}

pub fn gaussian_process(kernel: Kernel, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    Ok(Box::new(GaussianProcess::fit(kernel, faces, truth)?))
}

impl Kernel {
    fn covariance(self, squared: f64) -> f64 {
        if self == Self::Matern {
            let distance = (5.0 * squared).sqrt();
            (1.0 + distance + distance * distance / 3.0) * (-distance).exp()
        } else {
            (-squared / 2.0).exp()
        }
    }

    fn decompose(self, squares: &DMatrix<f64>, length: f64, noise: f64) -> Option<Cholesky<f64, Dyn>> {
        let mut covariance = squares.map(|squared| self.covariance(squared / (length * length)));
        (0..squares.nrows()).for_each(|index| covariance[(index, index)] += noise);
        covariance.cholesky()
    }

    fn choose(self, squares: &DMatrix<f64>, truth: &DVector<f64>, unit: f64) -> (f64, f64) {
        let count = truth.len().min(SELECTION_FACES);
        let squares = squares.view((0, 0), (count, count)).into_owned();
        let truth = truth.rows(0, count).into_owned();
        let all = LENGTHS.iter().flat_map(|length| NOISES.map(|noise| (length * unit, noise)));
        let likelihood = |(length, noise)| {
            let Some(decomposed) = self.decompose(&squares, length, noise) else { return f64::NEG_INFINITY };
            let variance = truth.dot(&decomposed.solve(&truth)) / truth.len() as f64;
            let half_log_determinant: f64 = decomposed.l_dirty().diagonal().iter().map(|value| value.ln()).sum();
            -0.5 * truth.len() as f64 * variance.max(f64::MIN_POSITIVE).ln() - half_log_determinant
        };
        let best = all.max_by(|a, b| likelihood(*a).total_cmp(&likelihood(*b)));
        best.unwrap_or((unit, NOISES[0]))
    }
}

/// Support vector regression with an epsilon-insensitive loss. Kernels are scaled as by scikit-learn's default.
///
/// The offset is a feature that is 1 in every face, and so is part of the penalty. The dual problem then has no equality
/// constraint and is solved by coordinate descent (Hsieh et al., 2008). `smartcore` has the usual form, but uses a wrong
/// diagonal with the polynomial kernel, and its model borrows its parameters.
pub fn support_vectors(kernel: Kernel, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    let features = faces.ncols() as f64;
    // An added 1 stands for the offset.
    let rbf = move |squared: f64| (-squared / features).exp() + 1.0;
    let polynomial = move |product: f64| (product / features + 1.0).powi(3) + 1.0;
    let matrix = match kernel {
        Kernel::Polynomial => (faces * faces.transpose()).map(polynomial),
        _ => squared_distances(faces).map(rbf),
    };
    let mean = DVector::from_column_slice(truth).mean();
    let multipliers = multipliers(&matrix, &truth.iter().map(|truth| truth - mean).collect::<Vec<_>>());
    let kept: Vec<usize> = (0..truth.len()).filter(|row| multipliers[*row] != 0.0).collect();
    let likeness = move |other: DVectorView<f64>, face: &[f64]| match kernel {
        Kernel::Polynomial => polynomial(dot(other.iter(), face)),
        _ => rbf(squared_distance(other, face)),
    };
    let faces = faces.select_rows(&kept).transpose();
    let weights = kept.iter().map(|row| multipliers[*row]).collect();
    Ok(Box::new(Likeness { likeness: Box::new(likeness), faces, weights, mean, constants: 1 }))
}

/// Solves the dual: minimises `m' K m / 2 - y' m + zone |m|` with each multiplier within [`MOST`] of 0.
fn multipliers(kernel: &DMatrix<f64>, truth: &[f64]) -> Vec<f64> {
    let mut multipliers = vec![0.0_f64; truth.len()];
    let mut estimates = DVector::<f64>::zeros(truth.len());
    for _ in 0..PASSES {
        let mut largest = 0.0_f64;
        for (index, multiplier) in multipliers.iter_mut().enumerate() {
            let own = kernel[(index, index)];
            let best: f64 = own * *multiplier - estimates[index] + truth[index];
            let next = (best.signum() * (best.abs() - ZONE).max(0.0) / own).clamp(-MOST, MOST);
            let change = next - *multiplier;
            if change != 0.0 {
                estimates.axpy(change, &kernel.column(index), 1.0);
                *multiplier = next;
                largest = largest.max(change.abs());
            }
        }
        if largest < CONVERGED {
            break;
        }
    }
    multipliers
}

/// The weighted mean of the nearest faces, found by brute force, because a k-d tree is no faster in 24 dimensions.
struct Neighbours {
    faces: DMatrix<f64>,
    truth: Vec<f64>,
}

pub fn neighbours(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    Ok(Box::new(Neighbours { faces: faces.transpose(), truth: truth.to_vec() }))
}

impl Predictor for Neighbours {
    fn predict(&self, face: &[f64]) -> f64 {
        let distances = self.faces.column_iter().map(|other| squared_distance(other, face));
        let mut found: Vec<(f64, f64)> = distances.zip(self.truth.iter().copied()).collect();
        if found.len() > NEIGHBOURS {
            found.select_nth_unstable_by(NEIGHBOURS, |a, b| a.0.total_cmp(&b.0));
            found.truncate(NEIGHBOURS);
        }
        let weighted = found.iter().map(|(squared, truth)| (squared.max(SAME).sqrt().recip(), truth));
        let add = |(weights, sum): (f64, f64), (weight, truth)| (weights + weight, sum + weight * truth);
        let (weights, sum) = weighted.fold((0.0, 0.0), add);
        sum / weights
    }

    fn weights(&self) -> usize {
        self.truth.len() / NEIGHBOURS
    }

    fn numbers(&self) -> usize {
        self.faces.len() + self.truth.len()
    }
}
