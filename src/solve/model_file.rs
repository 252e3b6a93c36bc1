//! The model as a file that people can read and compare (TOML).
//!
//! ```toml
//! format = 3
//! made_by = "facewire-fit train ..."
//! fitted_on = "..."
//!
//! [offsets]                   # of the hidden units, at most 120
//! neutral_known = [0.1, -0.3]
//! neutral_unknown = [0.2, -0.1]
//!
//! [inputs.d13-14]             # a selected feature: its mean over neutral faces, its weight for each hidden unit
//! neutral = 0.05
//! weights = [1.9, -0.4]
//!
//! [blendshapes.jawOpen]       # its weight for each hidden unit
//! neutral_known = { r = 0.95, mse = 0.004 }     # score on held-out subjects, without `correction`
//! neutral_unknown = { r = 0.93, mse = 0.005 }
//! offset = 0.01
//! weights = [0.8, 0.1]
//! ```
//!
//! The table `appearance`, which may be missing, is that of the layer that reads the mesh network's feature map:
//!
//! ```toml
//! [appearance]
//! scales = [0.001, 0.002]     # of the weights of each of the 32 units
//! offsets = [0.1, -0.3]
//!
//! [appearance.landmarks]      # signed bytes in base 64: for each of 32 channels, a weight for each of 32 units
//! 13 = "AP8BAv4D..."
//!
//! [appearance.blendshapes.cheekPuff]    # what is added to the blendshape
//! neutral_known = { offset = 0.01, weights = [0.1, -0.2] }
//! neutral_unknown = { offset = 0.02, weights = [0.1, -0.1] }
//! ```
//!
//! The table `correction`, which may be missing, has the corrective terms (eq. 7) of the blendshapes that need some:
//!
//! ```toml
//! [correction.eyeBlinkLeft]
//! shift = -0.02               # beta
//! slope = 1.05                # 1 - gamma
//! lift = 0.2                  # 1 / eta
//! response = [0.5, 0.9]       # the values at which g begins and ends to rise
//! ```
//!
//! Instead of offsets, inputs and blendshapes of a hidden layer, the file can hold one formula for each blendshape:
//!
//! ```toml
//! [formulas.neutral_known.inputs]       # mean and deviation of each selected feature over the faces of the fit
//! d13-14 = [0.06, 0.09]
//! y17 = [-0.03, 0.05]
//!
//! [formulas.neutral_known.blendshapes.jawOpen]
//! kind = "quadratic"                    # or affine, exponential, log-exponential
//! response = "plain"                    # or square-root, logit
//! score = { r = 0.95, mse = 0.004 }
//! offset = 0.21
//! weights = { d13-14 = 0.12, y17 = -0.08 }
//! products = { "d13-14*d13-14" = 0.01, "d13-14*y17" = -0.02 }
//!
//! [formulas.neutral_unknown.inputs]     # and so on, for wearers whose neutral face is not known
//! ```
//!
//! The build script compiles this file, too.

mod appearance;
mod correction;
mod formulas;
mod hidden_layer;

use std::{collections::BTreeMap, fs, path::Path};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

pub use self::{
    appearance::{AppearanceTable, ResidualRow, ResidualTable},
    correction::CorrectionTable,
    formulas::{FormulaSetTable, FormulaTable, FormulasTable},
    hidden_layer::{BlendshapeTable, InputTable, OffsetTable},
};
use super::{
    BLENDSHAPES,
    model::Model,
    model_error::{FORMAT, ModelError},
};

/// The last blendshape. It has no model, because no landmark lies on the tongue, and stays 0.
const WITHOUT_MODEL: &str = "tongueOut";

/// The content of a file: a hidden layer (offsets, inputs and blendshapes) or formulas.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFile {
    /// Version of the layout.
    pub format: u32,
    /// The command that wrote the file.
    pub made_by: String,
    /// The data that the model was fitted on, in words.
    pub fitted_on: String,
    /// Offsets of the hidden units.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offsets: Option<OffsetTable>,
    /// The features that the hidden layer selects, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub inputs: BTreeMap<String, InputTable>,
    /// The blendshapes of the hidden layer by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub blendshapes: BTreeMap<String, BlendshapeTable>,
    /// One formula for each blendshape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub formulas: Option<FormulasTable>,
    /// The layer that reads how the face looks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub appearance: Option<AppearanceTable>,
    /// The corrective terms of blendshapes by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub correction: BTreeMap<String, CorrectionTable>,
}

/// How well a blendshape is estimated for subjects that the fit has not seen.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScoreTable {
    /// Pearson's correlation.
    pub r: f64,
    /// Mean squared error.
    pub mse: f64,
}

impl ModelFile {
    /// A file of the current format without a regression.
    #[must_use]
    pub fn new(made_by: String, fitted_on: String) -> Self {
        Self {
            format: FORMAT,
            made_by,
            fitted_on,
            offsets: None,
            inputs: BTreeMap::new(),
            blendshapes: BTreeMap::new(),
            formulas: None,
            appearance: None,
            correction: BTreeMap::new(),
        }
    }

    /// Parses the text of a file.
    ///
    /// # Errors
    /// [`ModelError::WrongFormat`] or [`ModelError::Damaged`].
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        #[derive(Deserialize)]
        struct Header {
            format: u32,
        }
        let parsed = from_toml::<Self>(text);
        // A file of another format has another layout, which looks like damage. Only then is the text parsed again.
        let format = match &parsed {
            Ok(file) => Some(file.format),
            Err(_) => from_toml::<Header>(text).ok().map(|header| header.format),
        };
        match format {
            Some(found) if found != FORMAT => Err(ModelError::WrongFormat { found }),
            _ => parsed,
        }
    }

    /// Checks every name and number and lays the numbers out for the solver.
    ///
    /// # Errors
    /// [`ModelError`], which names the table and the entry.
    pub fn to_model(&self) -> Result<Model, ModelError> {
        let appearance = self.appearance.as_ref().map(AppearanceTable::to_layer).transpose()?;
        let correction = correction::read(&self.correction)?;
        Ok(Model { appearance, correction, ..self.regression()? })
    }

    fn regression(&self) -> Result<Model, ModelError> {
        let has_formulas_alone = self.offsets.is_none() && self.inputs.is_empty() && self.blendshapes.is_empty();
        match (&self.offsets, &self.formulas) {
            (Some(offsets), None) => Ok(hidden_layer::read(offsets, &self.inputs, &self.blendshapes)?.into()),
            (None, Some(formulas)) if has_formulas_alone => Ok(formulas.to_formulas()?.into()),
            _ => Err(ModelError::NotOneRegression),
        }
    }
}

impl Model {
    /// Loads a model from a file.
    ///
    /// # Errors
    /// [`ModelError::Unreadable`] if the file is missing or cannot be read; the other kinds of [`ModelError`] if it is
    /// damaged, of another format, or holds numbers that are not finite.
    pub fn load(path: &Path) -> Result<Self, ModelError> {
        let bytes = fs::read(path).map_err(|source| ModelError::Unreadable { path: path.to_owned(), source })?;
        let text = str::from_utf8(&bytes).map_err(|error| damaged(&bytes, error.valid_up_to(), "it is not UTF-8"))?;
        ModelFile::parse(text)?.to_model()
    }
}

fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, ModelError> {
    toml::from_str(text).map_err(|error| {
        let offset = error.span().map_or(0, |span| span.start);
        damaged(text.as_bytes(), offset, error.message())
    })
}

fn damaged(text: &[u8], offset: usize, reason: &str) -> ModelError {
    let line = 1 + text.iter().take(offset).filter(|byte| **byte == b'\n').count();
    ModelError::Damaged { line, reason: reason.to_owned() }
}

/// Reads the entry of each blendshape, in the order of [`BLENDSHAPES`]. The blendshape that needs no entry gets
/// `without`.
fn for_each_blendshape<T, U>(
    table: &str,
    entries: &BTreeMap<String, T>,
    without: U,
    read: impl Fn(&str, &T) -> Result<U, ModelError>,
) -> Result<Vec<U>, ModelError> {
    let is_known = |name: &str| BLENDSHAPES.contains(&name) && name != WITHOUT_MODEL;
    if let Some(name) = entries.keys().find(|name| !is_known(name)) {
        return Err(ModelError::Unknown { table: table.to_owned(), name: name.clone() });
    }
    let mut all = Vec::with_capacity(BLENDSHAPES.len());
    for name in BLENDSHAPES.iter().filter(|name| **name != WITHOUT_MODEL) {
        let entry = format!("{table}.{name}");
        match entries.get(*name) {
            Some(found) => all.push(read(&entry, found)?),
            None => return Err(ModelError::Missing { entry }),
        }
    }
    all.push(without);
    Ok(all)
}

fn finite(table: &str, name: &str, number: f64) -> Result<f32, ModelError> {
    #[expect(clippy::cast_possible_truncation, reason = "checked below")]
    let narrow = number as f32;
    if narrow.is_finite() {
        return Ok(narrow);
    }
    Err(ModelError::NotFinite { table: table.to_owned(), name: name.to_owned() })
}

#[cfg(test)]
mod tests;
