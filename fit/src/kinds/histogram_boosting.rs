//! Gradient boosting on histograms of the features, as in `LightGBM` (Ke et al., 2017). Each feature is divided into
//! bins with equally many faces, and trees split at the ends of bins only.

use anyhow::Result;
use nalgebra::{DMatrix, DVector};

use super::{Form, Kind, Limits, MIDDLE, Predictor};

const BINS: usize = 64;
const TREES: usize = 100;
/// Learning rate: the share of each tree's prediction that is added.
const RATE: f64 = 0.1;
const DEPTH: usize = 5;
const LEAST_FACES: u32 = 20;

/// Boosted trees on binned features.
pub struct HistogramBoosting;

/// A regression tree.
enum Tree {
    Leaf(f64),
    /// Faces whose feature is at most the threshold belong to the first child.
    Split {
        feature: usize,
        threshold: f64,
        children: Box<[Tree; 2]>,
    },
}

struct Fitted {
    mean: f64,
    trees: Vec<Tree>,
}

/// The features of all faces, divided into bins.
struct Binned {
    /// For each feature, the upper ends of all bins but the last.
    limits: Vec<Vec<f64>>,
    /// For each feature, the bin of every face.
    bins: Vec<Vec<u8>>,
}

impl Kind for HistogramBoosting {
    fn name(&self) -> &'static str {
        "hist-gb"
    }

    fn form(&self) -> Form {
        Form::Large
    }

    fn limits(&self) -> Limits {
        MIDDLE
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        let binned = Binned::new(faces);
        let mean = DVector::from_column_slice(truth).mean();
        let mut residuals: Vec<f64> = truth.iter().map(|truth| truth - mean).collect();
        let all: Vec<usize> = (0..truth.len()).collect();
        let trees = (0..TREES).map(|_| binned.grow(&mut residuals, &all, DEPTH)).collect();
        Ok(Box::new(Fitted { mean, trees }))
    }
}

impl Binned {
    fn new(faces: &DMatrix<f64>) -> Self {
        let limits: Vec<Vec<f64>> =
            faces.column_iter().map(|column| limits(column.iter().copied().collect())).collect();
        let bin = |(column, limits): (nalgebra::DVectorView<f64>, &Vec<f64>)| {
            column.iter().map(|value| limits.partition_point(|limit| limit < value) as u8).collect()
        };
        let bins = faces.column_iter().zip(&limits).map(bin).collect();
        Self { limits, bins }
    }

    /// Grows a tree on some faces and subtracts its prediction from the residuals.
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

/// Returns the upper ends of bins with equally many values.
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

impl Predictor for Fitted {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, unexplained};

    #[test]
    fn a_step_is_found_to_the_nearest_bin() {
        let (faces, truth) = faces(640, 2, |face| if face[1] > 0.3 { 1.0 } else { 0.0 });
        let model = HistogramBoosting.fit(&faces, &truth).unwrap();
        assert!((model.predict(&[0.0, 0.2])).abs() < 0.05 && (model.predict(&[0.0, 0.4]) - 1.0).abs() < 0.05);
    }

    #[test]
    fn a_nonlinear_function_is_found_from_many_faces() {
        let truth = |face: &[f64]| face[0] * face[1] + (3.0 * face[2]).sin();
        assert!(unexplained(&HistogramBoosting, 4000, truth) < 0.03);
    }

    #[test]
    fn a_constant_feature_is_never_split() {
        let faces = DMatrix::from_element(100, 1, 1.0);
        let truth: Vec<f64> = (0..100).map(|row| f64::from(row % 2)).collect();
        let model = HistogramBoosting.fit(&faces, &truth).unwrap();
        assert_eq!(model.weights(), TREES);
        assert!((model.predict(&[1.0]) - 0.5).abs() < 1e-12);
    }
}
