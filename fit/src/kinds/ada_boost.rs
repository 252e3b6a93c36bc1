//! `AdaBoost.R2` (Drucker, 1997) with linear loss, using the trees of `smartcore`.

use anyhow::{Context, Result};
use nalgebra::DMatrix;

use super::{
    Form, Kind, Limits, NARROW, Predictor,
    gradient_boosting::{NODE, Tree, dense, dense_row, estimate, tree},
};

const TREES: usize = 50;
const DEPTH: u16 = 4;
/// Largest mean loss of a tree that is better than a guess.
const GUESS: f64 = 0.5;
const SEED: u64 = 1;

/// An ensemble of trees. Each tree is fitted to a sample of the faces, in which faces with large errors of the previous
/// trees are more frequent. The prediction is the weighted median of the trees.
pub struct AdaBoost;

struct Fitted {
    trees: Vec<(Tree, f64)>,
}

impl Kind for AdaBoost {
    fn name(&self) -> &'static str {
        "ada"
    }

    fn form(&self) -> Form {
        Form::Large
    }

    fn limits(&self) -> Limits {
        NARROW
    }

    fn fit(&self, faces: &DMatrix<f64>, truth: &[f64]) -> Result<Box<dyn Predictor>> {
        let mut random = fastrand::Rng::with_seed(SEED);
        let all = dense(faces)?;
        let mut shares = vec![1.0 / truth.len() as f64; truth.len()];
        let mut trees = Vec::new();
        while trees.len() < TREES {
            let sample = sample(&shares, &mut random);
            let sample_truth = sample.iter().map(|face| truth[*face]).collect();
            let tree = tree(&dense(&faces.select_rows(&sample))?, &sample_truth, DEPTH)?;
            let estimates = tree.predict(&all).context("a tree does not accept the faces that it was fitted to")?;
            let odds = reweight(&mut shares, &estimates, truth);
            if odds.is_none_or(|odds| odds >= 1.0) && !trees.is_empty() {
                break;
            }
            trees.push((tree, -odds.unwrap_or(GUESS).clamp(f64::EPSILON, GUESS).ln()));
        }
        Ok(Box::new(Fitted { trees }))
    }
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

/// Reduces the shares of the faces that a tree predicts well. Returns the tree's odds of being wrong, or `None` if it
/// makes no error.
fn reweight(shares: &mut [f64], estimates: &[f64], truth: &[f64]) -> Option<f64> {
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

impl Predictor for Fitted {
    fn predict(&self, face: &[f64]) -> f64 {
        let Some(face) = dense_row(face) else { return f64::NAN };
        median(self.trees.iter().map(|(tree, weight)| (estimate(tree, &face), *weight)).collect())
    }

    fn weights(&self) -> usize {
        self.trees.len() << DEPTH
    }

    /// Counts every tree as complete.
    fn numbers(&self) -> usize {
        self.trees.len() * ((1 << DEPTH) + NODE * ((1 << DEPTH) - 1) + 1)
    }
}

/// Returns the weighted median.
fn median(mut weighted: Vec<(f64, f64)>) -> f64 {
    weighted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = weighted.iter().map(|(_, weight)| weight).sum::<f64>() / 2.0;
    let mut sum = 0.0;
    let middle = weighted.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    middle.map_or(f64::NAN, |(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::test_faces::{faces, unexplained};

    #[test]
    fn a_step_is_found() {
        let (faces, truth) = faces(300, 2, |face| if face[1] > 0.3 { 1.0 } else { 0.0 });
        let model = AdaBoost.fit(&faces, &truth).unwrap();
        assert!((model.predict(&[0.0, 0.2])).abs() < 1e-9 && (model.predict(&[0.0, 0.4]) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_nonlinear_function_is_found_from_many_faces() {
        assert!(unexplained(&AdaBoost, 1500, |face| face[0] * face[1] + (3.0 * face[2]).sin()) < 0.2);
    }

    #[test]
    fn the_median_is_weighted() {
        assert!((median(vec![(3.0, 1.0), (1.0, 1.0), (2.0, 1.0)]) - 2.0).abs() < 1e-12);
        assert!((median(vec![(3.0, 5.0), (1.0, 1.0), (2.0, 1.0)]) - 3.0).abs() < 1e-12);
    }

    #[test]
    fn faces_that_a_tree_predicts_well_get_smaller_shares() {
        let mut shares = vec![0.25; 4];
        let odds = reweight(&mut shares, &[0.0, 0.0, 0.0, 1.0], &[0.0; 4]);
        assert!(odds.is_some_and(|odds| (odds - 1.0 / 3.0).abs() < 1e-12), "{odds:?}");
        assert!((shares[0] - 0.25 / 3.0).abs() < 1e-12 && (shares[3] - 0.25).abs() < 1e-12);
    }
}
