//! Fits the map from points of the eyes to where they look.
//!
//! A few points carry over from rendered faces to real ones, where many do not. Rare directions count for more than their
//! number: with plain least squares, the eyes that look ahead, as most do, would make all movements small.

use anyhow::{Context, Result};
use facewire_face::Gaze;
use facewire_face::model::{Cases, FeatureId, GazeTable, InputTable};
use nalgebra::{SMatrix, SVector};

use crate::curves::LIDS;
use crate::design::{Design, Scale};
use crate::network::number;

/// Lids, irises and corners of both eyes, and how the head is turned.
const INPUTS: [&str; 19] = [
    "y159", "y145", "y386", "y374", "x468", "y468", "x33", "y33", "x133", "y133", "x473", "y473", "x263", "y263",
    "x362", "y362", "yaw", "pitch", "roll",
];
/// A column for each input, one that says whether the neutral face is known, and one of ones.
const COLUMNS: usize = INPUTS.len() + 2;
const BAND_DEG: f32 = 5.0;
const BANDS: usize = 7;
/// An error weighs its band's share of the faces to this power, for yaw and for pitch, which the lids show as well.
const BAND_WEIGHT_POWERS: [f64; 2] = [-0.7, -0.4];
const RIDGE: f64 = 1e-4;
/// Faces with a lid that is further shut than this do not count.
pub const SHUT: f64 = 0.5;

pub fn fit(design: &Design, scale: &Scale) -> Result<GazeTable> {
    let ids: Vec<FeatureId> = INPUTS.iter().filter_map(|name| FeatureId::from_name(name)).collect();
    let features: Vec<usize> = ids.iter().map(|id| id.index()).collect();
    let is_open = |face: &usize| LIDS.iter().all(|lid| f64::from(design.coefficients(*face).0[*lid]) <= SHUT);
    let faces: Vec<usize> = (0..design.len()).filter(is_open).collect();
    let inputs = design.columns(&faces, &features, scale);
    let column = |(index, face): (usize, &usize)| {
        let known = f64::from(u8::from(design.is_known(*face)));
        let values = inputs.column(index).into_iter().map(|value| f64::from(*value)).chain([known, 1.0]);
        SVector::<f64, COLUMNS>::from_iterator(values)
    };
    let columns: Vec<_> = faces.iter().enumerate().map(column).collect();
    let truths: Vec<[f32; 2]> = faces.iter().map(|face| Gaze::of(&design.coefficients(*face)).yaw_pitch_deg).collect();
    let [yaw, pitch] = [0, 1].map(|axis| least_squares(&columns, &truths, axis));
    let weights = [yaw?, pitch?];
    let mut table = GazeTable::default();
    let mut unknown = weights.map(|weights| weights[COLUMNS - 1]);
    for (index, (id, feature)) in ids.iter().zip(&features).enumerate() {
        let own = weights.map(|weights| weights[index] / f64::from(scale.deviation[*feature]));
        unknown.iter_mut().zip(own).for_each(|(sum, weight)| *sum -= weight * f64::from(scale.mean[*feature]));
        let weights = own.map(|weight| number(weight as f32)).into();
        table.inputs.insert(id.to_string(), InputTable { neutral: number(design.neutral[*feature]), weights });
    }
    let known = [0, 1].map(|axis: usize| unknown[axis] + weights[axis][COLUMNS - 2]);
    let offsets = |offsets: [f64; 2]| offsets.map(|offset| number(offset as f32)).to_vec();
    table.offsets = Cases { neutral_known: offsets(known), neutral_unknown: offsets(unknown) };
    Ok(table)
}

/// Returns the weights of the columns for yaw (`axis` 0) or pitch.
fn least_squares(columns: &[SVector<f64, COLUMNS>], truths: &[[f32; 2]], axis: usize) -> Result<SVector<f64, COLUMNS>> {
    let band = |truth: &[f32; 2]| ((truth[axis].abs() / BAND_DEG) as usize).min(BANDS - 1);
    let mut counts = [0.0_f64; BANDS];
    truths.iter().for_each(|truth| counts[band(truth)] += 1.0);
    let (mut gram, mut cross) = (SMatrix::<f64, COLUMNS, COLUMNS>::zeros(), SVector::zeros());
    for (column, truth) in columns.iter().zip(truths) {
        let weight = (counts[band(truth)] / truths.len() as f64).powf(BAND_WEIGHT_POWERS[axis]);
        gram.ger(weight, column, column, 1.0);
        cross += weight * f64::from(truth[axis]) * column;
    }
    let ridge = RIDGE * gram[(COLUMNS - 1, COLUMNS - 1)];
    (0..INPUTS.len()).for_each(|index| gram[(index, index)] += ridge);
    Ok(gram.cholesky().context("the eyes never move in these faces")?.solve(&cross))
}
