//! The ranking by support vectors: how well a support vector regression with a Gaussian kernel predicts the coefficient
//! from a single feature.
//!
//! The importance of a feature in a regression on all features would tell little, because neighbouring landmarks move
//! alike and each of them is dispensable.

use anyhow::Result;
use facewire::solve::MEASURES;
use nalgebra::DMatrix;
use rayon::prelude::*;

use super::pictures::Pictures;
use crate::{
    drawing::subsample,
    kinds::{Kind, SupportVectors},
    statistics::{mean, r_squared, standard_deviation},
};

/// Coefficient above which a picture shows the expression.
const SHOWS: f64 = 0.05;

/// Returns R2 of a regression on each feature, fitted to at most `most` pictures and judged on at most as many of
/// held-out subjects. At least half of these pictures show the expression, if there are enough of them.
pub fn scores(pictures: &Pictures, blendshape: usize, most: usize) -> Result<Vec<f64>> {
    let [fitted, judged] = [&pictures.seen, &pictures.held_out].map(|rows| bounded(pictures, blendshape, rows, most));
    let [own, other] = [&fitted, &judged].map(|rows| pictures.truth(blendshape, rows));
    let score = |feature: usize| {
        let (own_values, other_values) = (pictures.feature(feature, &fitted), pictures.feature(feature, &judged));
        Ok(r_squared(&estimates(&own_values, &own, &other_values)?, &other))
    };
    (0..MEASURES).into_par_iter().map(score).collect()
}

/// Returns at most `most` of the pictures `rows`, evenly spaced by coefficient among those that show the expression,
/// and among those that do not.
fn bounded(pictures: &Pictures, blendshape: usize, rows: &[usize], most: usize) -> Vec<usize> {
    let mut by_truth: Vec<_> = rows.iter().copied().zip(pictures.truth(blendshape, rows)).collect();
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
    let fitted = SupportVectors::Rbf.fit(&faces, truth)?;
    Ok(others.iter().map(|value| fitted.predict(&[scaled(value)])).collect())
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

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
