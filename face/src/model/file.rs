//! The model as a file that people can read and compare (TOML).

#![allow(missing_docs, reason = "the example of `ModelFile` shows what the fields hold")]

use std::{collections::BTreeMap, fs, path::Path};

use base64::{Engine as _, prelude::BASE64_STANDARD};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{
    APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS, APPEARANCE_UNITS, AppearanceLayer, BLENDSHAPES, COEFFS, Cases,
    Correction, CorrectiveTerms, EYE_SUMS, EYE_VALUES, EyesLayer, FeatureId, FormulaSetTable, GazeInput, GazeLayer,
    HiddenLayer, Input, MAX_HIDDEN, MAX_INPUTS, Model, ModelError, Output, Regression,
};

/// The format of model files that this program reads.
const FORMAT: u32 = 3;
/// The checksum that the file of the network of the eyes contains (`engine/src/file.rs`).
const EYES_NETWORK: u32 = match include_bytes!("../../models/eyes.fwnet").split_first_chunk::<12>() {
    Some((_, &[a, b, c, d, ..])) => u32::from_le_bytes([a, b, c, d]),
    _ => 0,
};
/// The last blendshape. It has no model and stays 0.
const WITHOUT_MODEL: &str = "tongueOut";

/// The content of a file: a hidden layer (offsets, inputs and blendshapes) or formulas.
///
/// ```toml
/// format = 3
/// made_by = "facewire-fit train ..."
/// fitted_on = "..."
///
/// [offsets]                   # of the hidden units, at most 160
/// neutral_known = [0.1, -0.3]
/// neutral_unknown = [0.2, -0.1]
///
/// [inputs.d13-14]             # a selected feature: its mean over neutral faces, its weight for each hidden unit
/// neutral = 0.05
/// weights = [1.9, -0.4]
///
/// [blendshapes.jawOpen]       # the scores on held-out subjects, without `correction`; the weight of each hidden unit
/// neutral_known = { r = 0.95, mse = 0.004 }
/// neutral_unknown = { r = 0.93, mse = 0.005 }
/// offset = 0.01
/// weights = [0.8, 0.1]
///
/// [formulas.neutral_known.inputs]       # in place of the tables above: mean and deviation of each selected feature
/// d13-14 = [0.06, 0.09]
/// y17 = [-0.03, 0.05]
///
/// [formulas.neutral_known.blendshapes.jawOpen]
/// kind = "quadratic"                    # or affine, exponential, log-exponential
/// response = "plain"                    # or square-root, logit
/// score = { r = 0.95, mse = 0.004 }     # and r2, xi, dw, bp: the other statistics of the paper
/// offset = 0.21
/// weights = { d13-14 = 0.12, y17 = -0.08 }
/// products = { "d13-14*d13-14" = 0.01, "d13-14*y17" = -0.02 }
///
/// [appearance]                # may be missing: the layer that reads the mesh network's feature map
/// scales = [0.001, 0.002]     # of the weights of each of the 32 units
/// offsets = [0.1, -0.3]
///
/// [appearance.landmarks]      # signed bytes in base 64: for each of 32 channels, a weight for each of 32 units
/// 13 = "AP8BAv4D..."
///
/// [appearance.blendshapes.cheekPuff]    # what is added to the blendshape
/// neutral_known = { offset = 0.01, weights = [0.1, -0.2] }
/// neutral_unknown = { offset = 0.02, weights = [0.1, -0.1] }
///
/// [gaze.offsets]              # may be missing: the map from points of the eyes to yaw and pitch in degrees
/// neutral_known = [0.0, 0.1]  # not used: the map is measured from the mean of many people
/// neutral_unknown = [0.2, 1.0]
///
/// [gaze.inputs.x468]          # the mean of a feature over neutral faces, and its weights
/// neutral = -0.5
/// weights = [120.5, 0.3]
///
/// [eyes]                      # may be missing: the layer from pictures of the eyes to yaw and pitch in degrees
/// network = 305419896         # may be missing: the checksum in the file of the network of the eyes
/// inputs = { x468 = [-12.5, 0.1, 3.0] }         # the weights of features for yaw, for pitch and for the 64 hidden units
/// values = [[0.1, 0.2, 0.3]]  # the same for each value of the right eye, then of the left
/// offsets = [0.1, -2.0, 0.5]
/// outputs = [[1.5, 0.2]]      # the weights of each hidden unit for yaw and pitch
///
/// [correction.eyeBlinkLeft]   # corrective terms (eq. 7) of the blendshapes that need some
/// shift = -0.02               # beta
/// slope = 1.05                # 1 - gamma
/// lift = 0.2                  # 1 / eta
/// response = [0.5, 0.9]       # the values at which g begins and ends to rise
/// ```
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFile {
    pub format: u32,
    pub made_by: String,
    pub fitted_on: String,
    pub offsets: Option<Cases<Vec<f64>>>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub inputs: BTreeMap<String, InputTable>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub blendshapes: BTreeMap<String, BlendshapeTable>,
    pub formulas: Option<Cases<FormulaSetTable>>,
    pub appearance: Option<AppearanceTable>,
    pub gaze: Option<GazeTable>,
    pub eyes: Option<EyesTable>,
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub correction: BTreeMap<String, CorrectiveTerms>,
}

/// How well a blendshape is estimated for subjects that the fit has not seen.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScoreTable {
    pub r: f64,
    pub mse: f64,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputTable {
    pub neutral: f64,
    pub weights: Vec<f64>,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlendshapeTable {
    pub neutral_known: ScoreTable,
    pub neutral_unknown: ScoreTable,
    pub offset: f64,
    pub weights: Vec<f64>,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GazeTable {
    pub offsets: Cases<Vec<f64>>,
    pub inputs: BTreeMap<String, InputTable>,
}

impl GazeTable {
    fn to_layer(&self) -> Result<GazeLayer, ModelError> {
        let input = |(name, table): (&String, &InputTable)| {
            let entry = format!("gaze.inputs.{name}");
            let feature = feature("gaze.inputs", name)?;
            let neutral = finite(&entry, table.neutral)?;
            Ok(GazeInput { feature, neutral, weights: row(&entry, &table.weights)? })
        };
        Ok(GazeLayer {
            inputs: self.inputs.iter().map(input).collect::<Result<_, ModelError>>()?,
            offsets: Cases {
                neutral_known: row("gaze.offsets.neutral_known", &self.offsets.neutral_known)?,
                neutral_unknown: row("gaze.offsets.neutral_unknown", &self.offsets.neutral_unknown)?,
            },
        })
    }
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EyesTable {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<u32>,
    pub offsets: Vec<f64>,
    pub outputs: Vec<[f64; 2]>,
    pub values: Vec<Vec<f64>>,
    pub inputs: BTreeMap<String, Vec<f64>>,
}

impl EyesTable {
    fn to_layer(&self) -> Result<EyesLayer, ModelError> {
        if self.network.is_some_and(|network| network != EYES_NETWORK) {
            return Err(ModelError::Invalid(
                "in the model file, the table eyes was trained for another network of the eyes than this program contains: \
                 use a model and a program of the same version, or train both again with models/eyes/train.py"
                    .to_owned(),
            ));
        }
        let mut weights = Vec::new();
        for own in self.inputs.values().chain(&self.values) {
            weights.extend(row::<EYE_SUMS>("eyes.inputs or eyes.values", own)?);
        }
        if (self.values.len(), self.outputs.len()) != (2 * EYE_VALUES, EYE_SUMS - 2) {
            return Err(invalid("eyes", "has not as many rows as there are values of both eyes, and units"));
        }
        Ok(EyesLayer {
            inputs: self.inputs.keys().map(|name| feature("eyes.inputs", name)).collect::<Result<_, _>>()?,
            weights: weights.into(),
            offsets: row("eyes.offsets", &self.offsets)?,
            outputs: self.outputs.iter().map(|own| row("eyes.outputs", own)).collect::<Result<_, _>>()?,
        })
    }
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AppearanceTable {
    pub scales: Vec<f64>,
    pub offsets: Vec<f64>,
    pub landmarks: BTreeMap<String, String>,
    pub blendshapes: BTreeMap<String, Cases<ResidualRow>>,
}

#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResidualRow {
    pub offset: f64,
    pub weights: Vec<f64>,
}

impl AppearanceTable {
    /// Writes the weights of a landmark, [`APPEARANCE_CHANNELS`] rows.
    pub fn encode(weights: &[[i8; APPEARANCE_UNITS]]) -> String {
        BASE64_STANDARD.encode(weights.as_flattened().iter().map(|weight| weight.cast_unsigned()).collect::<Vec<_>>())
    }

    /// Checks every name and number and lays the numbers out for the solver.
    fn to_layer(&self) -> Result<AppearanceLayer, ModelError> {
        let names = APPEARANCE_LANDMARKS.map(|landmark| landmark.to_string());
        let table = "appearance.landmarks";
        if let Some(name) = self.landmarks.keys().find(|name| !names.contains(name)) {
            return Err(unknown(table, name));
        }
        let mut weights = Vec::new();
        for name in &names {
            let entry = format!("{table}.{name}");
            let text = self.landmarks.get(name).ok_or_else(|| invalid(&entry, MISSING))?;
            let bytes = BASE64_STANDARD.decode(text).unwrap_or_default();
            if bytes.len() != APPEARANCE_CHANNELS * APPEARANCE_UNITS {
                return Err(invalid(&entry, "is not the list of weights that it must be"));
            }
            weights.extend(bytes.into_iter().map(u8::cast_signed));
        }
        let residuals = self.blendshapes.values().flat_map(|table| [&table.neutral_known, &table.neutral_unknown]);
        let mut lists = residuals.map(|row| &row.weights).chain([&self.scales, &self.offsets]);
        if lists.any(|list| list.len() != APPEARANCE_UNITS) {
            return Err(invalid("a list of appearance", "has not one number for each unit"));
        }
        let output = |of: fn(&Cases<ResidualRow>) -> &ResidualRow| {
            output("appearance.blendshapes", &self.blendshapes, APPEARANCE_UNITS, |table| {
                (of(table).offset, &of(table).weights)
            })
        };
        Ok(AppearanceLayer {
            weights: weights.into(),
            scales: row("appearance.scales", &self.scales)?,
            offsets: row("appearance.offsets", &self.offsets)?,
            outputs: Cases {
                neutral_known: output(|table| &table.neutral_known)?,
                neutral_unknown: output(|table| &table.neutral_unknown)?,
            },
        })
    }
}

impl ModelFile {
    /// A file of the current format without a regression.
    pub fn new(made_by: String, fitted_on: String) -> Self {
        Self { format: FORMAT, made_by, fitted_on, ..Self::default() }
    }

    /// Parses the text of a file. Text that is damaged or of another format is [`ModelError::Invalid`].
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        #[derive(Deserialize)]
        struct Header {
            format: u32,
        }
        // A file of another format has another layout, which would look like damage.
        let Header { format } = from_toml(text)?;
        if format == FORMAT {
            return from_toml(text);
        }
        Err(ModelError::Invalid(format!(
            "the model file has format {format}, this program reads format {FORMAT}; fit it again with facewire-fit"
        )))
    }

    /// Checks every name and number and lays the numbers out for the solver. [`ModelError::Invalid`] names the entry.
    pub fn to_model(&self) -> Result<Model, ModelError> {
        let appearance = self.appearance.as_ref().map(AppearanceTable::to_layer).transpose()?;
        let gaze = self.gaze.as_ref().map(GazeTable::to_layer).transpose()?;
        let eyes = self.eyes.as_ref().map(EyesTable::to_layer).transpose()?;
        Ok(Model { appearance, gaze, eyes, correction: self.correction()?, regression: self.regression()? })
    }

    pub(super) fn regression(&self) -> Result<Regression, ModelError> {
        let has_formulas_alone = self.offsets.is_none() && self.inputs.is_empty() && self.blendshapes.is_empty();
        match (&self.offsets, &self.formulas) {
            (Some(offsets), None) => self.hidden_layer(offsets).map(Regression::HiddenLayer),
            (None, Some(formulas)) if has_formulas_alone => Ok(Regression::Formulas(Cases {
                neutral_known: formulas.neutral_known.to_set("formulas.neutral_known")?,
                neutral_unknown: formulas.neutral_unknown.to_set("formulas.neutral_unknown")?,
            })),
            _ => Err(invalid("the content", "is not either offsets with inputs and blendshapes, or formulas")),
        }
    }

    fn hidden_layer(&self, offsets: &Cases<Vec<f64>>) -> Result<HiddenLayer, ModelError> {
        if self.inputs.len() > MAX_INPUTS {
            return Err(invalid("inputs", TOO_MANY));
        }
        let mut inputs = Vec::new();
        let mut weights = Vec::new();
        for (name, table) in &self.inputs {
            let feature = feature("inputs", name)?;
            let entry = format!("inputs.{name}");
            inputs.push(Input { feature, neutral: finite(&entry, table.neutral)? });
            weights.extend(row::<MAX_HIDDEN>(&entry, &table.weights)?);
        }
        Ok(HiddenLayer {
            inputs: inputs.into(),
            weights: weights.into(),
            offsets_known: row("offsets.neutral_known", &offsets.neutral_known)?,
            offsets_unknown: row("offsets.neutral_unknown", &offsets.neutral_unknown)?,
            output: output("blendshapes", &self.blendshapes, MAX_HIDDEN, |table| (table.offset, &table.weights))?,
        })
    }

    /// Blendshapes that the table does not have keep the usual terms.
    fn correction(&self) -> Result<Correction, ModelError> {
        let mut all = Correction::default();
        for (name, terms) in &self.correction {
            let slot = BLENDSHAPES.iter().zip(&mut all.0).find(|(known, _)| *known == name);
            let (_, slot) = slot.ok_or_else(|| unknown("correction", name))?;
            *slot = *terms;
            if !terms.keep_order() {
                return Err(invalid(
                    &format!("correction.{name}"),
                    "does not keep the order of values: slope must be above 0, lift at least 0, and response two rising \
                     numbers from 0 on",
                ));
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

const MISSING: &str = "is missing";
pub(super) const TOO_MANY: &str = "has more weights than this program holds";

pub(super) fn invalid(entry: &str, fault: &str) -> ModelError {
    ModelError::Invalid(format!("{entry} of the model file {fault}; restore the file or fit it again"))
}

/// The name is quoted, because it can contain control characters.
fn unknown(table: &str, name: &str) -> ModelError {
    invalid(&format!("the name {name:?} in {table}"), "is unknown")
}

pub(super) fn feature(table: &str, name: &str) -> Result<FeatureId, ModelError> {
    FeatureId::from_name(name).ok_or_else(|| unknown(table, name))
}

/// Returns the entry of each blendshape that needs one, its name, and the index of the blendshape.
pub(super) fn blendshapes<'a, T>(
    table: &str,
    entries: &'a BTreeMap<String, T>,
) -> Result<Vec<(usize, String, &'a T)>, ModelError> {
    let needed = || BLENDSHAPES.iter().enumerate().filter(|(_, name)| **name != WITHOUT_MODEL);
    if let Some(name) = entries.keys().find(|name| !needed().any(|(_, known)| known == name)) {
        return Err(unknown(table, name));
    }
    let entry = |(index, name): (usize, &&str)| {
        let entry = format!("{table}.{name}");
        let found = entries.get(*name).ok_or_else(|| invalid(&entry, MISSING))?;
        Ok((index, entry, found))
    };
    needed().map(entry).collect()
}

/// Reads the offset and the weight of each unit for every blendshape. Units that the file does not have get 0.
fn output<T>(
    table: &str,
    entries: &BTreeMap<String, T>,
    units: usize,
    of: impl Fn(&T) -> (f64, &[f64]),
) -> Result<Output, ModelError> {
    let mut output = Output { weights: vec![0.0; units * COEFFS].into(), offsets: [0.0; COEFFS] };
    for (index, entry, found) in blendshapes(table, entries)? {
        let (offset, weights) = of(found);
        if weights.len() > units {
            return Err(invalid(&entry, TOO_MANY));
        }
        let slots = output.offsets.iter_mut().skip(index).take(1);
        let slots = slots.chain(output.weights.iter_mut().skip(index).step_by(COEFFS));
        for (slot, number) in slots.zip([&offset].into_iter().chain(weights)) {
            *slot = finite(&entry, *number)?;
        }
    }
    Ok(output)
}

/// Reads one number for each of `N` units. Units that the file does not have get 0.
fn row<const N: usize>(entry: &str, numbers: &[f64]) -> Result<[f32; N], ModelError> {
    if numbers.len() > N {
        return Err(invalid(entry, TOO_MANY));
    }
    let mut out = [0.0; N];
    for (slot, number) in out.iter_mut().zip(numbers) {
        *slot = finite(entry, *number)?;
    }
    Ok(out)
}

pub(super) fn finite(entry: &str, number: f64) -> Result<f32, ModelError> {
    #[expect(clippy::cast_possible_truncation, reason = "checked below")]
    let narrow = number as f32;
    if narrow.is_finite() { Ok(narrow) } else { Err(invalid(entry, "has a number that is not finite")) }
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::float_cmp)]
pub(super) mod tests {
    use super::*;

    const SHIPPED: &str = include_str!("../../models/blendshapes.toml");

    /// The shipped file, with an appearance table whose weights, read as one list, count from -128 to 127 again and again.
    fn file() -> ModelFile {
        let rows: Vec<[i8; APPEARANCE_UNITS]> = (0..APPEARANCE_LANDMARKS.len() * APPEARANCE_CHANNELS)
            .map(|value| core::array::from_fn(|unit| (value * APPEARANCE_UNITS + unit) as i8))
            .collect();
        let landmarks = APPEARANCE_LANDMARKS.iter().zip(rows.chunks(APPEARANCE_CHANNELS));
        let row = |offset: f64| ResidualRow { offset, weights: vec![2.0 * offset; APPEARANCE_UNITS] };
        let residual = Cases { neutral_known: row(0.25), neutral_unknown: row(0.5) };
        let shapes = BLENDSHAPES.iter().filter(|name| **name != WITHOUT_MODEL);
        let appearance = AppearanceTable {
            scales: vec![0.125; APPEARANCE_UNITS],
            offsets: vec![-1.5; APPEARANCE_UNITS],
            landmarks: landmarks.map(|(name, rows)| (name.to_string(), AppearanceTable::encode(rows))).collect(),
            blendshapes: shapes.map(|name| ((*name).to_owned(), residual.clone())).collect(),
        };
        ModelFile { appearance: Some(appearance), ..ModelFile::parse(SHIPPED).expect("the shipped model is sound") }
    }

    #[test]
    fn appearance_weights_keep_their_places_through_text_and_bytes() {
        let text = toml::to_string(&file()).expect("TOML");
        let model = ModelFile::parse(&text).expect("the same file").to_model().expect("a model");
        let bytes = model.to_bytes();
        assert!(text.len() <= 1 << 20 && bytes.len() <= 1 << 20, "{} {}", text.len(), bytes.len());
        let layer = model.appearance.as_ref().expect("a layer");
        assert!((0..layer.weights.len()).all(|index| layer.weights[index] == index as i8));
        assert_eq!(layer.outputs.neutral_unknown.weights[7 * COEFFS..][..COEFFS - 1], [1.0; COEFFS - 1]);
        assert_eq!(
            layer.outputs.neutral_known.offsets,
            core::array::from_fn(|shape| if shape < 51 { 0.25 } else { 0.0 })
        );
        assert_eq!(Model::from_bytes(&bytes), Some(model));
    }

    #[test]
    fn file_that_cannot_be_read_is_told_from_one_that_is_damaged_or_of_another_format() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("model.toml");
        assert!(matches!(Model::load(&path), Err(ModelError::Unreadable { .. })));
        let cases: [(&[u8], &str); 5] = [
            (b"format = 3\nmade_by = \"\xff\"\n", "line 2 (it is not UTF-8)"),
            (b"\nformat = [1", "damaged in line 2"),
            (b"format = 3", "damaged"),
            (&SHIPPED.as_bytes()[..SHIPPED.len() / 2], "damaged"),
            (b"format = 1\nold = true", "has format 1, this program reads format 3"),
        ];
        for (content, reason) in cases {
            fs::write(&path, content).expect("a file");
            let error = Model::load(&path).expect_err(reason).to_string();
            assert!(error.contains(reason), "{error}");
        }
        fs::write(&path, SHIPPED).expect("a file");
        assert_eq!(Model::load(&path).expect("the shipped model is sound"), Model::embedded());
    }

    /// The error of a file in which the value at a path is another one, or is missing if `value` is empty.
    pub(in crate::model) fn altered(file: &ModelFile, path: &str, value: &str) -> String {
        let mut content = toml::Table::try_from(file).expect("TOML");
        let (folder, name) = path.rsplit_once('.').unwrap_or(("", path));
        let folders = folder.split('.').filter(|name| !name.is_empty());
        let table = folders.fold(&mut content, |table, name| table[name].as_table_mut().expect("a table"));
        table.remove(name);
        if !value.is_empty() {
            table.insert(name.to_owned(), value.parse().expect("a value"));
        }
        content.try_into::<ModelFile>().expect("a file").to_model().map(drop).expect_err(path).to_string()
    }

    /// The text of a table with an entry for each of the first features.
    pub(in crate::model) fn features(count: usize, entry: fn(FeatureId) -> String) -> String {
        let entries: Vec<_> = (0..count).filter_map(FeatureId::from_index).map(entry).collect();
        format!("{{ {} }}", entries.join(", "))
    }

    #[test]
    fn a_model_that_does_not_name_its_network_of_the_eyes_is_read_as_before() {
        let mut file = file();
        let named = file.to_model().expect("a model");
        let network = file.eyes.as_mut().and_then(|eyes| eyes.network.take());
        assert!(network == Some(EYES_NETWORK) && file.to_model().expect("a model") == named);
    }

    #[test]
    fn faults_name_the_entry_in_one_line() {
        let input = "{ neutral = 0.0, weights = [inf] }";
        let shape = toml::Value::try_from(BlendshapeTable::default()).expect("TOML").to_string();
        let inputs = features(471, |id| format!("{id} = {{ neutral = 0.0, weights = [] }}"));
        let units = format!("[{}]", "0.0, ".repeat(161));
        let nothing = "{ inputs = {}, blendshapes = {} }";
        let formulas = format!("{{ neutral_known = {nothing}, neutral_unknown = {nothing} }}");
        let terms = |lift, response| format!("{{ shift = 0.0, slope = 1.0, lift = {lift}, response = {response} }}");
        for (entry, path, value) in [
            ("blendshapes.jawOpen of", "blendshapes.jawOpen", ""),
            ("\"jawOpened\"", "blendshapes.jawOpened", &shape),
            ("blendshapes.jawOpen", "blendshapes.jawOpen.offset", "nan"),
            ("blendshapes.jawOpen", "blendshapes.jawOpen.weights", "[1e300]"),
            ("blendshapes.jawOpen", "blendshapes.jawOpen.weights", &units),
            ("inputs.y14", "inputs.y14", input),
            ("inputs", "inputs", &inputs),
            (r#""line\n\u{1b}end" in inputs"#, "inputs.line\n\u{1b}end", input),
            ("offsets.neutral_known", "offsets.neutral_known", &units),
            ("either offsets", "offsets", ""),
            ("either offsets", "formulas", &formulas),
            ("gaze.inputs.x468", "gaze.inputs.x468.weights", "[1e300]"),
            ("\"x999\" in gaze.inputs", "gaze.inputs.x999", input),
            ("gaze.offsets.neutral_unknown", "gaze.offsets.neutral_unknown", "[0.0, 0.0, 0.0]"),
            ("eyes.inputs", "eyes.inputs.x468", "[1e300]"),
            ("\"x999\" in eyes.inputs", "eyes.inputs.x999", "[]"),
            ("not as many rows as there are values", "eyes.values", "[]"),
            ("another network of the eyes", "eyes.network", "305419896"),
            ("correction.jawOpen", "correction.jawOpen", &terms("-0.2", "[0.4, 0.8]")),
            ("correction.jawOpen", "correction.jawOpen", &terms("0.2", "[0.8, 0.8]")),
            ("correction.jawOpen", "correction.jawOpen", &terms("nan", "[0.4, 0.8]")),
            ("appearance.landmarks.13 of", "appearance.landmarks.13", ""),
            ("\"12\" in appearance.landmarks", "appearance.landmarks.12", "''"),
            ("appearance.landmarks.13 of", "appearance.landmarks.13", "'AAAA'"),
            ("appearance.blendshapes.jawOpen", "appearance.blendshapes.jawOpen", ""),
            ("list of appearance", "appearance.scales", "[1.0]"),
            ("appearance.offsets", "appearance.offsets", &format!("[{}]", "inf, ".repeat(APPEARANCE_UNITS))),
        ] {
            let error = altered(&file(), path, value);
            assert!(error.contains(entry) && !error.contains(char::is_control), "{path}: {error}");
        }
    }
}
