//! Eq. 3 and 5: what each step towards the face's own basis is worth, and the transformations of its features.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use facewire_face::model::MEASURES;
use facewire_face::stages::normalise;
use facewire_face::{BLENDSHAPES, LANDMARKS, Landmarks};
use nalgebra::{DMatrix, Rotation3, Vector3};
use rayon::prelude::*;

use crate::dataset::{Person, Sample};
use crate::faces::Faces;
use crate::kinds::Predictor;
use crate::kinds::formula::{TINY, least_squares};
use crate::segments::Pictures;
use crate::shapes::index_of;
use crate::statistics::{mean, mse, pearson, subsample};

/// The blendshapes that stand for all.
pub const SHAPES: [&str; 6] = ["jawOpen", "eyeBlinkLeft", "mouthSmileLeft", "browInnerUp", "mouthPucker", "cheekPuff"];
/// How many features a regression takes: as many as the paper's figure 6 has vectors.
pub const FEATURES: usize = 8;

/// The corners of the person's right and left eye, and the tip of the nose.
pub const EYES: [[usize; 2]; 2] = [[33, 133], [362, 263]];
pub const NOSE: usize = 4;

pub type Points = Vec<Vector3<f64>>;

pub const STEPS: [&str; 5] = ["raw", "R1", "R2 R1", "R3 R2 R1", "as facewire has it: fitted to 32 points"];

/// Applies R1, R2 and R3 of the paper in turn. R1 moves the origin between the eyes and makes their distance 1; R2 turns the
/// line through the eyes onto x; R3 turns about x until the nose lies in the plane of the screen through the eyes.
pub fn steps(landmarks: &Landmarks) -> Result<[Points; 5]> {
    let raw: Points = landmarks.0.iter().map(|[x, y, z]| Vector3::new(*x, -*y, -*z).cast::<f64>()).collect();
    let eye = |points: &Points, corners: [usize; 2]| (points[corners[0]] + points[corners[1]]) / 2.0;
    let [right, left] = EYES.map(|corners| eye(&raw, corners));
    let (origin, distance) = ((right + left) / 2.0, (left - right).norm());
    let first: Points = raw.iter().map(|point| (point - origin) / distance).collect();
    let level = Rotation3::rotation_between(&eye(&first, EYES[1]), &Vector3::x()).context("the eyes coincide")?;
    let second: Points = first.iter().map(|point| level * point).collect();
    let nose = second[NOSE];
    // The nose lies below the eyes.
    let upright = Rotation3::from_axis_angle(&Vector3::x_axis(), nose.z.atan2(-nose.y));
    let third: Points = second.iter().map(|point| upright * point).collect();
    let own = normalise(landmarks)?.points;
    Ok([raw, first, second, third, own.iter().map(|point| Vector3::from(*point).cast()).collect()])
}

/// For each step the points of every picture.
pub struct Basis {
    pub faces: Vec<[Points; 5]>,
}

impl Basis {
    pub fn new(samples: &[Sample]) -> Result<Self> {
        Ok(Self { faces: samples.par_iter().map(|sample| steps(&sample.landmarks)).collect::<Result<_>>()? })
    }

    fn neutral(&self, samples: &[Sample], step: usize) -> BTreeMap<Person, Points> {
        let mut sums: BTreeMap<Person, (Points, f64)> = BTreeMap::new();
        for (sample, steps) in samples.iter().zip(&self.faces).filter(|own| own.0.neutral) {
            let own = sums.entry(sample.person()).or_insert_with(|| (vec![Vector3::zeros(); LANDMARKS], 0.0));
            own.0.iter_mut().zip(&steps[step]).for_each(|(sum, point)| *sum += point);
            own.1 += 1.0;
        }
        sums.into_iter().map(|(person, (sum, count))| (person, sum.into_iter().map(|p| p / count).collect())).collect()
    }

    /// Displacements of all landmarks from the person's neutral face after a step: a row per picture.
    pub fn displacements(&self, samples: &[Sample], step: usize) -> Result<DMatrix<f64>> {
        let neutral = self.neutral(samples, step);
        let mut rows = Vec::with_capacity(samples.len() * 3 * LANDMARKS);
        for (sample, steps) in samples.iter().zip(&self.faces) {
            let rest = neutral.get(&sample.person()).context("a subject has no neutral picture")?;
            rows.extend(steps[step].iter().zip(rest).flat_map(|(point, rest)| <[f64; 3]>::from(point - rest)));
        }
        Ok(DMatrix::from_row_iterator(samples.len(), 3 * LANDMARKS, rows))
    }

    /// How far landmarks lie from their places in the neutral face: the root mean square, in eye distances.
    pub fn spread(&self, samples: &[Sample], step: usize) -> Result<f64> {
        let moved = self.displacements(samples, step)?;
        let size = |row: usize| {
            if step > 0 {
                return 1.0;
            }
            let points = &self.faces[row][0];
            let [right, left] = EYES.map(|[a, b]| (points[a] + points[b]) / 2.0);
            (left - right).norm().powi(2)
        };
        let squares = (0..samples.len()).map(|row| moved.row(row).norm_squared() / LANDMARKS as f64 / size(row));
        Ok(mean(squares).sqrt())
    }
}

/// Scales a matrix's columns by the spread of the rows that a fit sees.
fn standardised(features: &DMatrix<f64>, seen: &[usize], columns: &[usize]) -> DMatrix<f64> {
    let mut chosen = features.select_columns(columns);
    for mut column in chosen.column_iter_mut() {
        let own = seen.iter().map(|row| column[*row]).collect::<Vec<_>>();
        let (centre, deviation) = (mean(own.iter().copied()), crate::statistics::standard_deviation(&own).max(1e-12));
        column.apply(|value| *value = (*value - centre) / deviation);
    }
    chosen
}

/// Returns r and MSE, on held-out pictures, of a linear fit to the features that correlate best with the truth; or to the
/// first ones if their order says which matter.
pub fn judged(features: &DMatrix<f64>, pictures: &Pictures, shape: usize, is_ordered: bool) -> Result<[f64; 2]> {
    let [own, other] = [&pictures.seen, &pictures.held_out].map(|rows| pictures.known.truth(shape, rows));
    let mut order: Vec<usize> = (0..features.ncols()).collect();
    if !is_ordered {
        let of = |column: &usize| {
            let values: Vec<f64> = pictures.seen.iter().map(|row| features[(*row, *column)]).collect();
            pearson(&values, &own).abs()
        };
        let strength: Vec<f64> = order.par_iter().map(of).collect();
        order.sort_by(|a, b| strength[*b].total_cmp(&strength[*a]));
    }
    order.truncate(FEATURES);
    let scaled = standardised(features, &pictures.seen, &order);
    let fitted = least_squares(&scaled.select_rows(&pictures.seen), &own, TINY)?;
    let estimate = |row: &usize| fitted.predict(&scaled.row(*row).iter().copied().collect::<Vec<_>>()).clamp(0.0, 1.0);
    let estimates: Vec<f64> = pictures.held_out.iter().map(estimate).collect();
    Ok([pearson(&estimates, &other), mse(&estimates, &other)])
}

/// Pictures from which the principal components are found.
const COMPONENT_PICTURES: usize = 400;

/// The scores of the first principal components of the displacements of all landmarks.
pub fn components(displacements: &DMatrix<f64>, seen: &[usize]) -> Result<DMatrix<f64>> {
    let some = displacements.select_rows(&subsample(seen, COMPONENT_PICTURES));
    let centre = some.row_mean();
    let mut centred = some.clone();
    centred.row_iter_mut().for_each(|mut row| row -= &centre);
    // The directions follow from the products of pictures, of which there are fewer than coordinates.
    let decomposed = (&centred * centred.transpose()).symmetric_eigen();
    let mut order: Vec<usize> = (0..decomposed.eigenvalues.len()).collect();
    order.sort_by(|a, b| decomposed.eigenvalues[*b].total_cmp(&decomposed.eigenvalues[*a]));
    order.truncate(FEATURES);
    let mut directions = centred.transpose() * decomposed.eigenvectors.select_columns(&order);
    directions.column_iter_mut().for_each(|mut column| _ = column.normalize_mut());
    Ok(displacements * directions)
}

/// Distances of anchor points as they are, and less those of the neutral face.
fn distances(known: &Faces, unknown: &Faces, row: usize) -> (Vec<f64>, Vec<f64>) {
    let own = |faces: &Faces| faces.values(row)[3 * LANDMARKS..MEASURES].iter().map(|v| f64::from(*v)).collect();
    let (moved, seen): (Vec<f64>, Vec<f64>) = (own(known), own(unknown));
    let rest = seen.iter().zip(&moved).map(|(seen, moved)| seen - moved).collect();
    (seen, rest)
}

/// Ratios of all pairs of distances of anchor points, less those of the neutral face.
pub fn aspect_ratios(known: &Faces, unknown: &Faces) -> DMatrix<f64> {
    let row = |row: usize| {
        let (seen, rest) = distances(known, unknown, row);
        let ratio = |values: &[f64], a: usize, b: usize| values[a] / values[b].max(1e-3);
        let pairs = (0..seen.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
        pairs.map(|(a, b)| ratio(&seen, a, b) - ratio(&rest, a, b)).collect::<Vec<_>>()
    };
    let rows: Vec<Vec<f64>> = (0..known.len()).into_par_iter().map(row).collect();
    DMatrix::from_row_iterator(rows.len(), rows[0].len(), rows.iter().flatten().copied())
}

pub fn anchor_distances(known: &Faces) -> DMatrix<f64> {
    DMatrix::from_fn(known.len(), MEASURES - 3 * LANDMARKS, |row, at| f64::from(known.values(row)[3 * LANDMARKS + at]))
}

/// The shapes of [`SHAPES`] that move in these pictures.
pub fn moving(pictures: &Pictures) -> Result<Vec<usize>> {
    pictures.known.moving(&SHAPES.map(index_of), &[&pictures.seen, &pictures.held_out])
}

/// The r and the MSE of each feature set and shape: names, a row of results for each set.
pub fn compared(
    sets: &[(&'static str, &DMatrix<f64>, bool)],
    pictures: &Pictures,
    shapes: &[usize],
) -> Result<Vec<Vec<[f64; 2]>>> {
    let one = |(_, features, is_ordered): &(&str, &DMatrix<f64>, bool)| {
        shapes.iter().map(|shape| judged(features, pictures, *shape, *is_ordered)).collect()
    };
    sets.iter().map(one).collect()
}

/// The heads of a table whose rows are [`compared`]: the means first.
pub fn heads(first: &str, shapes: &[usize]) -> Vec<String> {
    let of = |shape: &usize| ["r", "MSE"].map(|figure| format!("{} {figure}", BLENDSHAPES[*shape]));
    let means = ["mean r", "mean MSE"].map(str::to_owned);
    [first.to_owned()].into_iter().chain(means).chain(shapes.iter().flat_map(of)).collect()
}
