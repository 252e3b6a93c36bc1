//! The results of a model on the judged pictures, for one blendshape, as a report needs them.
//!
//! Any kind of model can fill in [`Fitted`]. [`shipped`] does so for the model that facewire runs.

use anyhow::Result;
use facewire::solve::{COEFFS, MAX_HIDDEN, Model};

use crate::judge::{Faces, estimates, regression_ns};

/// A fitted model of one blendshape with its predictions for the judged pictures.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// The kind of model in a few words.
    pub kind: String,
    /// Index in [`facewire::solve::BLENDSHAPES`].
    pub blendshape: usize,
    /// The predicted coefficient of every judged picture, in the order of the truth.
    pub predictions: Vec<f64>,
    /// The number of fitted weights, without the constant.
    pub degrees_of_freedom: usize,
    /// Memory of the model.
    pub bytes: usize,
    /// Time for one face on this machine.
    pub nanoseconds: f64,
}

/// Applies the model that facewire runs, with the subjects' neutral faces known and not known. Its memory and time are
/// divided evenly among the blendshapes.
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
    // The last blendshape, `tongueOut`, has no model.
    Ok(estimates(model, faces, rows)?.into_iter().enumerate().take(COEFFS - 1).map(fitted).collect())
}
