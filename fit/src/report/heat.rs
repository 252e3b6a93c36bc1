//! How much each landmark of the face moves with a blendshape (the paper's figure of the correlation for `JawOpen`).

use facewire::face::LANDMARKS;
use nalgebra::DMatrix;
use rayon::prelude::*;

use super::Judged;
use crate::statistics::{explained, mean, pearson};

/// Coordinates of the judged faces.
pub struct Landmarks {
    /// Mean place of each landmark: x to the person's left, y up, eye distances.
    pub places: Vec<[f64; 2]>,
    /// Displacement from the neutral face by picture, three columns a landmark.
    displacements: DMatrix<f64>,
}

impl Landmarks {
    /// Of the judged pictures. The first features are the coordinates of the landmarks.
    pub fn new(judged: &Judged) -> Self {
        let rows = &judged.rows;
        let mean_of = |column: usize| mean(rows.iter().map(|row| f64::from(judged.unknown.values(*row)[column])));
        let places = (0..LANDMARKS).map(|landmark| [3 * landmark, 3 * landmark + 1].map(mean_of)).collect();
        let displacement = |row: usize, column: usize| f64::from(judged.known.values(rows[row])[column]);
        Self { places, displacements: DMatrix::from_fn(rows.len(), 3 * LANDMARKS, displacement) }
    }

    /// Multiple correlation of each landmark's three coordinates with the truth: 0 to 1.
    pub fn correlations(&self, truth: &[f64]) -> Vec<f64> {
        let one = |landmark: usize| {
            let columns = self.displacements.columns(3 * landmark, 3).into_owned();
            explained(&columns, truth).map_or(0.0, |(r_squared, _)| r_squared.sqrt())
        };
        (0..LANDMARKS).into_par_iter().map(one).collect()
    }

    /// `(truth, displacement)` of a landmark, along the axis that has most to do with the truth.
    pub fn movement(&self, landmark: usize, truth: &[f64]) -> Vec<(f64, f64)> {
        let axes = [0, 1, 2].map(|axis| self.displacements.column(3 * landmark + axis).iter().copied().collect());
        let most = |a: &Vec<f64>, b: &Vec<f64>| pearson(a, truth).abs().total_cmp(&pearson(b, truth).abs());
        let along = axes.into_iter().max_by(most).unwrap_or_default();
        truth.iter().copied().zip(along).collect()
    }
}
