//! The model as a file that people can read and compare (TOML).
//!
//! ```toml
//! format = 2
//! made_by = "facewire-fit train ..."
//! fitted_on = "..."
//!
//! [offsets]                   # of the hidden units, 120 at most
//! neutral_known = [0.1, -0.3]
//! neutral_unknown = [0.2, -0.1]
//!
//! [inputs.d13-14]             # a selected feature: its mean over neutral faces, its weight for each hidden unit
//! neutral = 0.05
//! weights = [1.9, -0.4]
//!
//! [blendshapes.jawOpen]       # its weight of each hidden unit
//! neutral_known = { r = 0.95, mse = 0.004 }     # held-out subjects, after eq. 7
//! neutral_unknown = { r = 0.93, mse = 0.005 }
//! offset = 0.01
//! weights = [0.8, 0.1]
//! ```

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{
    BLENDSHAPES,
    features::FeatureId,
    model_error::ModelError,
    regression::{Hidden, Input, MAX_HIDDEN, MAX_INPUTS, Model, Output},
};

/// Version of the layout.
pub(super) const FORMAT: u32 = 2;
/// No landmark lies on the tongue: it has no model and stays 0.
const WITHOUT_MODEL: &str = "tongueOut";

/// The file as it is written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelFile {
    /// Version of the layout.
    pub format: u32,
    /// The command that made it.
    pub made_by: String,
    /// What it was fitted on, in words.
    pub fitted_on: String,
    /// Offsets of the hidden units.
    pub offsets: OffsetTable,
    /// Selected features by name.
    pub inputs: BTreeMap<String, InputTable>,
    /// Blendshapes by name.
    pub blendshapes: BTreeMap<String, BlendshapeTable>,
}

/// Offsets of the hidden units, one each.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OffsetTable {
    /// For displacements from the wearer's neutral face.
    pub neutral_known: Vec<f64>,
    /// For faces whose neutral is not known.
    pub neutral_unknown: Vec<f64>,
}

/// A selected feature.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputTable {
    /// Its mean over neutral faces.
    pub neutral: f64,
    /// Its weight for each hidden unit.
    pub weights: Vec<f64>,
}

/// A blendshape.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlendshapeTable {
    /// Score with the wearer's neutral face known.
    pub neutral_known: ScoreTable,
    /// Score without.
    pub neutral_unknown: ScoreTable,
    /// What it is where the hidden layer is 0.
    pub offset: f64,
    /// Weights of the hidden units.
    pub weights: Vec<f64>,
}

/// How well a blendshape is found for subjects that the fit did not see.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScoreTable {
    /// Pearson's correlation.
    pub r: f64,
    /// Mean squared error.
    pub mse: f64,
}

impl ModelFile {
    /// An empty file of the present format.
    #[must_use]
    pub fn new(made_by: String, fitted_on: String) -> Self {
        Self {
            format: FORMAT,
            made_by,
            fitted_on,
            offsets: OffsetTable::default(),
            inputs: BTreeMap::new(),
            blendshapes: BTreeMap::new(),
        }
    }

    /// Reads a file's text.
    ///
    /// # Errors
    /// [`ModelError::WrongFormat`] or [`ModelError::Damaged`].
    pub fn parse(text: &str) -> Result<Self, ModelError> {
        #[derive(Deserialize)]
        struct Header {
            format: u32,
        }
        let Header { format: found } = from_toml(text)?;
        if found != FORMAT {
            return Err(ModelError::WrongFormat { found });
        }
        from_toml(text)
    }

    /// Checks every name and number and lays the map out for the solver.
    ///
    /// # Errors
    /// [`ModelError`], naming the table and the entry.
    pub fn to_model(&self) -> Result<Model, ModelError> {
        if self.inputs.len() > MAX_INPUTS {
            return Err(ModelError::TooMany { table: "inputs".to_owned() });
        }
        let OffsetTable { neutral_known, neutral_unknown } = &self.offsets;
        Ok(Model {
            inputs: self.inputs.iter().map(|(name, table)| input(name, table)).collect::<Result<_, _>>()?,
            offsets: [
                hidden("offsets.neutral_known", neutral_known)?,
                hidden("offsets.neutral_unknown", neutral_unknown)?,
            ],
            outputs: self.outputs()?,
        })
    }

    fn outputs(&self) -> Result<Box<[Output]>, ModelError> {
        let is_known = |name: &str| BLENDSHAPES.contains(&name) && name != WITHOUT_MODEL;
        if let Some(name) = self.blendshapes.keys().find(|name| !is_known(name)) {
            return Err(ModelError::Unknown { table: "blendshapes".to_owned(), name: name.clone() });
        }
        let one = |name: &&'static str| match self.blendshapes.get(*name) {
            Some(table) => output(name, table),
            None if *name == WITHOUT_MODEL => Ok(Output::NOTHING),
            None => Err(ModelError::Missing { table: "blendshapes", blendshape: name }),
        };
        BLENDSHAPES.iter().map(one).collect()
    }
}

fn from_toml<T: DeserializeOwned>(text: &str) -> Result<T, ModelError> {
    toml::from_str(text).map_err(|error| {
        let before = text.get(..error.span().map_or(0, |span| span.start)).unwrap_or_default();
        ModelError::Damaged { line: 1 + before.matches('\n').count(), reason: error.message().to_owned() }
    })
}

fn input(name: &str, table: &InputTable) -> Result<Input, ModelError> {
    let unknown = || ModelError::Unknown { table: "inputs".to_owned(), name: name.to_owned() };
    let place = format!("inputs.{name}");
    Ok(Input {
        feature: FeatureId::from_name(name).ok_or_else(unknown)?,
        neutral: finite(&place, "neutral", table.neutral)?,
        weights: hidden(&place, &table.weights)?,
    })
}

fn output(name: &str, table: &BlendshapeTable) -> Result<Output, ModelError> {
    let place = format!("blendshapes.{name}");
    Ok(Output { offset: finite(&place, "offset", table.offset)?, weights: hidden(&place, &table.weights)? })
}

/// One number for each hidden unit; those that the file does not have are 0.
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

fn finite(table: &str, name: &str, weight: f64) -> Result<f32, ModelError> {
    #[expect(clippy::cast_possible_truncation, reason = "checked below")]
    let narrow = weight as f32;
    if narrow.is_finite() {
        return Ok(narrow);
    }
    Err(ModelError::NotFinite { table: table.to_owned(), name: name.to_owned() })
}

#[cfg(test)]
#[allow(clippy::expect_used)]
mod tests {
    use super::*;
    use std::path::Path;

    const SHIPPED: &str = include_str!("../../models/blendshapes.toml");

    fn shipped() -> ModelFile {
        ModelFile::parse(SHIPPED).expect("the shipped model is sound")
    }

    fn error_of(change: impl Fn(&mut ModelFile)) -> String {
        let mut file = shipped();
        change(&mut file);
        file.to_model().expect_err("a fault was put in").to_string()
    }

    #[test]
    fn missing_file_is_named() {
        let error = Model::load(Path::new("no/such/model.toml")).expect_err("there is none").to_string();
        assert!(error.contains("no/such/model.toml"), "{error}");
    }

    #[test]
    fn damaged_file_is_refused() {
        let cut = SHIPPED.get(..SHIPPED.len() / 2).expect("plain text");
        assert!(ModelFile::parse(cut).and_then(|file| file.to_model()).is_err());
        assert!(matches!(ModelFile::parse("\nformat = [1"), Err(ModelError::Damaged { line: 2, .. })));
        assert!(matches!(ModelFile::parse("format = 2"), Err(ModelError::Damaged { .. })));
    }

    #[test]
    fn other_format_is_told_from_damage() {
        assert!(matches!(ModelFile::parse("format = 1\nold = true"), Err(ModelError::WrongFormat { found: 1 })));
    }

    #[test]
    fn missing_and_unknown_blendshapes_are_named() {
        let mut file = shipped();
        let entry = file.blendshapes.remove("jawOpen").expect("it has a jaw");
        assert!(file.to_model().expect_err("no jaw").to_string().contains("blendshapes.jawOpen"));
        file.blendshapes.insert("jawOpened".to_owned(), entry);
        assert!(file.to_model().expect_err("no such jaw").to_string().contains("jawOpened"));
    }

    #[test]
    fn numbers_that_are_not_finite_are_named() {
        for wrong in [f64::NAN, f64::INFINITY, 1e300] {
            let jaw = |file: &mut ModelFile| file.blendshapes.entry("jawOpen".to_owned()).or_default().offset = wrong;
            assert!(error_of(jaw).contains("\"offset\" in blendshapes.jawOpen"));
            let input = |file: &mut ModelFile| file.inputs.entry("y14".to_owned()).or_default().weights = vec![wrong];
            assert!(error_of(input).contains("\"weights\" in inputs.y14"));
        }
    }

    #[test]
    fn an_unknown_feature_is_named() {
        let error = error_of(|file| _ = file.inputs.insert("q7".to_owned(), InputTable::default()));
        assert!(error.contains("unknown \"q7\" in inputs"), "{error}");
    }

    #[test]
    fn errors_fill_one_line_whatever_stands_in_names() {
        for weight in [1.0, f64::NAN] {
            let table = InputTable { neutral: weight, ..InputTable::default() };
            let error = error_of(|file| _ = file.inputs.insert("line\n\u{1b}end".to_owned(), table.clone()));
            assert!(error.contains(r#""line\n\u{1b}end""#) && !error.contains(char::is_control), "{error}");
        }
    }

    #[test]
    fn more_weights_than_fit_are_refused() {
        let wide = |file: &mut ModelFile| file.offsets.neutral_known = vec![0.0; MAX_HIDDEN + 1];
        assert!(error_of(wide).contains("offsets.neutral_known of the model file has more weights"));
        let many = |file: &mut ModelFile| {
            let names = (0..=MAX_INPUTS).filter_map(|index| FeatureId::from_index(index).map(|id| id.to_string()));
            file.inputs.extend(names.map(|name| (name, InputTable::default())));
        };
        assert!(error_of(many).contains("inputs of the model file has more weights"));
    }
}
