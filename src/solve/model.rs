//! The numbers of a fitted model, and the bytes that they are built into the program as.
//!
//! The build script compiles this file, too: it reads `models/blendshapes.toml` and writes the bytes.

pub(super) mod appearance;
pub(super) mod correction;
pub(super) mod formulas;
pub(super) mod hidden_layer;

use self::{appearance::AppearanceLayer, correction::Correction, formulas::Formulas, hidden_layer::HiddenLayer};
use super::{BLENDSHAPES, COEFFS, feature_id::FeatureId};

/// A fitted regression, which takes at most 256 KiB, the layer that adds to it, and the terms that correct the sum.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    pub(super) regression: Regression,
    /// The layer that reads how the face looks.
    pub(super) appearance: Option<AppearanceLayer>,
    /// The corrective terms.
    pub correction: Correction,
}

/// From features to coefficients.
#[derive(Debug, Clone, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a solver has one model, and the larger variant is the usual one")]
pub(super) enum Regression {
    /// One network for all blendshapes.
    HiddenLayer(HiddenLayer),
    /// One formula for each blendshape.
    Formulas(Formulas),
}

impl Model {
    /// Size of the model in memory, bytes.
    #[must_use]
    pub fn size_bytes(&self) -> usize {
        let regression = match &self.regression {
            Regression::HiddenLayer(layer) => layer.heap_bytes(),
            Regression::Formulas(formulas) => formulas.heap_bytes(),
        };
        let appearance = self.appearance.as_ref().map_or(0, AppearanceLayer::heap_bytes);
        regression + appearance + size_of::<Self>()
    }

    /// The model as the program contains it, or `None` for formulas, which only files contain: the length of the
    /// regression (u32, little-endian), the regression, the corrective terms, and the layer if there is one.
    #[must_use]
    pub fn to_bytes(&self) -> Option<Vec<u8>> {
        let Regression::HiddenLayer(layer) = &self.regression else { return None };
        let regression = layer.to_bytes();
        let length = u32::try_from(regression.len()).unwrap_or(u32::MAX);
        let appearance = self.appearance.iter().flat_map(AppearanceLayer::to_bytes);
        Some(
            length
                .to_le_bytes()
                .into_iter()
                .chain(regression)
                .chain(self.correction.to_bytes())
                .chain(appearance)
                .collect(),
        )
    }

    /// Reads what [`Model::to_bytes`] wrote, or returns `None` if the bytes are not a model.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (length, rest) = bytes.split_first_chunk()?;
        let (regression, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        let (correction, appearance) = Correction::from_bytes(rest)?;
        let appearance = match appearance {
            [] => None,
            bytes => Some(AppearanceLayer::from_bytes(bytes)?),
        };
        Some(Self { appearance, correction, ..HiddenLayer::from_bytes(regression)?.into() })
    }
}

impl From<HiddenLayer> for Model {
    fn from(layer: HiddenLayer) -> Self {
        Self { regression: Regression::HiddenLayer(layer), appearance: None, correction: Correction::default() }
    }
}

impl From<Formulas> for Model {
    fn from(formulas: Formulas) -> Self {
        Self { regression: Regression::Formulas(formulas), appearance: None, correction: Correction::default() }
    }
}

/// The words that are still to be read.
struct Words<'a>(&'a [[u8; 4]]);

impl Words<'_> {
    /// Reads the next `N` numbers.
    fn take<const N: usize>(&mut self) -> Option<[f32; N]> {
        let (words, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(words.map(f32::from_le_bytes))
    }
}
