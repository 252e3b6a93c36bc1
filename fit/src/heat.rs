//! How much each landmark of the face moves with a blendshape (the paper's figure of the correlation for `JawOpen`).

use anyhow::{Context, Result};
use facewire::face::LANDMARKS;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::{
    judge::Faces,
    statistics::{Directions, mean, pearson},
};

/// Coordinates of the landmarks of some pictures.
pub struct Landmarks {
    /// Mean place of each landmark: x to the person's left, y up, eye distances.
    pub places: Vec<[f64; 2]>,
    /// Displacement from the neutral face by picture, three columns a landmark.
    displacements: DMatrix<f64>,
    /// What the three columns of each landmark span.
    directions: Vec<Directions>,
}

impl Landmarks {
    /// Of pictures `rows`, with the subjects' neutral faces known and not known. The first features are the coordinates.
    pub fn new(known: &Faces, unknown: &Faces, rows: &[usize]) -> Result<Self> {
        let mean_of = |column: usize| mean(rows.iter().map(|row| f64::from(unknown.values(*row)[column])));
        let places = (0..LANDMARKS).map(|landmark| [3 * landmark, 3 * landmark + 1].map(mean_of)).collect();
        let displacement = |row: usize, column: usize| f64::from(known.values(rows[row])[column]);
        let displacements = DMatrix::from_fn(rows.len(), 3 * LANDMARKS, displacement);
        let of = |landmark: usize| Directions::of(&displacements.columns(3 * landmark, 3).into_owned());
        let directions = (0..LANDMARKS).into_par_iter().map(of).collect::<Option<_>>();
        Ok(Self { places, displacements, directions: directions.context("the coordinates have no directions")? })
    }

    /// Multiple correlation of each landmark's three coordinates with the truth: 0 to 1.
    pub fn correlations(&self, truth: &[f64]) -> Vec<f64> {
        self.directions.iter().map(|own| own.explain(truth).map_or(0.0, f64::sqrt)).collect()
    }

    /// `(truth, displacement)` of a landmark, along the axis that has most to do with the truth.
    pub fn movement(&self, landmark: usize, truth: &[f64]) -> Vec<(f64, f64)> {
        let axes = [0, 1, 2].map(|axis| self.displacements.column(3 * landmark + axis).iter().copied().collect());
        let most = |a: &Vec<f64>, b: &Vec<f64>| pearson(a, truth).abs().total_cmp(&pearson(b, truth).abs());
        let along = axes.into_iter().max_by(most).unwrap_or_default();
        truth.iter().copied().zip(along).collect()
    }
}
