//! Fits the layer that reads how a face looks to what the landmark model leaves unexplained.
//!
//! The landmark model stays as it is: if both are trained together, they learn how this renderer shades a face, and fail
//! on real ones. For the same reason each input gets noise as large as its own deviation. The units are linear: with this
//! noise, rectified ones are worse on unseen people, and pass on more of the camera's noise. The layer has one set of outputs
//! for a known neutral face and one for an unknown one, so that every picture is read once. There are no mirrored
//! pictures, because the map of a mirrored picture is not a mirrored map.

use anyhow::{Result, ensure};
use facewire_face::model::{APPEARANCE_LANDMARKS, APPEARANCE_UNITS, AppearanceTable, Cases, ResidualRow};
use facewire_face::{BLENDSHAPES, Model};
use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::dataset::{Appearances, Sample};
use crate::faces::Faces;
use crate::network::{Batch, Examples, Network, Training, Units, importance, noise, number, numbers};
use crate::shapes::MODELLED;

/// Deviation of the noise on each input, in deviations of the input.
const NOISE: f32 = 1.0;
/// Smallest deviation of a value, by which its differences from the mean are divided.
const LEAST_DEVIATION: f32 = 0.01;
/// Passes over the pictures: more for a small dataset, until about [`LEAST_FACES`] faces have been read.
const EPOCHS: usize = 30;
const LEAST_FACES: usize = 600_000;
const RATE: f32 = 1e-3;
const SEED: u64 = 2;
const BLOCK: usize = 1024;

pub fn fit(samples: &[Sample], appearances: &Appearances, model: &Model) -> Result<AppearanceTable> {
    let faces = Residuals::new(samples, appearances, model)?;
    ensure!(!faces.pictures.is_empty(), "all pictures are held out");
    let epochs = EPOCHS.max(LEAST_FACES / faces.pictures.len());
    let progress = |epoch| eprint!("\rappearance: epoch {epoch} of {epochs}");
    let training =
        Training { hidden: APPEARANCE_UNITS, units: Units::Linear, start: 0.1, rate: RATE, epochs, seed: SEED };
    let network = Network::train(&faces, &training, progress);
    eprintln!();
    Ok(table(&network, &faces))
}

struct Residuals<'a> {
    appearances: &'a Appearances,
    pictures: Vec<usize>,
    mean: Vec<f32>,
    scale: Vec<f32>,
    /// Coefficients of the landmark model with the neutral face known, then without, one column per face.
    start: DMatrix<f32>,
    truth: DMatrix<f32>,
    importance: Vec<f32>,
}

impl<'a> Residuals<'a> {
    fn new(samples: &[Sample], appearances: &'a Appearances, model: &Model) -> Result<Self> {
        let rows: Vec<usize> = (0..samples.len()).filter(|row| !samples[*row].held_out()).collect();
        let pictures: Vec<usize> = rows.iter().map(|row| samples[*row].picture).collect();
        let (mean, scale) = moments(appearances, &pictures);
        let mut start = DMatrix::zeros(2 * MODELLED, pictures.len());
        for (first, neutral_known) in [(0, true), (MODELLED, false)] {
            let faces = Faces::new(samples, neutral_known)?;
            for (mut column, row) in start.column_iter_mut().zip(&rows) {
                let raw = faces.of_landmarks(model, *row)?;
                column.rows_mut(first, MODELLED).copy_from_slice(&raw.0[..MODELLED]);
            }
        }
        let truth = |row: usize, face: usize| samples[rows[face]].truth[row % MODELLED] as f32;
        let truth = DMatrix::from_fn(2 * MODELLED, pictures.len(), truth);
        let importance = importance(&truth);
        Ok(Self { appearances, pictures, mean, scale, start, truth, importance })
    }
}

fn moments(appearances: &Appearances, pictures: &[usize]) -> (Vec<f32>, Vec<f32>) {
    let sums = |block: &[usize]| {
        let mut sums = vec![[0.0_f64; 2]; Appearances::VALUES];
        let mut values = vec![0.0; Appearances::VALUES];
        for picture in block {
            appearances.copy(*picture, &mut values);
            for ([sum, squares], value) in sums.iter_mut().zip(&values) {
                *sum += f64::from(*value);
                *squares += f64::from(*value) * f64::from(*value);
            }
        }
        sums
    };
    let blocks: Vec<_> = pictures.par_chunks(BLOCK).map(sums).collect();
    let count = pictures.len() as f64;
    let moments = |value: usize| {
        let [sum, squares] = blocks.iter().fold([0.0; 2], |[a, b], block| [a + block[value][0], b + block[value][1]]);
        let mean = sum / count;
        let deviation = (squares / count - mean * mean).max(0.0).sqrt() as f32;
        (mean as f32, 1.0 / deviation.max(LEAST_DEVIATION))
    };
    (0..Appearances::VALUES).map(moments).unzip()
}

impl Examples for Residuals<'_> {
    fn size(&self) -> [usize; 2] {
        [self.pictures.len(), Appearances::VALUES]
    }

    fn importance(&self) -> &[f32] {
        &self.importance
    }

    fn batch(&self, faces: &[usize], random: &mut fastrand::Rng) -> Batch {
        let mut inputs = DMatrix::zeros(Appearances::VALUES, faces.len());
        for (column, face) in inputs.as_mut_slice().chunks_exact_mut(Appearances::VALUES).zip(faces) {
            self.appearances.copy(self.pictures[*face], column);
            for ((value, mean), scale) in column.iter_mut().zip(&self.mean).zip(&self.scale) {
                *value = (*value - mean) * scale + NOISE * noise(random);
            }
        }
        let (start, truth) = (self.start.select_columns(faces), self.truth.select_columns(faces));
        Batch { inputs, start: Some(start), truth }
    }
}

/// Rounds the weights to 8 bits and stores the network for values that are not standardised.
fn table(network: &Network, faces: &Residuals) -> AppearanceTable {
    // One column for each value of the map.
    let mut weights = network.w.clone();
    for (mut column, scale) in weights.column_iter_mut().zip(&faces.scale) {
        column *= *scale;
    }
    let scales: Vec<f32> = weights.row_iter().map(|row| (row.amax() / 127.0).max(f32::MIN_POSITIVE)).collect();
    let bytes = |value: usize| core::array::from_fn(|unit| (weights[(unit, value)] / scales[unit]).round() as i8);
    let bytes: Vec<[i8; APPEARANCE_UNITS]> = (0..Appearances::VALUES).map(bytes).collect();
    // The rounded weights serve the mean, so that rounding does not shift the units.
    let offset = |unit: usize| {
        let sum = bytes.iter().zip(&faces.mean).map(|(row, mean)| f64::from(row[unit]) * f64::from(*mean)).sum::<f64>();
        f64::from(network.a[unit]) - sum * f64::from(scales[unit])
    };
    let landmarks = APPEARANCE_LANDMARKS.iter().zip(bytes.chunks(Appearances::VALUES / APPEARANCE_LANDMARKS.len()));
    let residual =
        |first: usize| ResidualRow { offset: number(network.b[first]), weights: numbers(network.v.row(first).iter()) };
    let residuals =
        |shape: usize| Cases { neutral_known: residual(shape), neutral_unknown: residual(MODELLED + shape) };
    AppearanceTable {
        scales: scales.iter().map(|scale| f64::from(*scale)).collect(),
        offsets: (0..APPEARANCE_UNITS).map(offset).collect(),
        landmarks: landmarks.map(|(name, rows)| (name.to_string(), AppearanceTable::encode(rows))).collect(),
        blendshapes: (0..MODELLED).map(|shape| (BLENDSHAPES[shape].to_owned(), residuals(shape))).collect(),
    }
}
