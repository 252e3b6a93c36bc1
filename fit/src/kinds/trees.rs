//! Ensembles of regression trees: gradient boosting (Friedman, 2001) and `AdaBoost.R2` (Drucker, 1997) with linear loss,
//! both with the trees of `smartcore`, and gradient boosting on histograms as in `LightGBM` (Ke et al., 2017).

use anyhow::{Context, Result};
use nalgebra::{DMatrix, DVector, DVectorView};
use smartcore::linalg::basic::matrix::DenseMatrix;
use smartcore::tree::decision_tree_regressor::{DecisionTreeRegressor, DecisionTreeRegressorParameters};

use super::{Fitted, Predictor};

/// Number of boosted trees, and the learning rate: the share of each tree's prediction that is added.
const BOOSTED: usize = 100;
const RATE: f64 = 0.1;
const BOOSTED_DEPTH: u16 = 3;
/// Numbers of a tree's inner node: feature, threshold, and position of its children.
const NODE: usize = 3;
const ADA_TREES: usize = 50;
const ADA_DEPTH: u16 = 4;
const GUESS: f64 = 0.5;
const SEED: u64 = 1;
/// Each feature is divided into bins with equally many faces, and trees on histograms split at the ends of bins only.
const BINS: usize = 64;
const HISTOGRAM_DEPTH: usize = 5;
const LEAST_FACES: u32 = 20;

type SmartTree = DecisionTreeRegressor<f64, f64, DenseMatrix<f64>, Vec<f64>>;

/// Fits a tree with at most `depth` splits from root to leaf. `smartcore` counts nodes instead.
pub fn tree(faces: &DenseMatrix<f64>, truth: &Vec<f64>, depth: u16) -> Result<SmartTree> {
    let parameters = DecisionTreeRegressorParameters::default().with_max_depth(depth + 1);
    SmartTree::fit(faces, truth, parameters).context("cannot grow a tree")
}

fn dense(faces: &DMatrix<f64>) -> Result<DenseMatrix<f64>> {
    DenseMatrix::new(faces.nrows(), faces.ncols(), faces.as_slice().to_vec(), true).context("there are no faces")
}

fn predictions(tree: &SmartTree, faces: &DenseMatrix<f64>) -> Result<Vec<f64>> {
    tree.predict(faces).context("a tree does not accept the faces that it was fitted to")
}

/// Trees, each with a weight or a constant, and how their estimates for a face become one.
struct Smart {
    trees: Vec<(SmartTree, f64)>,
    depth: u16,
    constants: usize,
    join: Box<dyn Fn(Vec<(f64, f64)>) -> f64 + Send + Sync>,
}

impl Predictor for Smart {
    fn predict(&self, face: &[f64]) -> f64 {
        let Ok(face) = DenseMatrix::new(1, face.len(), face.to_vec(), true) else { return f64::NAN };
        let estimate = |tree: &SmartTree| {
            tree.predict(&face).ok().and_then(|estimates| estimates.first().copied()).unwrap_or(f64::NAN)
        };
        (self.join)(self.trees.iter().map(|(tree, weight)| (estimate(tree), *weight)).collect())
    }

    fn weights(&self) -> usize {
        self.trees.len() << self.depth
    }

    fn numbers(&self) -> usize {
        self.trees.len() * ((1 << self.depth) + NODE * ((1 << self.depth) - 1)) + self.constants
    }
}

pub fn gradient_boosting(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    let faces = dense(faces)?;
    let mean = DVector::from_column_slice(truth).mean();
    let mut residuals: Vec<f64> = truth.iter().map(|truth| truth - mean).collect();
    let trees = (0..BOOSTED).map(|_| {
        let tree = tree(&faces, &residuals, BOOSTED_DEPTH)?;
        let estimates = predictions(&tree, &faces)?;
        residuals.iter_mut().zip(estimates).for_each(|(residual, estimate)| *residual -= RATE * estimate);
        Ok((tree, RATE))
    });
    let trees = trees.collect::<Result<_>>()?;
    let join = move |all: Vec<(f64, f64)>| mean + RATE * all.iter().map(|(estimate, _)| estimate).sum::<f64>();
    Ok(Box::new(Smart { trees, depth: BOOSTED_DEPTH, constants: 1, join: Box::new(join) }))
}

/// Fits each tree to a sample of the faces, in which faces with large errors of the previous trees are more frequent. The
/// prediction is the weighted median of the trees.
pub fn ada_boost(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    let mut random = fastrand::Rng::with_seed(SEED);
    let all = dense(faces)?;
    let mut shares = vec![1.0 / truth.len() as f64; truth.len()];
    let mut trees = Vec::new();
    while trees.len() < ADA_TREES {
        let sample = sample(&shares, &mut random);
        let sample_truth = sample.iter().map(|face| truth[*face]).collect();
        let tree = tree(&dense(&faces.select_rows(&sample))?, &sample_truth, ADA_DEPTH)?;
        let odds = reweight(&mut shares, &predictions(&tree, &all)?, truth);
        if odds.is_none_or(|odds| odds >= 1.0) && !trees.is_empty() {
            break;
        }
        trees.push((tree, -odds.unwrap_or(GUESS).clamp(f64::EPSILON, GUESS).ln()));
    }
    let constants = trees.len();
    Ok(Box::new(Smart { trees, depth: ADA_DEPTH, constants, join: Box::new(median) }))
}

/// Draws as many faces as there are, with replacement, with probabilities proportional to their shares.
fn sample(shares: &[f64], random: &mut fastrand::Rng) -> Vec<usize> {
    let mut sums: Vec<f64> = Vec::with_capacity(shares.len());
    let total = shares.iter().fold(0.0, |sum, share| {
        sums.push(sum + share);
        sum + share
    });
    let one = |()| {
        let position = random.f64() * total;
        sums.partition_point(|sum| *sum <= position).min(sums.len() - 1)
    };
    core::iter::repeat_n((), shares.len()).map(one).collect()
}

/// Reduces the shares of well predicted faces. Returns the odds that the tree is wrong, `None` without an error.
pub fn reweight(shares: &mut [f64], estimates: &[f64], truth: &[f64]) -> Option<f64> {
    let errors: Vec<f64> = estimates.iter().zip(truth).map(|(estimate, truth)| (estimate - truth).abs()).collect();
    let largest = errors.iter().copied().fold(0.0, f64::max);
    if largest <= 0.0 {
        return None;
    }
    let total: f64 = shares.iter().sum();
    let mean_loss = errors.iter().zip(&*shares).map(|(error, share)| error / largest * share / total).sum::<f64>();
    let odds = mean_loss / (1.0 - mean_loss);
    shares.iter_mut().zip(&errors).for_each(|(share, error)| *share *= odds.powf(1.0 - error / largest));
    Some(odds)
}

pub fn median(mut weighted: Vec<(f64, f64)>) -> f64 {
    weighted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = weighted.iter().map(|(_, weight)| weight).sum::<f64>() / 2.0;
    let mut sum = 0.0;
    let middle = weighted.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    middle.map_or(f64::NAN, |(value, _)| *value)
}

enum Tree {
    Leaf(f64),
    /// Faces whose feature is at most the threshold belong to the first child.
    Split {
        feature: usize,
        threshold: f64,
        children: Box<[Tree; 2]>,
    },
}

struct Boosted {
    mean: f64,
    trees: Vec<Tree>,
}

struct Binned {
    /// For each feature, the upper ends of all bins but the last.
    limits: Vec<Vec<f64>>,
    bins: Vec<Vec<u8>>,
}

pub fn histogram_boosting(faces: &DMatrix<f64>, truth: &[f64]) -> Result<Fitted> {
    let binned = Binned::new(faces);
    let mean = DVector::from_column_slice(truth).mean();
    let mut residuals: Vec<f64> = truth.iter().map(|truth| truth - mean).collect();
    let all: Vec<usize> = (0..truth.len()).collect();
    let trees = (0..BOOSTED).map(|_| binned.grow(&mut residuals, &all, HISTOGRAM_DEPTH)).collect();
    Ok(Box::new(Boosted { mean, trees }))
}

impl Binned {
    fn new(faces: &DMatrix<f64>) -> Self {
        let limits: Vec<Vec<f64>> =
            faces.column_iter().map(|column| limits(column.iter().copied().collect())).collect();
        let bin = |(column, limits): (DVectorView<f64>, &Vec<f64>)| {
            column.iter().map(|value| limits.partition_point(|limit| limit < value) as u8).collect()
        };
        let bins = faces.column_iter().zip(&limits).map(bin).collect();
        Self { limits, bins }
    }

    fn grow(&self, residuals: &mut [f64], faces: &[usize], depth: usize) -> Tree {
        let split = if depth > 0 { self.best_split(residuals, faces) } else { None };
        let Some((feature, bin)) = split else {
            let value = RATE * faces.iter().map(|face| residuals[*face]).sum::<f64>() / faces.len().max(1) as f64;
            for face in faces {
                residuals[*face] -= value;
            }
            return Tree::Leaf(value);
        };
        let (low, high): (Vec<usize>, Vec<usize>) =
            faces.iter().partition(|face| usize::from(self.bins[feature][**face]) <= bin);
        let children = Box::new([self.grow(residuals, &low, depth - 1), self.grow(residuals, &high, depth - 1)]);
        Tree::Split { feature, threshold: self.limits[feature][bin], children }
    }

    /// Returns the feature of the split that explains most, and the last bin of its lower part.
    fn best_split(&self, residuals: &[f64], faces: &[usize]) -> Option<(usize, usize)> {
        let total: f64 = faces.iter().map(|face| residuals[*face]).sum();
        let mut best = (total * total / faces.len() as f64 + f64::EPSILON, None);
        for (feature, bins) in self.bins.iter().enumerate() {
            let mut histogram = [(0.0, 0_u32); BINS];
            for face in faces {
                let (sum, count) = &mut histogram[usize::from(bins[*face])];
                (*sum, *count) = (*sum + residuals[*face], *count + 1);
            }
            let found = best_cut(&histogram, total, faces.len() as u32);
            if let Some((gain, bin)) = found.filter(|(gain, _)| *gain > best.0) {
                best = (gain, Some((feature, bin)));
            }
        }
        best.1
    }
}

/// Returns the gain of the best split of a histogram of sums and counts, and the last bin of its lower part.
fn best_cut(histogram: &[(f64, u32); BINS], total: f64, count: u32) -> Option<(f64, usize)> {
    let (mut sum, mut below) = (0.0, 0);
    let gains = histogram.iter().enumerate().filter_map(|(bin, (own, faces))| {
        (sum, below) = (sum + own, below + faces);
        let enough = below >= LEAST_FACES && count - below >= LEAST_FACES;
        let gain = || sum * sum / f64::from(below) + (total - sum).powi(2) / f64::from(count - below);
        enough.then(|| (gain(), bin))
    });
    gains.max_by(|a, b| a.0.total_cmp(&b.0))
}

fn limits(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    let mut limits: Vec<f64> = (1..BINS).map(|bin| values[(bin * values.len() / BINS).min(values.len() - 1)]).collect();
    limits.dedup();
    limits
}

impl Tree {
    fn predict(&self, face: &[f64]) -> f64 {
        let mut tree = self;
        loop {
            match tree {
                Self::Leaf(value) => return *value,
                Self::Split { feature, threshold, children } => {
                    tree = &children[usize::from(face[*feature] > *threshold)];
                }
            }
        }
    }

    fn leaves(&self) -> usize {
        match self {
            Self::Leaf(_) => 1,
            Self::Split { children, .. } => children.iter().map(Self::leaves).sum(),
        }
    }
}

impl Predictor for Boosted {
    fn predict(&self, face: &[f64]) -> f64 {
        self.mean + self.trees.iter().map(|tree| tree.predict(face)).sum::<f64>()
    }

    fn weights(&self) -> usize {
        self.trees.iter().map(Tree::leaves).sum()
    }

    /// Counts one number per leaf, and three per split: feature, threshold and position of its children. A tree has one
    /// split less than leaves.
    fn numbers(&self) -> usize {
        4 * self.weights() - 3 * self.trees.len() + 1
    }
}
