//! The faces of a dataset as features, relative to the neutral face or not, and what a model makes of them.

use std::collections::BTreeMap;
use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use facewire_face::model::FEATURES;
use facewire_face::stages::{Coefficients, FaceMean, Features, Normalised, Reference, correct, normalise};
use facewire_face::{BLENDSHAPES, COEFFS, Camera, HeadPose, Model, Neutral, Profile, SolveError};
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::dataset::{Appearances, Person, Sample, held_out};
use crate::shapes::MODELLED;
use crate::statistics::{mean, mse, pearson, standard_deviation};

/// Number of passes over the pictures when timing. The fastest pass counts, because other load disturbs it least.
const TIMED_PASSES: usize = 7;
const MOVES: f64 = 1e-3;

pub struct Faces<'a> {
    samples: &'a [Sample],
    features: Vec<Features>,
    neutral_known: bool,
    appearances: Option<&'a Appearances>,
}

impl<'a> Faces<'a> {
    /// Computes the features of every sample. They are relative to the person's neutral face if `neutral_known`.
    pub fn new(samples: &'a [Sample], neutral_known: bool) -> Result<Self> {
        let faces = samples.par_iter().map(|sample| normalise(&sample.landmarks)).collect::<Result<Vec<_>, _>>()?;
        let neutrals = if neutral_known { neutrals(samples, &faces)? } else { BTreeMap::new() };
        let one = |(sample, face): (&Sample, &Normalised)| Features::new(face, neutrals.get(&sample.person()));
        let features = samples.par_iter().zip(&faces).map(one).collect();
        Ok(Self { samples, features, neutral_known, appearances: None })
    }

    /// Adds how the faces of the dataset look. No sample may be a mirrored copy.
    pub fn with_appearances(self, appearances: Option<&'a Appearances>) -> Self {
        Self { appearances, ..self }
    }

    pub fn raw(&self, model: &Model, row: usize) -> Result<Coefficients, SolveError> {
        let appearance = self.appearances.map(|appearances| appearances.of(self.samples[row].picture));
        let raw = self.of_landmarks(model, row)?;
        let residual = model.residual(appearance.as_ref(), f32::from(u8::from(self.neutral_known)))?;
        let mut raw = residual.map_or(raw, |residual| raw.plus(&residual));
        let eyes = appearance.as_ref().map(|appearance| &appearance.looks.eyes);
        let from_mean = Features::new(&normalise(&self.samples[row].landmarks)?, Reference::MEAN);
        model.look(&mut raw, &from_mean, eyes);
        Ok(raw)
    }

    /// Returns what a model makes of the landmarks of picture `row`, without the look of the face.
    pub fn of_landmarks(&self, model: &Model, row: usize) -> Result<Coefficients, SolveError> {
        model.process(&self.features[row])
    }

    pub fn len(&self) -> usize {
        self.samples.len()
    }

    pub fn rows(&self, all: bool) -> Result<Vec<usize>> {
        if all { Ok((0..self.len()).collect()) } else { held_out(self.samples) }
    }

    /// Returns those of the wanted blendshapes, or of all if there are none, that move in each of `parts`. The names of the
    /// others are printed.
    pub fn moving(&self, wanted: &[usize], parts: &[&[usize]]) -> Result<Vec<usize>> {
        let all: Vec<usize> = (0..MODELLED).collect();
        let wanted = if wanted.is_empty() { &all } else { wanted };
        let moves = |shape: &usize| parts.iter().all(|rows| standard_deviation(&self.truth(*shape, rows)) > MOVES);
        let (moving, still): (Vec<usize>, Vec<usize>) = wanted.iter().partition(|shape| moves(shape));
        ensure!(!moving.is_empty(), "none of these blendshapes moves in the pictures");
        if !still.is_empty() {
            let names: Vec<&str> = still.iter().map(|shape| BLENDSHAPES[*shape]).collect();
            eprintln!("left out because they do not move in the pictures: {}", names.join(", "));
        }
        Ok(moving)
    }

    pub fn truth(&self, blendshape: usize, rows: &[usize]) -> Vec<f64> {
        rows.iter().map(|row| self.samples[*row].truth[blendshape]).collect()
    }

    /// Returns the true coefficients of pictures `rows`, one column per picture.
    pub fn truths(&self, rows: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(COEFFS, rows.len(), |blendshape, row| self.samples[rows[row]].truth[blendshape])
    }

    pub fn values(&self, row: usize) -> &[f32; FEATURES] {
        self.features[row].values()
    }
}

fn neutrals(samples: &[Sample], faces: &[Normalised]) -> Result<BTreeMap<Person, Neutral>> {
    let mut means: BTreeMap<Person, FaceMean> = BTreeMap::new();
    for (sample, face) in samples.iter().zip(faces) {
        let mean = means.entry(sample.person()).or_default();
        if sample.neutral {
            mean.add(face);
        }
    }
    let finish =
        |(person, mean): (Person, FaceMean)| Ok((person, mean.neutral().context("a subject has no neutral picture")?));
    means.into_iter().map(finish).collect()
}

/// Returns correlation and mean squared error of the corrected coefficients in pictures `rows`, for each blendshape.
pub fn scores(model: &Model, faces: &Faces, rows: &[usize]) -> Result<Vec<[f64; 2]>> {
    let score = |(blendshape, estimate): (usize, Vec<f64>)| {
        let truth = faces.truth(blendshape, rows);
        [pearson(&estimate, &truth), mse(&estimate, &truth)]
    };
    Ok(estimates(model, faces, rows)?.into_iter().enumerate().map(score).collect())
}

pub fn estimates(model: &Model, faces: &Faces, rows: &[usize]) -> Result<Vec<Vec<f64>>> {
    let mut curves = vec![Vec::new(); COEFFS];
    for row in rows {
        let raw = faces.raw(model, *row)?;
        let corrected = correct(&raw, &model.correction, &Profile::default());
        curves.iter_mut().zip(corrected.0).for_each(|(curve, value)| curve.push(f64::from(value)));
    }
    Ok(curves)
}

/// Returns the nanoseconds that the regression takes for one of the pictures `rows`.
pub fn regression_ns(model: &Model, faces: &Faces, rows: &[usize]) -> Result<f64> {
    let features: Vec<&Features> = rows.iter().map(|row| &faces.features[*row]).collect();
    fastest_ns(&features, |features| Ok(model.process(features)?))
}

/// Returns nanoseconds for one of `inputs`: the mean over them in the fastest of several passes.
pub fn fastest_ns<I, O>(inputs: &[I], compute: impl Fn(&I) -> Result<O>) -> Result<f64> {
    let pass = || -> Result<f64> {
        let start = Instant::now();
        for input in inputs {
            black_box(compute(black_box(input))?);
        }
        Ok(start.elapsed().as_secs_f64() * 1e9 / inputs.len() as f64)
    };
    (0..TIMED_PASSES).try_fold(f64::INFINITY, |best, _| Ok(best.min(pass()?)))
}

/// Returns the mean absolute error of yaw, pitch and roll in degrees over all pictures: the pose is not fitted.
pub fn pose_error_deg(samples: &[Sample]) -> Result<[f64; 3]> {
    let camera = Camera { width_px: 400.0, height_px: 600.0, horizontal_fov_deg: 16.1 };
    let angles = |pose: HeadPose| pose.yaw_pitch_roll_deg().map(f64::from);
    let errors = |sample: &Sample| -> Result<[f64; 3]> {
        let seen = angles(HeadPose::new(&normalise(&sample.landmarks)?, &camera));
        Ok(core::array::from_fn(|axis| (seen[axis] - sample.pose_deg[axis]).abs()))
    };
    let errors = samples.par_iter().map(errors).collect::<Result<Vec<_>>>()?;
    Ok(core::array::from_fn(|axis| mean(errors.iter().map(|error| error[axis]))))
}
