//! The split of the pictures: which ones the fit sees, which choose the kind, and which it is scored on.

use std::collections::BTreeSet;

use anyhow::{Result, ensure};

use crate::dataset::{Sample, held_out};

/// If all pictures are of one subject, one in this many pictures is held out.
const HOLD_OUT_EVERY: usize = 4;
const SEED: u64 = 1;

/// A split of the pictures. Pictures are denoted by their index.
pub struct Split {
    /// Pictures for fitting and for choosing the kind, in ascending order.
    pub seen: Vec<usize>,
    /// Pictures for scoring, in ascending order.
    pub held_out: Vec<usize>,
    pub folds: usize,
    pub one_subject: bool,
    /// The fold of every picture, without meaning for held-out pictures.
    fold: Vec<usize>,
    group: Vec<usize>,
}

impl Split {
    /// Splits by subject, or by picture if there is only one subject or if `one_subject` is set.
    pub fn new(samples: &[Sample], folds: usize, one_subject: bool) -> Result<Self> {
        let subjects: BTreeSet<usize> = samples.iter().map(|sample| sample.subject).collect();
        let split = if one_subject || subjects.len() == 1 {
            Self::by_picture(samples.len(), folds)
        } else {
            Self::by_subject(samples, folds)?
        };
        let filled = (0..folds).all(|fold| !split.validation(fold).is_empty());
        ensure!(folds > 1 && filled && !split.held_out.is_empty(), "too few subjects or pictures for {folds} folds");
        Ok(split)
    }

    fn by_subject(samples: &[Sample], folds: usize) -> Result<Self> {
        let held_out = held_out(samples)?;
        let seen: Vec<usize> = (0..samples.len()).filter(|row| !samples[*row].held_out()).collect();
        let subjects: BTreeSet<usize> = seen.iter().map(|row| samples[*row].subject).collect();
        let subjects: Vec<usize> = subjects.into_iter().collect();
        let fold = |sample: &Sample| subjects.partition_point(|subject| *subject < sample.subject) % folds.max(1);
        let group = samples.iter().map(|sample| sample.subject).collect();
        Ok(Self { seen, held_out, folds, one_subject: false, fold: samples.iter().map(fold).collect(), group })
    }

    fn by_picture(pictures: usize, folds: usize) -> Self {
        let mut order: Vec<usize> = (0..pictures).collect();
        fastrand::Rng::with_seed(SEED).shuffle(&mut order);
        let (held_out, seen) = (0..pictures).partition(|row| order[*row].is_multiple_of(HOLD_OUT_EVERY));
        let fold = order.iter().map(|index| index / HOLD_OUT_EVERY % folds.max(1)).collect();
        Self { seen, held_out, folds, one_subject: true, fold, group: (0..pictures).collect() }
    }

    /// Returns the seen pictures that are not in the fold `without`.
    pub fn training(&self, without: usize) -> Vec<usize> {
        self.seen.iter().copied().filter(|row| self.fold[*row] != without).collect()
    }

    pub fn described(&self) -> String {
        let of = if self.one_subject { "of the same subject" } else { "of other subjects" };
        let (seen, held_out) = (self.seen.len(), self.held_out.len());
        format!("{seen} pictures; r and mse are those of {held_out} pictures {of}")
    }

    pub fn validation(&self, fold: usize) -> Vec<usize> {
        self.seen.iter().copied().filter(|row| self.fold[*row] == fold).collect()
    }

    /// Returns the mean squared error on the seen pictures and its standard error. The standard error allows for
    /// correlated errors within a group (clustered standard error).
    pub fn mean_error(&self, squared: &[f64]) -> [f64; 2] {
        let count = squared.len() as f64;
        let mean = squared.iter().sum::<f64>() / count;
        let mut sums = vec![0.0; self.group.iter().max().map_or(0, |last| last + 1)];
        self.seen.iter().zip(squared).for_each(|(row, error)| sums[self.group[*row]] += error - mean);
        [mean, sums.iter().map(|sum| sum * sum).sum::<f64>().sqrt() / count]
    }
}

#[cfg(test)]
mod tests {
    use facewire_face::{COEFFS, LANDMARKS, Landmarks};

    use super::*;

    fn samples(subjects: usize, each: usize) -> Vec<Sample> {
        let sample = |row: usize| Sample {
            landmarks: Landmarks([[0.0; 3]; LANDMARKS]),
            truth: [0.0; COEFFS],
            pose_deg: [0.0; 3],
            picture: row,
            subject: row / each,
            neutral: false,
            mirrored: false,
        };
        (0..subjects * each).map(sample).collect()
    }

    #[test]
    fn no_subject_is_in_two_folds() {
        let samples = samples(32, 3);
        let split = Split::new(&samples, 3, false).unwrap();
        let subjects = |rows: &[usize]| rows.iter().map(|row| samples[*row].subject).collect::<BTreeSet<_>>();
        assert!(subjects(&split.seen).is_disjoint(&subjects(&split.held_out)));
        for fold in 0..3 {
            let (training, validation) = (split.training(fold), split.validation(fold));
            assert!(subjects(&training).is_disjoint(&subjects(&validation)));
            assert_eq!(training.len() + validation.len(), split.seen.len());
        }
    }

    #[test]
    fn pictures_of_one_subject_are_split_evenly() {
        let split = Split::new(&samples(1, 400), 3, false).unwrap();
        assert!(split.one_subject && split.held_out.len() == 100);
        assert!((0..3).all(|fold| split.validation(fold).len().abs_diff(100) < 3));
    }

    #[test]
    fn too_few_subjects_for_the_folds_are_refused() {
        assert!(Split::new(&samples(9, 2), 30, false).is_err());
        assert!(Split::new(&samples(32, 2), 1, false).is_err());
    }

    #[test]
    fn an_error_that_all_pictures_of_a_subject_share_counts_once() {
        let apart = Split::new(&samples(1, 400), 3, true).unwrap();
        let together = Split::new(&samples(100, 4), 3, false).unwrap();
        let of_subject = |split: &Split| split.seen.iter().map(|row| (row / 4 % 2) as f64).collect::<Vec<_>>();
        let [mean, error] = together.mean_error(&of_subject(&together));
        // Of the 88 seen subjects, 38 have odd numbers.
        let deviation = |mean: f64| (mean * (1.0 - mean)).sqrt();
        assert!((mean - 38.0 / 88.0).abs() < 1e-9, "{mean}");
        assert!((error - deviation(mean) / 88_f64.sqrt()).abs() < 1e-6, "{error}");
        let [mean, error] = apart.mean_error(&of_subject(&apart));
        assert!((error - deviation(mean) / 300_f64.sqrt()).abs() < 1e-6, "{error}");
    }
}
