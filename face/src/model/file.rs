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

mod appearance;
mod formulas;

use std::{collections::BTreeMap, fs, path::Path};

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{
    AppearanceLayer, BLENDSHAPES, COEFFS, Correction, CorrectiveTerms, FeatureId, Formulas, HiddenLayer, Input,
    MAX_HIDDEN, MAX_INPUTS, Model, ModelError, Output, Regression,
};
pub use appearance::{AppearanceTable, ResidualRow, ResidualTable};
pub use formulas::{FormulaSetTable, FormulaTable, FormulasTable};

/// The format of model files that this program reads.
const FORMAT: u32 = 3;
/// The last blendshape. It has no model, because no landmark lies on the tongue, and stays 0.
const WITHOUT_MODEL: &str = "tongueOut";

/// The content of a file: a hidden layer (offsets, inputs and blendshapes) or formulas.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
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

/// Offsets of the hidden units, one for each unit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OffsetTable {
    /// For displacements from the wearer's neutral face.
    pub neutral_known: Vec<f64>,
    /// For wearers whose neutral face is not known.
    pub neutral_unknown: Vec<f64>,
}

/// A feature that the hidden layer selects.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputTable {
    /// Mean of the feature over neutral faces.
    pub neutral: f64,
    /// Weight of the feature for each hidden unit.
    pub weights: Vec<f64>,
}

/// A blendshape of the hidden layer.
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

/// The [`CorrectiveTerms`] of a blendshape.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "those of the corrective terms")]
pub struct CorrectionTable {
    pub shift: f64,
    pub slope: f64,
    pub lift: f64,
    pub response: [f64; 2],
}

impl From<&CorrectiveTerms> for CorrectionTable {
    fn from(terms: &CorrectiveTerms) -> Self {
        // The nearest short number reads better, and is the same number as an f32.
        let short = |number: f32| number.to_string().parse().unwrap_or_default();
        let CorrectiveTerms { shift, slope, lift, response } = *terms;
        Self { shift: short(shift), slope: short(slope), lift: short(lift), response: response.map(short) }
    }
}

impl ModelFile {
    /// A file of the current format without a regression.
    pub fn new(made_by: String, fitted_on: String) -> Self {
        Self { format: FORMAT, made_by, fitted_on, ..Self::default() }
    }

    /// Parses the text of a file.
    ///
    /// # Errors
    /// [`ModelError::Invalid`] if the text is damaged or of another format.
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
            Some(found) if found != FORMAT => Err(ModelError::Invalid(format!(
                "the model file has format {found}, this program reads format {FORMAT}; fit it again with facewire-fit"
            ))),
            _ => parsed,
        }
    }

    /// Checks every name and number and lays the numbers out for the solver.
    ///
    /// # Errors
    /// [`ModelError::Invalid`], which names the table and the entry.
    pub fn to_model(&self) -> Result<Model, ModelError> {
        let appearance = self.appearance.as_ref().map(AppearanceLayer::try_from).transpose()?;
        let correction = self.correction()?;
        Ok(Model { appearance, correction, ..Model::of(self.regression()?) })
    }

    fn regression(&self) -> Result<Regression, ModelError> {
        let has_formulas_alone = self.offsets.is_none() && self.inputs.is_empty() && self.blendshapes.is_empty();
        match (&self.offsets, &self.formulas) {
            (Some(offsets), None) => self.hidden_layer(offsets).map(Regression::HiddenLayer),
            (None, Some(formulas)) if has_formulas_alone => Formulas::try_from(formulas).map(Regression::Formulas),
            _ => Err(ModelError::Invalid(
                "the model file must have either offsets with inputs and blendshapes, or formulas; restore it or fit it \
                 again"
                    .to_owned(),
            )),
        }
    }

    fn hidden_layer(&self, offsets: &OffsetTable) -> Result<HiddenLayer, ModelError> {
        if self.inputs.len() > MAX_INPUTS {
            return Err(too_many("inputs"));
        }
        let input = |(name, table): (&String, &InputTable)| {
            let entry = format!("inputs.{name}");
            let feature = FeatureId::from_name(name).ok_or_else(|| unknown("inputs", name))?;
            let input = Input { feature, neutral: finite(&entry, "neutral", table.neutral)? };
            Ok((input, row(&entry, &table.weights)?))
        };
        let (inputs, weights): (Vec<_>, Vec<_>) =
            self.inputs.iter().map(input).collect::<Result<Vec<_>, _>>()?.into_iter().unzip();
        Ok(HiddenLayer {
            inputs: inputs.into(),
            weights: weights.into(),
            offsets_known: row("offsets.neutral_known", &offsets.neutral_known)?,
            offsets_unknown: row("offsets.neutral_unknown", &offsets.neutral_unknown)?,
            output: output::<MAX_HIDDEN, _>("blendshapes", &self.blendshapes, |table| (table.offset, &table.weights))?,
        })
    }

    /// Blendshapes that the table does not have keep the usual terms.
    fn correction(&self) -> Result<Correction, ModelError> {
        let mut all = Correction::default();
        for (name, table) in &self.correction {
            let slot = BLENDSHAPES.iter().zip(&mut all.0).find(|(known, _)| *known == name);
            let (_, slot) = slot.ok_or_else(|| unknown("correction", name))?;
            let entry = format!("correction.{name}");
            let [from, to] = table.response;
            *slot = CorrectiveTerms {
                shift: finite(&entry, "shift", table.shift)?,
                slope: finite(&entry, "slope", table.slope)?,
                lift: finite(&entry, "lift", table.lift)?,
                response: [finite(&entry, "response", from)?, finite(&entry, "response", to)?],
            };
            if !slot.keep_order() {
                return Err(ModelError::Invalid(format!(
                    "{entry} of the model file does not keep the order of values: slope must be above 0, lift at least \
                     0, and response two rising numbers from 0 on; restore it or fit it again"
                )));
            }
        }
        Ok(all)
    }
}

impl Model {
    /// Loads a model from a file.
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
    ModelError::Invalid(format!("the model file is damaged in line {line} ({reason}); restore it or fit it again"))
}

fn unknown(table: &str, name: &str) -> ModelError {
    ModelError::Invalid(format!("the model file names an unknown {name:?} in {table}; fit it again with facewire-fit"))
}

fn missing(entry: &str) -> ModelError {
    ModelError::Invalid(format!("the model file has no {entry}; restore it or fit it again"))
}

fn too_many(table: &str) -> ModelError {
    ModelError::Invalid(format!(
        "{table} of the model file has more weights than this program holds; fit it again with fewer"
    ))
}

/// Returns the entry of each blendshape that needs one, its name, and the index of the blendshape.
fn blendshapes<'a, T>(
    table: &str,
    entries: &'a BTreeMap<String, T>,
) -> Result<Vec<(usize, String, &'a T)>, ModelError> {
    let needed = || BLENDSHAPES.iter().enumerate().filter(|(_, name)| **name != WITHOUT_MODEL);
    if let Some(name) = entries.keys().find(|name| !needed().any(|(_, known)| known == name)) {
        return Err(unknown(table, name));
    }
    let entry = |(index, name): (usize, &&str)| {
        let entry = format!("{table}.{name}");
        entries.get(*name).ok_or_else(|| missing(&entry)).map(|found| (index, entry, found))
    };
    needed().map(entry).collect()
}

/// Reads the offset and the weight of each of the `N` units for every blendshape.
fn output<const N: usize, T>(
    table: &str,
    entries: &BTreeMap<String, T>,
    of: impl Fn(&T) -> (f64, &[f64]),
) -> Result<Output, ModelError> {
    let mut output = Output { weights: vec![[0.0; COEFFS]; N].into(), offsets: [0.0; COEFFS] };
    for (index, entry, found) in blendshapes(table, entries)? {
        let (offset, weights) = of(found);
        let rows = output.weights.iter_mut().chain([&mut output.offsets]);
        let numbers = row::<N>(&entry, weights)?.into_iter().chain([finite(&entry, "offset", offset)?]);
        for (row, number) in rows.zip(numbers) {
            row.get_mut(index).into_iter().for_each(|slot| *slot = number);
        }
    }
    Ok(output)
}

/// Reads one number for each of `N` units. Units that the file does not have get 0.
fn row<const N: usize>(table: &str, numbers: &[f64]) -> Result<[f32; N], ModelError> {
    if numbers.len() > N {
        return Err(too_many(table));
    }
    let mut out = [0.0; N];
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
    Err(ModelError::Invalid(format!(
        "the number {name:?} in {table} of the model file is not finite; restore the file"
    )))
}

#[cfg(test)]
mod tests;
