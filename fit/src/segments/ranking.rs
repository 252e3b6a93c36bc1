//! Rankings of the features, and their agreement.

use anyhow::{Context, Result};
use facewire_face::model::MEASURES;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::dataset::Sample;
use crate::design::MODELLED;
use crate::drawing::subsample;
use crate::judge::Faces;
use crate::kinds;
use crate::statistics::{Regressors, mean, pearson, r_squared, spearman, standard_deviation};

/// The number of rankings.
pub const RANKINGS: usize = 3;
/// The names of the rankings: by correlation, by partial F, and by R2 of support vectors.
pub const NAMES: [&str; RANKINGS] = ["r", "F", "SVR"];
/// The pairs of rankings to compare.
pub const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

#[derive(Debug, Clone, PartialEq)]
pub struct Ranking {
    /// Score of each feature; larger is better.
    pub scores: Vec<f64>,
    /// Rank of each feature, from 1. Of features with equal scores, the first has the better rank.
    pub ranks: Vec<usize>,
    pub order: Vec<usize>,
}

impl Ranking {
    pub fn new(scores: Vec<f64>) -> Self {
        let mut order: Vec<usize> = (0..scores.len()).collect();
        order.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
        let mut ranks = vec![0; scores.len()];
        order.iter().enumerate().for_each(|(index, feature)| ranks[*feature] = index + 1);
        Self { scores, ranks, order }
    }

    /// Returns the share of the best `count` features that are also among the best `count` of another ranking.
    pub fn overlap(&self, other: &Self, count: usize) -> f64 {
        let best = self.order.iter().take(count);
        best.filter(|feature| other.ranks[**feature] <= count).count() as f64 / count as f64
    }
}

#[derive(Debug, Clone, PartialEq)]
pub struct Segment {
    pub blendshape: usize,
    /// Pearson's correlation of each feature, with its sign.
    pub r: Vec<f64>,
    /// F of each feature alone, which has the order of `r` squared.
    pub f_alone: Vec<f64>,
    pub rankings: [Ranking; RANKINGS],
    pub count: usize,
}

impl Segment {
    /// Returns the features that are kept: those with the highest correlation, best first.
    pub fn kept(&self) -> &[usize] {
        &self.rankings[0].order[..self.count]
    }

    pub fn keeps(&self, feature: usize) -> bool {
        self.rankings[0].ranks[feature] <= self.count
    }

    pub fn agreements(&self) -> [f64; 2 * PAIRS.len()] {
        core::array::from_fn(|index| {
            let (a, b) = PAIRS[index % PAIRS.len()];
            let (one, other) = (&self.rankings[a], &self.rankings[b]);
            if index < PAIRS.len() { one.overlap(other, self.count) } else { spearman(&one.scores, &other.scores) }
        })
    }
}

/// Number of angles of the head's pose.
const ANGLES: usize = 3;

/// Pictures of subjects that the fit may see, on which features are ranked, and of held-out subjects, on which support
/// vectors are judged.
pub struct Pictures<'a> {
    samples: &'a [Sample],
    /// Features relative to the subjects' neutral faces.
    pub known: &'a Faces<'a>,
    pub seen: Vec<usize>,
    pub held_out: Vec<usize>,
}

impl<'a> Pictures<'a> {
    /// Splits the samples. `known` are their features relative to the subjects' neutral faces.
    pub fn new(samples: &'a [Sample], known: &'a Faces<'a>) -> Result<Self> {
        let held_out = known.rows(false)?;
        let seen: Vec<usize> = (0..samples.len()).filter(|row| !samples[*row].held_out()).collect();
        Ok(Self { samples, known, seen, held_out })
    }

    pub fn feature(&self, feature: usize, rows: &[usize]) -> Vec<f64> {
        rows.iter().map(|row| f64::from(self.known.values(*row)[feature])).collect()
    }

    /// Returns Pearson's correlation of every feature with each of `blendshapes`.
    pub fn correlations(&self, blendshapes: &[usize]) -> Vec<Vec<f64>> {
        let truths: Vec<Vec<f64>> = blendshapes.iter().map(|shape| self.known.truth(*shape, &self.seen)).collect();
        let of = |feature: usize| {
            let values = self.feature(feature, &self.seen);
            truths.iter().map(|truth| pearson(&values, truth)).collect()
        };
        transposed(&(0..MEASURES).into_par_iter().map(of).collect::<Vec<Vec<f64>>>(), blendshapes.len())
    }

    /// Returns the partial F of every feature with each of `blendshapes`, controlling for the subject, the true pose
    /// and all other blendshapes.
    pub fn partial_f(&self, blendshapes: &[usize]) -> Result<Vec<Vec<f64>>> {
        let held = DMatrix::from_fn(self.seen.len(), MODELLED + ANGLES, |row, column| {
            let sample = &self.samples[self.seen[row]];
            if column < MODELLED { sample.truth[column] } else { sample.pose_deg[column - MODELLED] }
        });
        let subjects: Vec<usize> = self.seen.iter().map(|row| self.samples[*row].subject).collect();
        let regressors = Regressors::new(held, &subjects).context("too few pictures of each subject")?;
        let of = |feature: usize| {
            let all = regressors.partial_f(&self.feature(feature, &self.seen));
            blendshapes.iter().map(|shape| all[*shape]).collect()
        };
        Ok(transposed(&(0..MEASURES).into_par_iter().map(of).collect::<Vec<Vec<f64>>>(), blendshapes.len()))
    }
}

fn transposed(rows: &[Vec<f64>], columns: usize) -> Vec<Vec<f64>> {
    (0..columns).map(|column| rows.iter().map(|row| row[column]).collect()).collect()
}

// The ranking by support vectors: how well a support vector regression with a Gaussian kernel predicts the coefficient
// from a single feature.
//
// The importance of a feature in a regression on all features would tell little, because neighbouring landmarks move
// alike and each of them is dispensable.

/// Coefficient above which a picture shows the expression.
const SHOWS: f64 = 0.05;

/// Returns R2 of a regression on each feature, fitted to at most `most` pictures and judged on at most as many of
/// held-out subjects. At least half of these pictures show the expression, if there are enough of them.
pub fn scores(pictures: &Pictures, blendshape: usize, most: usize) -> Result<Vec<f64>> {
    let [fitted, judged] = [&pictures.seen, &pictures.held_out].map(|rows| bounded(pictures, blendshape, rows, most));
    let [own, other] = [&fitted, &judged].map(|rows| pictures.known.truth(blendshape, rows));
    let score = |feature: usize| {
        let (own_values, other_values) = (pictures.feature(feature, &fitted), pictures.feature(feature, &judged));
        Ok(r_squared(&estimates(&own_values, &own, &other_values)?, &other))
    };
    (0..MEASURES).into_par_iter().map(score).collect()
}

/// Returns at most `most` of the pictures `rows`, evenly spaced by coefficient among those that show the expression,
/// and among those that do not.
fn bounded(pictures: &Pictures, blendshape: usize, rows: &[usize], most: usize) -> Vec<usize> {
    let mut by_truth: Vec<_> = rows.iter().copied().zip(pictures.known.truth(blendshape, rows)).collect();
    by_truth.sort_by(|a, b| a.1.total_cmp(&b.1));
    let sorted: Vec<usize> = by_truth.iter().map(|(row, _)| *row).collect();
    let (rests, shows) = sorted.split_at(by_truth.partition_point(|(_, truth)| *truth < SHOWS));
    let showing = subsample(shows, (most / 2).max(most.saturating_sub(rests.len())));
    [subsample(rests, most - showing.len()), showing].concat()
}

/// Fits a regression to `values` and their `truth`, and returns its estimates for `others`.
fn estimates(values: &[f64], truth: &[f64], others: &[f64]) -> Result<Vec<f64>> {
    let (centre, deviation) = (mean(values.iter().copied()), standard_deviation(values).max(f64::EPSILON));
    let scaled = |value: &f64| (value - centre) / deviation;
    let faces = DMatrix::from_iterator(values.len(), 1, values.iter().map(scaled));
    let fitted = kinds::support_vectors(&faces, truth)?;
    Ok(others.iter().map(|value| fitted.predict(&[scaled(value)])).collect())
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[test]
    fn the_best_feature_has_rank_1_and_equal_features_keep_their_order() {
        let ranking = Ranking::new(vec![0.1, 0.9, 0.5, 0.9]);
        assert_eq!(ranking.ranks, [4, 1, 3, 2]);
        assert_eq!(ranking.order, [1, 3, 2, 0]);
    }

    #[test]
    fn overlap_is_the_share_of_the_best_features_in_common() {
        let (one, other) = (Ranking::new(vec![4.0, 3.0, 2.0, 1.0]), Ranking::new(vec![4.0, 1.0, 2.0, 3.0]));
        assert!((one.overlap(&other, 2) - 0.5).abs() < 1e-12);
        assert!((one.overlap(&one, 2) - 1.0).abs() < 1e-12);
    }

    #[derive(Deserialize)]
    struct Reference {
        support_vectors: SupportVectors,
    }

    #[derive(Deserialize)]
    struct SupportVectors {
        values: Vec<f64>,
        truth: Vec<f64>,
        places: Vec<f64>,
        estimates: Vec<f64>,
    }

    /// The tolerance is large because the penalty does not include the offset in scikit-learn.
    #[test]
    fn estimates_agree_with_scikit_learn_within_0_04() {
        let reference: Reference = serde_json::from_str(include_str!("../../tests/reference.json")).unwrap();
        let SupportVectors { values, truth, places, estimates: theirs } = reference.support_vectors;
        let ours = estimates(&values, &truth, &places).unwrap();
        assert!(ours.iter().zip(&theirs).all(|(a, b)| (a - b).abs() < 0.04), "{ours:?} {theirs:?}");
    }

    #[test]
    fn a_curve_without_linear_correlation_is_predicted_and_noise_is_not() {
        let values: Vec<f64> = (0..120).map(|i| f64::from(i) / 60.0 - 1.0).collect();
        let places: Vec<f64> = values.iter().map(|value| value * 0.95).collect();
        let square = |values: &[f64]| values.iter().map(|value| value * value).collect::<Vec<_>>();
        let found = estimates(&values, &square(&values), &places).unwrap();
        assert!(r_squared(&found, &square(&places)) > 0.95);
        let noise: Vec<f64> = (0..120).map(|i| f64::from(i * 7919 % 120) / 120.0).collect();
        let others = [&noise[37..], &noise[..37]].concat();
        let found = estimates(&noise, &square(&values), &others).unwrap();
        assert!(r_squared(&found, &square(&values)) < 0.3);
    }
}
