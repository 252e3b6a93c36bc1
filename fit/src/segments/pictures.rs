//! The pictures on which features are ranked.

use anyhow::{Context, Result};
use facewire::solve::MEASURES;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::{
    dataset::Sample,
    design::MODELLED,
    judge::Faces,
    statistics::{Regressors, pearson},
};

/// Number of angles of the head's pose.
const ANGLES: usize = 3;

/// Pictures of subjects that the fit may see, on which features are ranked, and of held-out subjects, on which support
/// vectors are judged.
pub struct Pictures<'a> {
    samples: &'a [Sample],
    /// Features relative to the subjects' neutral faces.
    pub known: &'a Faces<'a>,
    /// Pictures that the fit may see.
    pub seen: Vec<usize>,
    /// Pictures of held-out subjects.
    pub held_out: Vec<usize>,
}

impl<'a> Pictures<'a> {
    /// Splits the samples. `known` are their features relative to the subjects' neutral faces.
    pub fn new(samples: &'a [Sample], known: &'a Faces<'a>) -> Result<Self> {
        let held_out = known.rows(false)?;
        let seen: Vec<usize> = (0..samples.len()).filter(|row| !samples[*row].held_out()).collect();
        Ok(Self { samples, known, seen, held_out })
    }

    /// Returns the true coefficients of a blendshape in pictures `rows`.
    pub fn truth(&self, blendshape: usize, rows: &[usize]) -> Vec<f64> {
        self.known.truth(blendshape, rows)
    }

    /// Returns the values of a feature in pictures `rows`.
    pub fn feature(&self, feature: usize, rows: &[usize]) -> Vec<f64> {
        rows.iter().map(|row| f64::from(self.known.values(*row)[feature])).collect()
    }

    /// Returns Pearson's correlation of every feature with each of `blendshapes`.
    pub fn correlations(&self, blendshapes: &[usize]) -> Vec<Vec<f64>> {
        let truths: Vec<Vec<f64>> = blendshapes.iter().map(|shape| self.truth(*shape, &self.seen)).collect();
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
