//! The tables `offsets`, `inputs` and `blendshapes`: a network that all blendshapes share.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{ScoreTable, finite, for_each_blendshape};
use crate::solve::{
    feature_id::FeatureId,
    model::hidden_layer::{Hidden, HiddenLayer, Input, MAX_HIDDEN, MAX_INPUTS, Output},
    model_error::ModelError,
};

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

/// Checks every name and number of a hidden layer.
pub(super) fn read(
    offsets: &OffsetTable,
    inputs: &BTreeMap<String, InputTable>,
    blendshapes: &BTreeMap<String, BlendshapeTable>,
) -> Result<HiddenLayer, ModelError> {
    if inputs.len() > MAX_INPUTS {
        return Err(ModelError::TooMany { table: "inputs".to_owned() });
    }
    let OffsetTable { neutral_known, neutral_unknown } = offsets;
    let inputs = inputs.iter().map(|(name, table)| input(name, table)).collect::<Result<_, _>>()?;
    let offsets =
        [hidden("offsets.neutral_known", neutral_known)?, hidden("offsets.neutral_unknown", neutral_unknown)?];
    let without = Output { offset: 0.0, weights: [0.0; MAX_HIDDEN] };
    let outputs = for_each_blendshape("blendshapes", blendshapes, without, output)?;
    Ok(HiddenLayer::new(inputs, &offsets, &outputs))
}

fn input(name: &str, entry: &InputTable) -> Result<(Input, Hidden), ModelError> {
    let unknown = || ModelError::Unknown { table: "inputs".to_owned(), name: name.to_owned() };
    let table = format!("inputs.{name}");
    let feature = FeatureId::from_name(name).ok_or_else(unknown)?;
    let input = Input { feature, neutral: finite(&table, "neutral", entry.neutral)? };
    Ok((input, hidden(&table, &entry.weights)?))
}

fn output(table: &str, entry: &BlendshapeTable) -> Result<Output, ModelError> {
    Ok(Output { offset: finite(table, "offset", entry.offset)?, weights: hidden(table, &entry.weights)? })
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
