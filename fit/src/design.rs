//! The design matrix of the fit. Every face appears twice, with features relative to the subject's own neutral face and
//! relative to the mean of all neutral faces, so that one model learns both cases.

use anyhow::{Context, Result, ensure};
use facewire_face::model::{FEATURES, MEASURES};
use facewire_face::stages::{Coefficients, MIRRORED, normalise};
use facewire_face::{LANDMARKS, Landmarks};
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::dataset::Sample;
use crate::faces::Faces;
use crate::shapes::MODELLED;

const BLOCK: usize = 4096;

pub struct Design<'a> {
    samples: &'a [Sample],
    known: Faces<'a>,
    unknown: Faces<'a>,
    /// Mean of each feature over all neutral faces, and 0 for the features of head rotation.
    pub neutral: Vec<f32>,
}

impl<'a> Design<'a> {
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

    pub fn value(&self, face: usize, feature: usize) -> f32 {
        match face.checked_sub(self.samples.len()) {
            None => self.known.values(face)[feature],
            Some(row) => self.unknown.values(row)[feature] - self.neutral[feature],
        }
    }

    pub fn columns(&self, faces: &[usize], features: &[usize], scale: &Scale) -> DMatrix<f32> {
        DMatrix::from_fn(features.len(), faces.len(), |row, column| {
            let feature = features[row];
            (self.value(faces[column], feature) - scale.mean[feature]) / scale.deviation[feature]
        })
    }

    /// Returns the true coefficients of a face.
    pub fn coefficients(&self, face: usize) -> Coefficients {
        Coefficients(self.samples[face % self.samples.len()].truth.map(|value| value as f32))
    }

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

pub struct Scale {
    pub mean: Vec<f32>,
    pub deviation: Vec<f32>,
}

impl Scale {
    /// Computes the scale. Deviations are at least `least`, so that a feature that rarely moves cannot dominate.
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

/// The smallest deviation that a component is scaled by, relative to the largest component's.
const MIN_RELATIVE_DEVIATION: f64 = 0.02;
/// Each component is divided by its deviation to this power. With 1, the small components, which are noise, would count
/// as much as the large ones; with 0, the network would hardly learn from them.
const WHITENING: f64 = 0.6;

pub struct Basis {
    pub features: Vec<usize>,
    pub map: DMatrix<f32>,
}

impl Basis {
    pub fn of(design: &Design, scale: &Scale, features: Vec<usize>, count: usize) -> Result<Self> {
        let (gram, _) = design.moments(&features, scale)?;
        let eigen = gram.symmetric_eigen();
        let mut order: Vec<usize> = (0..features.len()).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        order.truncate(count);
        let deviation = |index: usize| eigen.eigenvalues[index].max(0.0).sqrt();
        let least = MIN_RELATIVE_DEVIATION * deviation(order[0]);
        let map = DMatrix::from_fn(order.len(), features.len(), |row, column| {
            let component = order[row];
            let divisor = deviation(component).max(least).powf(WHITENING);
            (eigen.eigenvectors[(column, component)] / divisor) as f32
        });
        Ok(Self { features, map })
    }
}

// Selects the landmarks that the model uses (`S` in eq. 4 of the paper).
//
// Backward elimination: repeatedly leaves out the landmarks without which a linear fit of all blendshapes together
// loses least. Selecting by correlation alone gives the same few points many times over.

const AXES: usize = 3;
/// One in this many landmarks is left out at a time.
const PART: usize = 6;
const RIDGE: f64 = 0.003;

/// Returns the features of the `count` best landmarks, together with all distances and the features of head rotation.
pub fn select(design: &Design, scale: &Scale, count: usize) -> Result<Vec<usize>> {
    let all: Vec<usize> = (0..FEATURES).collect();
    let (gram, cross) = design.moments(&all, scale)?;
    let mut landmarks: Vec<usize> = (0..LANDMARKS).collect();
    while landmarks.len() > count {
        let mut losses = losses(&gram, &cross, &landmarks)?;
        let dropped = (landmarks.len() / PART).clamp(1, landmarks.len() - count);
        losses.sort_by(|a, b| a.1.total_cmp(&b.1));
        let worst: Vec<usize> = losses.iter().take(dropped).map(|(landmark, _)| *landmark).collect();
        landmarks.retain(|landmark| !worst.contains(landmark));
    }
    Ok(features_of(&landmarks))
}

fn features_of(landmarks: &[usize]) -> Vec<usize> {
    let coordinates = landmarks.iter().flat_map(|landmark| (0..AXES).map(move |axis| AXES * landmark + axis));
    coordinates.chain(AXES * LANDMARKS..FEATURES).collect()
}

/// Returns by how much the squared error of the linear fit on these landmarks grows if one of them is left out:
/// `tr(w' (A^-1)_gg^-1 w)`, where `w` are the landmark's weights and `A` the second moments of all features.
fn losses(gram: &DMatrix<f64>, cross: &DMatrix<f64>, landmarks: &[usize]) -> Result<Vec<(usize, f64)>> {
    let features = features_of(landmarks);
    let mut gram = gram.select_rows(&features).select_columns(&features);
    (0..features.len()).for_each(|index| gram[(index, index)] += RIDGE);
    let inverse = gram.cholesky().context("the features are degenerate")?.inverse();
    let weights = &inverse * cross.select_rows(&features);
    let loss = |(index, landmark): (usize, &usize)| {
        let own = inverse.fixed_view::<AXES, AXES>(AXES * index, AXES * index).into_owned();
        let weights = weights.rows(AXES * index, AXES);
        let solved = own.cholesky().map(|own| own.solve(&weights.into_owned()));
        (*landmark, solved.map_or(f64::INFINITY, |solved| weights.dot(&solved)))
    };
    Ok(landmarks.iter().enumerate().map(loss).collect())
}

// Mirrored copies of the training faces: twice the data, and neither side of the face is favoured.
//
// Without the copies, the model for an unknown neutral face is far worse on mirrored faces (r 0.51 instead of 0.65),
// because it learns the asymmetry of the training faces.

pub fn with_mirrored(samples: &[Sample]) -> Result<Vec<Sample>> {
    let points = mirrored_points(samples)?;
    let seen = samples.iter().filter(|sample| !sample.held_out());
    let copies = seen.clone().map(|sample| mirror(sample, &points));
    Ok(seen.cloned().chain(copies).collect())
}

fn mirror(sample: &Sample, points: &[usize; LANDMARKS]) -> Sample {
    let flipped = |index: usize| {
        let [x, y, z] = sample.landmarks.0[index];
        [-x, y, z]
    };
    let [yaw, pitch, roll] = sample.pose_deg;
    Sample {
        landmarks: Landmarks(points.map(flipped)),
        truth: MIRRORED.map(|index| sample.truth[index]),
        pose_deg: [-yaw, pitch, -roll],
        mirrored: !sample.mirrored,
        ..*sample
    }
}

/// Returns the opposite of each landmark, from the mean of all pictures, in which the lips do not coincide.
fn mirrored_points(samples: &[Sample]) -> Result<[usize; LANDMARKS]> {
    let mut mean = Box::new([[0.0_f32; 3]; LANDMARKS]);
    for sample in samples.iter().filter(|sample| !sample.held_out()) {
        let face = normalise(&sample.landmarks)?;
        mean.iter_mut().flatten().zip(face.points.iter().flatten()).for_each(|(sum, value)| *sum += value);
    }
    let pairs = pair_up(&mean);
    let crossed = |(a, b): (usize, &usize)| a != *b && mean[a][0] * mean[*b][0] > 0.0;
    ensure!(!pairs.iter().enumerate().any(crossed), "the mean face is not symmetric: check the order of the landmarks");
    Ok(pairs)
}

/// Pairs each point with the one nearest to its mirror image, the closest first. Some are paired with themselves.
fn pair_up(points: &[[f32; 3]; LANDMARKS]) -> [usize; LANDMARKS] {
    let gap = |a: &[f32; 3], b: &[f32; 3]| (a[0] + b[0]).powi(2) + (a[1] - b[1]).powi(2) + (a[2] - b[2]).powi(2);
    let all = (0..LANDMARKS).flat_map(|a| (a..LANDMARKS).map(move |b| (a, b)));
    let mut gaps: Vec<_> = all.map(|(a, b)| (gap(&points[a], &points[b]), a, b)).collect();
    gaps.sort_by(|one, other| one.0.total_cmp(&other.0));
    let mut partner = [None; LANDMARKS];
    for (_, a, b) in gaps {
        if partner[a].is_none() && partner[b].is_none() {
            (partner[a], partner[b]) = (Some(b), Some(a));
        }
    }
    core::array::from_fn(|index| partner[index].unwrap_or(index))
}
