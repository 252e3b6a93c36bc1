//! The table `appearance` of a model file.

use std::collections::BTreeMap;

use base64::{Engine as _, prelude::BASE64_STANDARD};
use serde::{Deserialize, Serialize};

use super::super::{
    APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS, BLENDSHAPES, COEFFS,
    model::appearance::{APPEARANCE_UNITS, AppearanceLayer, ResidualOutput, UnitWeights, Units},
    model_error::ModelError,
};
use super::{WITHOUT_MODEL, finite};

/// A layer that reads the mesh network's feature map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AppearanceTable {
    /// What the weights of each unit are multiplied by.
    pub scales: Vec<f64>,
    /// Offset of each unit.
    pub offsets: Vec<f64>,
    /// The weights of each landmark, as signed bytes in base 64: for each channel of the map, one weight for each unit.
    pub landmarks: BTreeMap<String, String>,
    /// Residuals by the name of the blendshape.
    pub blendshapes: BTreeMap<String, ResidualTable>,
}

/// The residual of a blendshape.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResidualTable {
    /// Where the wearer's neutral face is known.
    pub neutral_known: ResidualRow,
    /// Where it is not known.
    pub neutral_unknown: ResidualRow,
}

/// A weighted sum of the units.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResidualRow {
    /// The residual where all units are 0.
    pub offset: f64,
    /// Weight of each unit.
    pub weights: Vec<f64>,
}

impl AppearanceTable {
    /// Writes the weights of a landmark, [`APPEARANCE_CHANNELS`] rows.
    #[must_use]
    pub fn encode(weights: &[UnitWeights]) -> String {
        BASE64_STANDARD.encode(weights.as_flattened().iter().map(|weight| weight.cast_unsigned()).collect::<Vec<_>>())
    }

    /// Checks every name and number and lays the numbers out for the solver.
    ///
    /// # Errors
    /// [`ModelError`], which names the table and the entry.
    pub fn to_layer(&self) -> Result<AppearanceLayer, ModelError> {
        let names = APPEARANCE_LANDMARKS.map(|landmark| landmark.to_string());
        refuse_unknown("appearance.landmarks", self.landmarks.keys(), |name| names.iter().any(|known| known == name))?;
        let is_shape = |name: &str| BLENDSHAPES.contains(&name) && name != WITHOUT_MODEL;
        refuse_unknown("appearance.blendshapes", self.blendshapes.keys(), is_shape)?;
        let mut weights = Vec::new();
        for name in &names {
            weights.extend(self.weights(name)?);
        }
        let units = |name: &str, numbers: &[f64]| units(&format!("appearance.{name}"), numbers);
        Ok(AppearanceLayer {
            weights: weights.into(),
            scales: units("scales", &self.scales)?,
            offsets: units("offsets", &self.offsets)?,
            outputs: [self.output(|table| &table.neutral_known)?, self.output(|table| &table.neutral_unknown)?],
        })
    }

    fn weights(&self, landmark: &str) -> Result<Vec<UnitWeights>, ModelError> {
        let name = || format!("appearance.landmarks.{landmark}");
        let text = self.landmarks.get(landmark).ok_or_else(|| ModelError::Missing { entry: name() })?;
        let bytes = BASE64_STANDARD.decode(text).unwrap_or_default();
        if bytes.len() != APPEARANCE_CHANNELS * APPEARANCE_UNITS {
            return Err(ModelError::NotWeights { entry: name() });
        }
        Ok(bytes.as_chunks().0.iter().map(|row: &[u8; _]| row.map(u8::cast_signed)).collect())
    }

    fn output(&self, row: impl Fn(&ResidualTable) -> &ResidualRow) -> Result<ResidualOutput, ModelError> {
        let mut output =
            ResidualOutput { weights: vec![[0.0; COEFFS]; APPEARANCE_UNITS].into(), offsets: [0.0; COEFFS] };
        for (index, name) in BLENDSHAPES.iter().enumerate().filter(|(_, name)| **name != WITHOUT_MODEL) {
            let entry = format!("appearance.blendshapes.{name}");
            let table = self.blendshapes.get(*name).ok_or_else(|| ModelError::Missing { entry: entry.clone() })?;
            let row = row(table);
            for (column, weight) in output.weights.iter_mut().zip(units(&entry, &row.weights)?) {
                column.get_mut(index).into_iter().for_each(|slot| *slot = weight);
            }
            let offset = finite(&entry, "offset", row.offset)?;
            output.offsets.get_mut(index).into_iter().for_each(|slot| *slot = offset);
        }
        Ok(output)
    }
}

fn refuse_unknown<'a>(
    table: &str,
    mut names: impl Iterator<Item = &'a String>,
    is_known: impl Fn(&str) -> bool,
) -> Result<(), ModelError> {
    match names.find(|name| !is_known(name)) {
        Some(name) => Err(ModelError::Unknown { table: table.to_owned(), name: name.clone() }),
        None => Ok(()),
    }
}

/// One number for each unit.
fn units(table: &str, numbers: &[f64]) -> Result<Units, ModelError> {
    if numbers.len() != APPEARANCE_UNITS {
        return Err(ModelError::NotWeights { entry: table.to_owned() });
    }
    let mut out = [0.0; APPEARANCE_UNITS];
    for (slot, number) in out.iter_mut().zip(numbers) {
        *slot = finite(table, "weights", *number)?;
    }
    Ok(out)
}

#[cfg(test)]
#[allow(
    clippy::expect_used,
    clippy::indexing_slicing,
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    clippy::float_cmp
)]
mod tests {
    use super::*;
    use crate::solve::{Model, model_file::ModelFile};

    /// A table whose weights, read as one list, count from -128 to 127 again and again.
    fn table() -> AppearanceTable {
        let rows: Vec<UnitWeights> = (0..APPEARANCE_LANDMARKS.len() * APPEARANCE_CHANNELS)
            .map(|value| core::array::from_fn(|unit| (value * APPEARANCE_UNITS + unit) as i8))
            .collect();
        let landmarks = APPEARANCE_LANDMARKS.iter().zip(rows.chunks(APPEARANCE_CHANNELS));
        let row = |offset: f64| ResidualRow { offset, weights: vec![2.0 * offset; APPEARANCE_UNITS] };
        let residual = ResidualTable { neutral_known: row(0.25), neutral_unknown: row(0.5) };
        let shapes = BLENDSHAPES.iter().filter(|name| **name != WITHOUT_MODEL);
        AppearanceTable {
            scales: vec![0.125; APPEARANCE_UNITS],
            offsets: vec![-1.5; APPEARANCE_UNITS],
            landmarks: landmarks.map(|(name, rows)| (name.to_string(), AppearanceTable::encode(rows))).collect(),
            blendshapes: shapes.map(|name| ((*name).to_owned(), residual.clone())).collect(),
        }
    }

    fn shipped_with(appearance: AppearanceTable) -> ModelFile {
        let file =
            ModelFile::parse(include_str!("../../../models/blendshapes.toml")).expect("the shipped model is sound");
        ModelFile { appearance: Some(appearance), ..file }
    }

    fn refusal(change: impl FnOnce(&mut AppearanceTable)) -> String {
        let mut table = table();
        change(&mut table);
        shipped_with(table).to_model().expect_err("a fault was put in").to_string()
    }

    #[test]
    fn weights_keep_their_places_through_text_and_bytes() {
        let text = toml::to_string(&shipped_with(table())).expect("TOML");
        assert!(text.len() <= 1 << 20, "the file takes {} bytes", text.len());
        let model = ModelFile::parse(&text).expect("the same file").to_model().expect("a model");
        assert!(model.size_bytes() <= 1 << 20, "{}", model.size_bytes());
        let layer = model.appearance.as_ref().expect("a layer");
        assert!((layer.weights[100][5] - (100 * APPEARANCE_UNITS + 5) as i8).abs() < 1);
        assert_eq!(layer.outputs[1].weights[7][..51], [1.0; 51]);
        assert_eq!(layer.outputs[0].offsets, core::array::from_fn(|shape| if shape < 51 { 0.25 } else { 0.0 }));
        assert_eq!(Model::from_bytes(&model.to_bytes().expect("a hidden layer")), Some(model));
    }

    #[test]
    fn bytes_that_are_cut_short_are_no_model() {
        let bytes = shipped_with(table()).to_model().expect("a model").to_bytes().expect("a hidden layer");
        assert_eq!(Model::from_bytes(&bytes[..bytes.len() - 4]), None);
        assert_eq!(Model::from_bytes(&[&bytes[..], &[0; 4]].concat()), None);
    }

    #[test]
    fn faults_are_named_with_their_entry() {
        let missing = refusal(|table| _ = table.landmarks.remove("13"));
        assert!(missing.contains("no appearance.landmarks.13"), "{missing}");
        let shape = refusal(|table| _ = table.blendshapes.remove("jawOpen"));
        assert!(shape.contains("no appearance.blendshapes.jawOpen"), "{shape}");
        let unknown = refusal(|table| _ = table.landmarks.insert("12".to_owned(), String::new()));
        assert!(unknown.contains("unknown \"12\" in appearance.landmarks"), "{unknown}");
        for text in ["", "AAAA", "not base 64"] {
            let wrong = refusal(|table| _ = table.landmarks.insert("13".to_owned(), text.to_owned()));
            assert!(wrong.contains("appearance.landmarks.13 of the model file is not"), "{wrong}");
        }
        assert!(refusal(|table| table.scales.truncate(31)).contains("appearance.scales of the model file is not"));
        let infinite = refusal(|table| table.offsets[0] = f64::INFINITY);
        assert!(infinite.contains("in appearance.offsets of the model file is not finite"), "{infinite}");
    }
}
