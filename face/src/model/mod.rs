//! The numbers of a fitted model; [`ModelFile`] is the text that they are read from. The build script compiles this module,
//! too, and writes the bytes of the files in `models/` that the program contains.

mod file;
mod formulas;

use std::{fmt, io, path::PathBuf};

use serde::{Deserialize, Serialize};

use crate::{BLENDSHAPES, COEFFS, LANDMARKS};
pub use file::{
    AppearanceTable, BlendshapeTable, EyesTable, GazeTable, InputTable, ModelFile, ResidualRow, ScoreTable,
};
#[cfg(test)]
pub(crate) use formulas::ScaledInput;
pub(crate) use formulas::{Formula, FormulaSet, MAX_PRODUCTS};
pub use formulas::{
    FormulaKind, FormulaScoreTable, FormulaSetTable, FormulaTable, LIFT, MAX_EXPONENT, MAX_FORMULA_INPUTS,
    MAX_MULTIPLIED, Response, product_index, signed_logarithm,
};

/// Most units of the hidden layer.
pub const MAX_HIDDEN: usize = 160;
/// Most features that the hidden layer selects (eq. 4): with [`MAX_HIDDEN`] units, their weights take 294 KiB.
pub const MAX_INPUTS: usize = 470;
/// Units of the layer that reads how a face looks.
pub const APPEARANCE_UNITS: usize = 32;
/// Values of the mesh network's feature map at each landmark.
pub const APPEARANCE_CHANNELS: usize = 32;
/// The landmarks at which the map is read, with each its mirror image: not the outline of the face, behind which lies the
/// background.
pub const APPEARANCE_LANDMARKS: [u16; 180] = [
    0, 1, 2, 3, 5, 6, 7, 9, 13, 14, 17, 33, 34, 36, 37, 39, 40, 46, 49, 50, 55, 61, 63, 66, 68, 69, 71, 78, 79, 80, 81,
    82, 84, 87, 88, 91, 95, 98, 104, 105, 108, 116, 117, 119, 121, 123, 133, 134, 135, 137, 138, 139, 140, 143, 144,
    145, 146, 147, 151, 153, 154, 155, 156, 157, 158, 159, 160, 161, 163, 170, 173, 175, 177, 178, 181, 185, 187, 188,
    191, 192, 193, 194, 200, 205, 208, 210, 212, 213, 215, 216, 217, 221, 223, 227, 246, 248, 249, 263, 264, 266, 267,
    269, 270, 276, 279, 280, 285, 291, 293, 296, 298, 299, 301, 308, 309, 310, 311, 312, 314, 317, 318, 321, 324, 327,
    333, 334, 337, 345, 346, 348, 350, 352, 362, 363, 364, 366, 367, 368, 369, 372, 373, 374, 375, 376, 380, 381, 382,
    383, 384, 385, 386, 387, 388, 390, 395, 398, 401, 402, 405, 409, 411, 412, 415, 416, 417, 418, 425, 428, 430, 432,
    433, 435, 436, 437, 441, 443, 447, 466, 468, 473,
];

/// Values that the network of the eyes gives for each eye.
pub const EYE_VALUES: usize = 32;
/// Sums of the layer that reads these values: yaw and pitch directly, then the hidden units.
pub const EYE_SUMS: usize = 2 + 64;

/// Pairs of landmarks whose distance, unlike their coordinates, survives errors of the head's rotation.
#[rustfmt::skip]
pub(crate) const DISTANCES: [(usize, usize); 35] = [
    (159, 145), (158, 153), (160, 144), (386, 374), (385, 380), (387, 373), (468, 33), (468, 133), (473, 362),
    (473, 263), (468, 159), (468, 145), (473, 386), (473, 374), (13, 14), (61, 291), (0, 17), (78, 308), (82, 87),
    (312, 317), (37, 84), (267, 314), (164, 0), (61, 33), (291, 263), (61, 1), (291, 1), (105, 159), (334, 386),
    (55, 285), (152, 1), (152, 17), (205, 50), (50, 4), (280, 4),
];

const TURNS: [&str; 3] = ["yaw", "pitch", "roll"];
pub(crate) const COORDINATES: usize = 3 * LANDMARKS;
/// Number of features that are measured on the face: coordinates, then distances.
pub const MEASURES: usize = COORDINATES + DISTANCES.len();
/// Number of features of a face.
pub const FEATURES: usize = MEASURES + TURNS.len();

/// A feature of a face: a coordinate of a landmark, the distance of two landmarks, or how far the head is turned.
///
/// Its name says which: `x159`, `y159` and `z159` are coordinates of landmark 159, and `d159-145` is a distance, in eye
/// distances. `yaw`, `pitch` and `roll` are about the sines of these angles.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct FeatureId(u16);

impl FeatureId {
    /// The feature with this index, or `None` if it is not below [`FEATURES`].
    pub fn from_index(index: usize) -> Option<Self> {
        (index < FEATURES).then(|| u16::try_from(index).ok().map(Self))?
    }

    /// The feature's index.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }

    /// Reads a name as [`FeatureId`] displays it.
    pub fn from_name(name: &str) -> Option<Self> {
        if let Some(turn) = TURNS.iter().position(|known| *known == name) {
            return Self::from_index(MEASURES + turn);
        }
        let (kind, rest) = name.split_at_checked(1)?;
        if kind == "d" {
            let (a, b) = rest.split_once('-')?;
            let pair = (a.parse().ok()?, b.parse().ok()?);
            return Self::from_index(COORDINATES + DISTANCES.iter().position(|known| *known == pair)?);
        }
        let axis = ["x", "y", "z"].iter().position(|known| *known == kind)?;
        let landmark = rest.parse::<usize>().ok().filter(|landmark| *landmark < LANDMARKS)?;
        Self::from_index(3 * landmark + axis)
    }
}

impl fmt::Display for FeatureId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let index = self.index();
        if let Some(turn) = index.checked_sub(MEASURES).and_then(|turn| TURNS.get(turn)) {
            return f.write_str(turn);
        }
        match index.checked_sub(COORDINATES).and_then(|distance| DISTANCES.get(distance)) {
            Some((a, b)) => write!(f, "d{a}-{b}"),
            None => write!(f, "{}{}", ['x', 'y', 'z'].get(index % 3).unwrap_or(&'x'), index / 3),
        }
    }
}

/// A model that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file is missing or cannot be read, perhaps because its disk is not mounted yet.
    #[error("the model {} cannot be read ({source}); check the path and its permissions", path.display())]
    #[allow(missing_docs, reason = "the types say it")]
    Unreadable { path: PathBuf, source: io::Error },
    /// The file is damaged, of another format, or holds what no model has: a sentence that names the entry and the remedy.
    #[error("{0}")]
    Invalid(String),
}

/// A fitted regression, the layer that adds to it, and the terms that correct the sum.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Model {
    pub(crate) regression: Regression,
    /// The layer that reads how the face looks.
    pub(crate) appearance: Option<AppearanceLayer>,
    /// The map from points of the eyes to where they look.
    pub(crate) gaze: Option<GazeLayer>,
    /// The layer from pictures of the eyes to where they look.
    pub(crate) eyes: Option<EyesLayer>,
    /// The corrective terms.
    pub correction: Correction,
}

/// What a model has for wearers whose neutral face is known, and for those whose is not.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs, reason = "the names say it")]
pub struct Cases<T> {
    pub neutral_known: T,
    pub neutral_unknown: T,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[expect(clippy::large_enum_variant, reason = "a solver has one model, and the larger variant is the usual one")]
pub(crate) enum Regression {
    HiddenLayer(HiddenLayer),
    Formulas(Cases<FormulaSet>),
}

impl Model {
    /// The numbers of the model as bytes.
    #[allow(clippy::expect_used, clippy::missing_panics_doc, reason = "lists of numbers can be written to memory")]
    pub fn to_bytes(&self) -> Vec<u8> {
        postcard::to_allocvec(self).expect("numbers in memory")
    }

    pub(crate) fn from_bytes(bytes: &[u8]) -> Option<Self> {
        postcard::take_from_bytes(bytes).ok().filter(|(_, rest)| rest.is_empty()).map(|(model, _)| model)
    }
}

/// A network with one hidden layer, `h = max(0, W x + a)` and `R = V h + b`. Units that a model does not use have 0.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct HiddenLayer {
    pub(crate) inputs: Box<[Input]>,
    /// The columns of `W`, each with [`MAX_HIDDEN`] weights, one column for each input.
    pub(crate) weights: Box<[f32]>,
    /// `a` where the wearer's neutral face is known, and where it is not.
    #[serde(with = "list")]
    pub(crate) offsets_known: [f32; MAX_HIDDEN],
    #[serde(with = "list")]
    pub(crate) offsets_unknown: [f32; MAX_HIDDEN],
    pub(crate) output: Output,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Input {
    pub(crate) feature: FeatureId,
    /// Mean of the feature over neutral faces.
    pub(crate) neutral: f32,
}

/// A layer `h = s W x + a` with the residual `V h + b`, where `x` are the values of the feature map. It takes 198 KB.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct AppearanceLayer {
    /// The columns of `W`, each with [`APPEARANCE_UNITS`] weights, one column for each value of the map: landmark by
    /// landmark, and channel by channel.
    pub(crate) weights: Box<[i8]>,
    pub(crate) scales: [f32; APPEARANCE_UNITS],
    pub(crate) offsets: [f32; APPEARANCE_UNITS],
    pub(crate) outputs: Cases<Output>,
}

/// A map `W x + a` from points of the eyes to yaw and pitch in degrees, with `a` as in [`HiddenLayer`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct GazeLayer {
    pub(crate) inputs: Box<[GazeInput]>,
    pub(crate) offsets: Cases<[f32; 2]>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct GazeInput {
    pub(crate) feature: FeatureId,
    /// Mean of the feature over neutral faces.
    pub(crate) neutral: f32,
    pub(crate) weights: [f32; 2],
}

/// A layer `s = W x + a` of features and of the values of the network of the eyes. Yaw and pitch in degrees are the first two
/// sums plus `V max(0, s)` of the other ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct EyesLayer {
    pub(crate) inputs: Box<[FeatureId]>,
    /// The columns of `W`: one for each feature, then for each value of the right eye, then of the left.
    pub(crate) weights: Box<[f32]>,
    #[serde(with = "list")]
    pub(crate) offsets: [f32; EYE_SUMS],
    /// The columns of `V`.
    pub(crate) outputs: Box<[[f32; 2]]>,
}

/// From the units of a layer to blendshapes: `V h + b`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Output {
    /// The columns of `V`, each with [`COEFFS`] weights, one column for each unit.
    pub(crate) weights: Box<[f32]>,
    #[serde(with = "list")]
    pub(crate) offsets: [f32; COEFFS],
}

/// The corrective terms of one blendshape (eq. 7).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CorrectiveTerms {
    /// `beta`: what is added to the result of the regression.
    pub shift: f32,
    /// `1 - gamma`: the factor on small values.
    pub slope: f32,
    /// `1/eta`: what is added to the factor at the top of the range.
    pub lift: f32,
    /// The values at which the response function `g` begins and ends to rise.
    pub response: [f32; 2],
}

impl CorrectiveTerms {
    /// Terms that change nothing.
    pub const NONE: Self = Self { shift: 0.0, slope: 1.0, lift: 0.0, response: [0.5, 0.9] };
    /// The terms of the eyelids where the model states none: full closure reads 0.7 and becomes 0.99.
    const EYE_BLINK: Self = Self { lift: 0.42, response: [0.4, 0.7], ..Self::NONE };

    /// Whether the terms are finite and keep the order of values.
    pub fn keep_order(&self) -> bool {
        let Self { shift, slope, lift, response: [from, to] } = *self;
        let are_finite = [shift, slope, lift, from, to].iter().all(|number| number.is_finite());
        are_finite && slope > 0.0 && lift >= 0.0 && 0.0 <= from && from < to
    }
}

/// The corrective terms of all blendshapes, in the order of [`BLENDSHAPES`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Correction(#[serde(with = "list")] pub [CorrectiveTerms; COEFFS]);

impl Default for Correction {
    /// The terms of a model that states none: only the eyelids are lifted.
    fn default() -> Self {
        let is_blink = |name: &str| name.starts_with("eyeBlink");
        Self(BLENDSHAPES.map(|name| if is_blink(name) { CorrectiveTerms::EYE_BLINK } else { CorrectiveTerms::NONE }))
    }
}

/// Writes an array as a list, because serde knows no arrays of more than 32.
mod list {
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

    pub fn serialize<S: Serializer, T: Serialize, const N: usize>(array: &[T; N], to: S) -> Result<S::Ok, S::Error> {
        array.as_slice().serialize(to)
    }

    pub fn deserialize<'a, D: Deserializer<'a>, T: Deserialize<'a>, const N: usize>(
        from: D,
    ) -> Result<[T; N], D::Error> {
        Vec::deserialize(from)?.try_into().map_err(|_| D::Error::custom("a list of another length"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_feature_is_found_by_its_name_and_other_names_are_refused() {
        for index in 0..FEATURES {
            let id = FeatureId::from_index(index).expect("below the count");
            assert_eq!(FeatureId::from_name(&id.to_string()), Some(id));
        }
        assert_eq!(FeatureId::from_index(FEATURES), None);
        for name in ["", "x", "x478", "y-1", "w3", "d1-2", "d159", "é1"] {
            assert_eq!(FeatureId::from_name(name), None, "{name}");
        }
    }
}
