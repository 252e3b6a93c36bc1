//! How strongly each landmark moves with a blendshape, as in the paper's figure of the correlation with `JawOpen`.

use anyhow::{Context, Result};
use facewire_face::LANDMARKS;
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::judge::Faces;
use crate::statistics::{ColumnSpace, mean, pearson};

pub struct LandmarkMotion {
    /// Mean position of each landmark in eye distances: x to the person's left, y up.
    pub positions: Vec<[f64; 2]>,
    /// Displacement from the neutral face: a row per picture, three columns per landmark.
    displacements: DMatrix<f64>,
    column_spaces: Vec<ColumnSpace>,
}

impl LandmarkMotion {
    /// Collects the motion in pictures `rows`. The first features of a face are the coordinates of its landmarks.
    pub fn new(known: &Faces, unknown: &Faces, rows: &[usize]) -> Result<Self> {
        let mean_of = |column: usize| mean(rows.iter().map(|row| f64::from(unknown.values(*row)[column])));
        let positions = (0..LANDMARKS).map(|landmark| [3 * landmark, 3 * landmark + 1].map(mean_of)).collect();
        let displacement = |row: usize, column: usize| f64::from(known.values(rows[row])[column]);
        let displacements = DMatrix::from_fn(rows.len(), 3 * LANDMARKS, displacement);
        let of = |landmark: usize| ColumnSpace::of(&displacements.columns(3 * landmark, 3).into_owned());
        let column_spaces = (0..LANDMARKS).into_par_iter().map(of).collect::<Option<_>>();
        Ok(Self { positions, displacements, column_spaces: column_spaces.context("the landmarks do not move")? })
    }

    /// Returns the multiple correlation, from 0 to 1, of each landmark's three coordinates with the truth.
    pub fn correlations(&self, truth: &[f64]) -> Vec<f64> {
        self.column_spaces.iter().map(|own| own.explain(truth).map_or(0.0, f64::sqrt)).collect()
    }

    /// Returns pairs (truth, displacement) of a landmark along the axis that correlates best with the truth.
    pub fn movement(&self, landmark: usize, truth: &[f64]) -> Vec<(f64, f64)> {
        let axes = [0, 1, 2].map(|axis| self.displacements.column(3 * landmark + axis).iter().copied().collect());
        let most = |a: &Vec<f64>, b: &Vec<f64>| pearson(a, truth).abs().total_cmp(&pearson(b, truth).abs());
        let along = axes.into_iter().max_by(most).unwrap_or_default();
        truth.iter().copied().zip(along).collect()
    }
}
