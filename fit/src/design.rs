//! The design matrix of the fit. Every face appears twice, with features relative to the subject's own neutral face and
//! relative to the mean of all neutral faces, so that one model learns both cases.

use anyhow::{Context, Result};
use facewire::solve::{BLENDSHAPES, FEATURES, MEASURES};
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::{dataset::Sample, judge::Faces};

/// Number of blendshapes that the model predicts: all but the last, `tongueOut`, which no landmark shows.
pub const MODELLED: usize = BLENDSHAPES.len() - 1;
/// Number of faces whose products one thread adds up at a time.
const BLOCK: usize = 4096;

/// Features and true coefficients of all faces. A face is a column.
pub struct Design<'a> {
    samples: &'a [Sample],
    known: Faces<'a>,
    unknown: Faces<'a>,
    /// Mean of each feature over all neutral faces, and 0 for the features of head rotation.
    pub neutral: Vec<f32>,
}

impl<'a> Design<'a> {
    /// Builds the design from all samples. Every person must have a neutral picture.
    pub fn new(samples: &'a [Sample]) -> Result<Self> {
        let (known, unknown) = (Faces::new(samples, true)?, Faces::new(samples, false)?);
        let rows: Vec<usize> = (0..samples.len()).filter(|row| samples[*row].neutral).collect();
        let mean = |feature: usize| {
            let sum: f32 = rows.iter().map(|row| unknown.values(*row)[feature]).sum();
            if feature < MEASURES { sum / rows.len() as f32 } else { 0.0 }
        };
        let neutral = (0..FEATURES).map(mean).collect();
        Ok(Self { samples, known, unknown, neutral })
    }

    /// Returns the number of faces: every sample with its neutral face known, then every sample without.
    pub fn len(&self) -> usize {
        2 * self.samples.len()
    }

    /// Returns whether the face's features are relative to the subject's own neutral face.
    pub fn is_known(&self, face: usize) -> bool {
        face < self.samples.len()
    }

    /// Returns one feature of one face.
    pub fn value(&self, face: usize, feature: usize) -> f32 {
        match face.checked_sub(self.samples.len()) {
            None => self.known.values(face)[feature],
            Some(row) => self.unknown.values(row)[feature] - self.neutral[feature],
        }
    }

    /// Returns the standardised features of some faces, one column per face.
    pub fn columns(&self, faces: &[usize], features: &[usize], scale: &Scale) -> DMatrix<f32> {
        DMatrix::from_fn(features.len(), faces.len(), |row, column| {
            let feature = features[row];
            (self.value(faces[column], feature) - scale.mean[feature]) / scale.deviation[feature]
        })
    }

    /// Returns the true coefficients of some faces, one column per face.
    pub fn truth(&self, faces: &[usize]) -> DMatrix<f32> {
        let truth = |row: usize, column: usize| self.samples[faces[column] % self.samples.len()].truth[row] as f32;
        DMatrix::from_fn(MODELLED, faces.len(), truth)
    }

    /// Returns the second moments of the standardised features with each other, and with the centred truth.
    pub fn moments(&self, features: &[usize], scale: &Scale) -> Result<(DMatrix<f64>, DMatrix<f64>)> {
        let faces: Vec<usize> = (0..self.len()).collect();
        let truth_mean = self.truth(&faces).column_mean();
        let part = |faces: &[usize]| {
            let (columns, mut truth) = (self.columns(faces, features, scale), self.truth(faces));
            truth.column_iter_mut().for_each(|mut column| column -= &truth_mean);
            let transposed = columns.transpose();
            ((&columns * &transposed).cast::<f64>(), (truth * transposed).transpose().cast::<f64>())
        };
        let sum = faces.par_chunks(BLOCK).map(part).reduce_with(|(a, b), (c, d)| (a + c, b + d));
        let (gram, cross) = sum.context("there are no pictures")?;
        let count = self.len() as f64;
        Ok((gram / count, cross / count))
    }
}

/// Mean and standard deviation of each feature.
pub struct Scale {
    pub mean: Vec<f32>,
    pub deviation: Vec<f32>,
}

impl Scale {
    /// Computes the scale of a design. A standard deviation below `least` is replaced by `least`, so that a feature
    /// that hardly ever moves cannot dominate when it does.
    pub fn of(design: &Design, least: f32) -> Self {
        let moments = |feature: usize| {
            let values = (0..design.len()).map(|face| f64::from(design.value(face, feature)));
            let (sum, squares) =
                values.fold((0.0, 0.0), |(sum, squares), value| (sum + value, squares + value * value));
            let mean = sum / design.len() as f64;
            (mean as f32, (squares / design.len() as f64 - mean * mean).max(0.0).sqrt() as f32)
        };
        let moments: Vec<(f32, f32)> = (0..FEATURES).into_par_iter().map(moments).collect();
        let (mean, deviation): (Vec<f32>, Vec<f32>) = moments.into_iter().unzip();
        Self { mean, deviation: deviation.into_iter().map(|deviation| deviation.max(least)).collect() }
    }
}
