//! Selects the landmarks that the model uses (`S` in eq. 4 of the paper).
//!
//! Backward elimination: repeatedly leaves out the landmarks without which a linear fit of all blendshapes together
//! loses least. Selecting by correlation alone gives the same few points many times over.

use anyhow::{Context, Result};
use facewire::{face::LANDMARKS, solve::FEATURES};
use nalgebra::DMatrix;

use crate::design::{Design, Scale};

/// Coordinates per landmark.
const AXES: usize = 3;
/// One in this many landmarks is left out at a time.
const PART: usize = 6;
/// Ridge penalty, relative to the variance of a standardised feature.
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
