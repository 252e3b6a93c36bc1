//! The table `appearance` of a model file.

use std::collections::BTreeMap;

use base64::{Engine as _, prelude::BASE64_STANDARD};
use serde::{Deserialize, Serialize};

use super::{missing, output, row, unknown};
use crate::model::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS, APPEARANCE_UNITS, AppearanceLayer, ModelError};

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
    pub fn encode(weights: &[[i8; APPEARANCE_UNITS]]) -> String {
        BASE64_STANDARD.encode(weights.as_flattened().iter().map(|weight| weight.cast_unsigned()).collect::<Vec<_>>())
    }

    /// All lists with one number for each unit, and the names of their entries.
    fn lists(&self) -> impl Iterator<Item = (String, &[f64])> {
        let own = [("scales", &self.scales), ("offsets", &self.offsets)];
        let own = own.into_iter().map(|(name, list)| (format!("appearance.{name}"), list.as_slice()));
        own.chain(self.blendshapes.iter().flat_map(|(name, table)| {
            let rows = [&table.neutral_known, &table.neutral_unknown];
            rows.map(|row| (format!("appearance.blendshapes.{name}"), row.weights.as_slice()))
        }))
    }
}

impl TryFrom<&AppearanceTable> for AppearanceLayer {
    type Error = ModelError;

    fn try_from(table: &AppearanceTable) -> Result<Self, ModelError> {
        let names = APPEARANCE_LANDMARKS.map(|landmark| landmark.to_string());
        if let Some(name) = table.landmarks.keys().find(|name| !names.contains(name)) {
            return Err(unknown("appearance.landmarks", name));
        }
        let mut weights = Vec::new();
        for name in &names {
            let entry = format!("appearance.landmarks.{name}");
            let text = table.landmarks.get(name).ok_or_else(|| missing(&entry))?;
            let bytes = BASE64_STANDARD.decode(text).unwrap_or_default();
            check_length(&entry, bytes.len(), APPEARANCE_CHANNELS * APPEARANCE_UNITS)?;
            weights.extend(bytes.as_chunks().0.iter().map(|row: &[u8; _]| row.map(u8::cast_signed)));
        }
        for (entry, list) in table.lists() {
            check_length(&entry, list.len(), APPEARANCE_UNITS)?;
        }
        let output = |of: fn(&ResidualTable) -> &ResidualRow| {
            output::<APPEARANCE_UNITS, _>("appearance.blendshapes", &table.blendshapes, |table| {
                (of(table).offset, &of(table).weights)
            })
        };
        Ok(Self {
            weights: weights.into(),
            scales: row("appearance.scales", &table.scales)?,
            offsets: row("appearance.offsets", &table.offsets)?,
            outputs: [output(|table| &table.neutral_known)?, output(|table| &table.neutral_unknown)?],
        })
    }
}

fn check_length(entry: &str, length: usize, needed: usize) -> Result<(), ModelError> {
    if length == needed {
        return Ok(());
    }
    Err(ModelError::Invalid(format!(
        "{entry} of the model file is not the list of weights that it must be; restore the file"
    )))
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::model::{BLENDSHAPES, Model, ModelFile};

    /// A table whose weights, read as one list, count from -128 to 127 again and again.
    fn table() -> AppearanceTable {
        let rows: Vec<[i8; APPEARANCE_UNITS]> = (0..APPEARANCE_LANDMARKS.len() * APPEARANCE_CHANNELS)
            .map(|value| core::array::from_fn(|unit| (value * APPEARANCE_UNITS + unit) as i8))
            .collect();
        let landmarks = APPEARANCE_LANDMARKS.iter().zip(rows.chunks(APPEARANCE_CHANNELS));
        let row = |offset: f64| ResidualRow { offset, weights: vec![2.0 * offset; APPEARANCE_UNITS] };
        let residual = ResidualTable { neutral_known: row(0.25), neutral_unknown: row(0.5) };
        let shapes = BLENDSHAPES.iter().filter(|name| **name != "tongueOut");
        AppearanceTable {
            scales: vec![0.125; APPEARANCE_UNITS],
            offsets: vec![-1.5; APPEARANCE_UNITS],
            landmarks: landmarks.map(|(name, rows)| (name.to_string(), AppearanceTable::encode(rows))).collect(),
            blendshapes: shapes.map(|name| ((*name).to_owned(), residual.clone())).collect(),
        }
    }

    fn shipped_with(appearance: AppearanceTable) -> ModelFile {
        let file =
            ModelFile::parse(include_str!("../../../../models/blendshapes.toml")).expect("the shipped model is sound");
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
        assert_eq!(Model::from_bytes(&model.to_bytes()), Some(model));
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
