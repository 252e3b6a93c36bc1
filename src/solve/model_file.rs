//! The model as a file that people can read and compare (TOML).
//!
//! ```toml
//! format = 2
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
//! neutral_known = { r = 0.95, mse = 0.004 }     # score on held-out subjects, after eq. 7
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
//! [appearance.landmarks]      # weights: signed bytes in base 64, for each of 32 channels one for each of 32 units
//! 13 = "AP8BAv4D..."
//!
//! [appearance.blendshapes.cheekPuff]    # what is added to the blendshape
//! neutral_known = { offset = 0.01, weights = [0.1, -0.2] }
//! neutral_unknown = { offset = 0.02, weights = [0.1, -0.1] }
//! ```
//!
//! The build script compiles this file, too.

mod appearance;

use std::{collections::BTreeMap, fs, path::Path};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

pub use self::appearance::{AppearanceTable, ResidualRow, ResidualTable};
use super::{
    BLENDSHAPES,
    feature_id::FeatureId,
    model::{Hidden, Input, MAX_HIDDEN, MAX_INPUTS, Model, Output},
    model_error::{FORMAT, ModelError},
};

/// The blendshape that has no model, because no landmark lies on the tongue. It stays 0.
const WITHOUT_MODEL: &str = "tongueOut";

/// The content of a file.
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
    pub offsets: OffsetTable,
    /// Selected features by name.
    pub inputs: BTreeMap<String, InputTable>,
    /// Blendshapes by name.
    pub blendshapes: BTreeMap<String, BlendshapeTable>,
    /// What reads how the face looks.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub appearance: Option<AppearanceTable>,
}

/// Offsets of the hidden units, one for each unit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OffsetTable {
    /// For displacements from the wearer's neutral face.
    pub neutral_known: Vec<f64>,
    /// For wearers whose neutral face is not known.
    pub neutral_unknown: Vec<f64>,
}

/// A selected feature.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputTable {
    /// Mean of the feature over neutral faces.
    pub neutral: f64,
    /// Weight of the feature for each hidden unit.
    pub weights: Vec<f64>,
}

/// A blendshape.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlendshapeTable {
    /// Score where the wearer's neutral face is known.
    pub neutral_known: ScoreTable,
    /// Score where it is not known.
    pub neutral_unknown: ScoreTable,
    /// The coefficient where all hidden units are 0.
    pub offset: f64,
    /// Weight of each hidden unit.
    pub weights: Vec<f64>,
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
    /// An empty file of the current format.
    #[must_use]
    pub fn new(made_by: String, fitted_on: String) -> Self {
        Self {
            format: FORMAT,
            made_by,
            fitted_on,
            offsets: OffsetTable::default(),
            inputs: BTreeMap::new(),
            blendshapes: BTreeMap::new(),
            appearance: None,
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
        if self.inputs.len() > MAX_INPUTS {
            return Err(ModelError::TooMany { table: "inputs".to_owned() });
        }
        let OffsetTable { neutral_known, neutral_unknown } = &self.offsets;
        let inputs = self.inputs.iter().map(|(name, table)| input(name, table)).collect::<Result<_, _>>()?;
        let offsets =
            [hidden("offsets.neutral_known", neutral_known)?, hidden("offsets.neutral_unknown", neutral_unknown)?];
        let appearance = self.appearance.as_ref().map(AppearanceTable::to_layer).transpose()?;
        Ok(Model { appearance, ..Model::new(inputs, &offsets, &self.outputs()?) })
    }

    fn outputs(&self) -> Result<Vec<Output>, ModelError> {
        let is_known = |name: &str| BLENDSHAPES.contains(&name) && name != WITHOUT_MODEL;
        if let Some(name) = self.blendshapes.keys().find(|name| !is_known(name)) {
            return Err(ModelError::Unknown { table: "blendshapes".to_owned(), name: name.clone() });
        }
        let find = |name: &&'static str| match self.blendshapes.get(*name) {
            Some(table) => output(name, table),
            None if *name == WITHOUT_MODEL => Ok(Output { offset: 0.0, weights: [0.0; MAX_HIDDEN] }),
            None => Err(ModelError::Missing { table: "blendshapes", blendshape: name }),
        };
        BLENDSHAPES.iter().map(find).collect()
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

fn input(name: &str, entry: &InputTable) -> Result<(Input, Hidden), ModelError> {
    let unknown = || ModelError::Unknown { table: "inputs".to_owned(), name: name.to_owned() };
    let table = format!("inputs.{name}");
    let feature = FeatureId::from_name(name).ok_or_else(unknown)?;
    let input = Input { feature, neutral: finite(&table, "neutral", entry.neutral)? };
    Ok((input, hidden(&table, &entry.weights)?))
}

fn output(name: &str, entry: &BlendshapeTable) -> Result<Output, ModelError> {
    let table = format!("blendshapes.{name}");
    Ok(Output { offset: finite(&table, "offset", entry.offset)?, weights: hidden(&table, &entry.weights)? })
}

/// One number for each hidden unit. Units that the file does not have get 0.
fn hidden(table: &str, numbers: &[f64]) -> Result<Hidden, ModelError> {
    if numbers.len() > MAX_HIDDEN {
        return Err(ModelError::TooMany { table: table.to_owned() });
    }
    let mut out = [0.0; MAX_HIDDEN];
    for (slot, number) in out.iter_mut().zip(numbers) {
        *slot = finite(table, "weights", *number)?;
    }
    Ok(out)
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
