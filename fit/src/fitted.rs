//! What a kind of model makes of the judged pictures, for one blendshape: all that a report needs to know of it.
//!
//! A kind of model is anything that can fill in [`Fitted`]; [`shipped`] does it for the model that facewire runs.

use anyhow::Result;
use facewire::solve::{COEFFS, MAX_HIDDEN, Model};

use crate::judge::{Faces, estimates, regression_ns};

/// A model of one blendshape, after it has seen the judged pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// What kind of model it is, in a few words.
    pub kind: String,
    /// Place in [`facewire::solve::BLENDSHAPES`].
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

/// The model that facewire runs, with the subjects' neutral faces known and not known. Memory and time are those of all
/// blendshapes, shared out evenly.
pub fn shipped(model: &Model, known: &Faces, unknown: &Faces, rows: &[usize]) -> Result<Vec<Fitted>> {
    let kinds = [("shipped, neutral known", known), ("shipped, neutral not known", unknown)];
    let fitted = kinds.map(|(kind, faces)| one(kind, model, faces, rows));
    Ok(fitted.into_iter().collect::<Result<Vec<_>>>()?.concat())
}

fn one(kind: &str, model: &Model, faces: &Faces, rows: &[usize]) -> Result<Vec<Fitted>> {
    let nanoseconds = regression_ns(model, faces, rows)? / COEFFS as f64;
    let fitted = |(blendshape, predictions): (usize, Vec<f64>)| Fitted {
        kind: kind.to_owned(),
        blendshape,
        predictions,
        degrees_of_freedom: MAX_HIDDEN,
        bytes: model.size_bytes() / COEFFS,
        nanoseconds,
    };
    // `tongueOut`, the last, has no model.
    Ok(estimates(model, faces, rows)?.into_iter().enumerate().take(COEFFS - 1).map(fitted).collect())
}
