//! What a kind of model makes of the judged pictures, for one blendshape: all that a report needs to know of it.
//!
//! A kind of model is anything that can fill in [`Fitted`]; [`shipped`] does it for the model that facewire runs.

use std::collections::BTreeMap;

use anyhow::{Context, Result};
use facewire::solve::{BLENDSHAPES, COEFFS, model_file::ModelFile};

use crate::judge::{Faces, estimates, regression_ns};

/// Bytes of a weight in memory, with what it multiplies.
const WEIGHT_BYTES: usize = 8;
/// The entry of a model file that multiplies nothing.
const BIAS: &str = "bias";

/// A model of one blendshape, after it has seen the judged pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// What kind of model it is, in a few words.
    pub kind: &'static str,
    /// Place in [`BLENDSHAPES`].
    pub blendshape: usize,
    /// Its coefficient for every judged picture, in the order of the truth.
    pub predictions: Vec<f64>,
    /// Fitted weights beside the constant.
    pub degrees_of_freedom: usize,
    /// Memory it takes.
    pub bytes: usize,
    /// Time it takes for one face, on this machine.
    pub nanoseconds: f64,
}

/// A map of a model file: weights by blendshape.
type Map = BTreeMap<String, facewire::solve::model_file::BlendshapeTable>;

/// The shipped model with the neutral face known and not known, and its first step alone.
pub fn shipped(file: &ModelFile, known: &Faces, unknown: &Faces, rows: &[usize]) -> Result<Vec<Fitted>> {
    let alone = first_step(file);
    let kinds = [
        ("shipped, neutral known", file, &file.neutral_known, known),
        ("shipped, neutral not known", file, &file.neutral_unknown, unknown),
        ("its linear step alone, neutral known", &alone, &alone.neutral_known, known),
    ];
    let fitted = kinds.map(|(kind, file, map, faces)| of_kind(kind, file, map, (faces, rows)));
    Ok(fitted.into_iter().collect::<Result<Vec<_>>>()?.concat())
}

/// A model that passes the clipped estimates on as they are.
fn first_step(file: &ModelFile) -> ModelFile {
    let mut alone = file.clone();
    for (name, table) in alone.neutral_known.iter_mut().chain(&mut alone.neutral_unknown) {
        table.polynomial = BTreeMap::from([(name.clone(), 1.0)]);
    }
    alone
}

fn of_kind(kind: &'static str, file: &ModelFile, map: &Map, (faces, rows): (&Faces, &[usize])) -> Result<Vec<Fitted>> {
    let model = file.to_model()?;
    let predictions = estimates(&model, faces, rows)?;
    let nanoseconds = regression_ns(&model, faces, rows)? / COEFFS as f64;
    let one = |(blendshape, predictions): (usize, Vec<f64>)| {
        let table = map.get(BLENDSHAPES[blendshape]).context("the model lacks a blendshape")?;
        let weights = table.linear.len() + table.polynomial.len();
        let degrees_of_freedom =
            table.linear.keys().chain(table.polynomial.keys()).filter(|name| *name != BIAS).count();
        let bytes = weights * WEIGHT_BYTES;
        Ok(Fitted { kind, blendshape, predictions, degrees_of_freedom, bytes, nanoseconds })
    };
    // `tongueOut`, the last, has no model.
    predictions.into_iter().enumerate().take(COEFFS - 1).map(one).collect()
}
