//! The numbers of a fitted model, and the bytes that they are built into the program as.
//!
//! The build script compiles this file, too: it reads `models/blendshapes.toml` and writes the bytes.

pub(super) mod appearance;

use self::appearance::AppearanceLayer;
use super::{COEFFS, feature_id::FeatureId};

/// Most units of the hidden layer.
pub const MAX_HIDDEN: usize = 120;
/// Most features that are selected (eq. 4): with [`MAX_HIDDEN`] units they make a model of 256 KiB.
pub const MAX_INPUTS: usize = 470;

/// One number for each hidden unit. Units that a model does not use have 0.
pub(super) type Hidden = [f32; MAX_HIDDEN];

/// A fitted regression, `h = max(0, W x + a)` and `R = V h + b`, which takes at most 256 KiB, and the layer that adds to it.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// The selected features.
    pub(super) inputs: Box<[Input]>,
    /// The columns of `W`, one for each input.
    pub(super) hidden_weights: Box<[Hidden]>,
    /// `a` where the wearer's neutral face is known, and where it is not.
    pub(super) offsets: [Hidden; 2],
    /// The columns of `V`, one for each hidden unit.
    pub(super) output_weights: Box<[[f32; COEFFS]]>,
    /// `b`.
    pub(super) output_offsets: [f32; COEFFS],
    /// What reads how the face looks.
    pub(super) appearance: Option<AppearanceLayer>,
}

/// A selected feature.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Input {
    pub(super) feature: FeatureId,
    /// Mean of the feature over neutral faces.
    pub(super) neutral: f32,
}

/// A blendshape as model files contain it: its row of `V` and its element of `b`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Output {
    pub(super) offset: f32,
    pub(super) weights: Hidden,
}

impl Model {
    /// Puts the numbers of the inputs and of the blendshapes into the order in which the solver reads them.
    pub(super) fn new(inputs: Vec<(Input, Hidden)>, offsets: &[Hidden; 2], outputs: &[Output]) -> Self {
        let (inputs, hidden_weights): (Vec<_>, Vec<_>) = inputs.into_iter().unzip();
        let mut output_weights = vec![[0.0; COEFFS]; MAX_HIDDEN];
        let mut output_offsets = [0.0; COEFFS];
        for (index, output) in outputs.iter().enumerate() {
            let columns = output_weights.iter_mut().zip(&output.weights);
            let slots = columns.filter_map(|(column, weight)| Some((column.get_mut(index)?, *weight)));
            slots.for_each(|(slot, weight)| *slot = weight);
        }
        output_offsets.iter_mut().zip(outputs).for_each(|(offset, output)| *offset = output.offset);
        Self {
            inputs: inputs.into(),
            hidden_weights: hidden_weights.into(),
            offsets: *offsets,
            output_weights: output_weights.into(),
            output_offsets,
            appearance: None,
        }
    }

    /// Size of the model in memory, bytes.
    #[must_use]
    pub fn size_bytes(&self) -> usize {
        let weights = size_of_val(&*self.hidden_weights) + size_of_val(&*self.output_weights);
        let appearance = self.appearance.as_ref().map_or(0, AppearanceLayer::heap_bytes);
        size_of_val(&*self.inputs) + weights + appearance + size_of::<Self>()
    }

    /// The model as bytes: the length of the regression (u32, little-endian), the regression, and the layer if there is one.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let regression = self.regression_bytes();
        let length = u32::try_from(regression.len()).unwrap_or(u32::MAX);
        let appearance = self.appearance.iter().flat_map(AppearanceLayer::to_bytes);
        length.to_le_bytes().into_iter().chain(regression).chain(appearance).collect()
    }

    /// The regression as little-endian words of 4 bytes: both offsets, then offset and weights of each blendshape, then
    /// index, neutral value and weights of each feature.
    fn regression_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut write = |numbers: &[f32]| bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        self.offsets.iter().for_each(|row| write(row));
        for (index, offset) in self.output_offsets.iter().enumerate() {
            write(&[*offset]);
            self.output_weights.iter().filter_map(|column| column.get(index)).for_each(|weight| write(&[*weight]));
        }
        for (Input { feature, neutral }, weights) in self.inputs.iter().zip(&self.hidden_weights) {
            // An f32 holds every index exactly.
            write(&[feature.index() as f32, *neutral]);
            write(weights);
        }
        bytes
    }

    /// Reads what [`Model::to_bytes`] wrote, or returns `None` if the bytes are not a model.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (length, rest) = bytes.split_first_chunk()?;
        let (regression, appearance) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
        let appearance = match appearance {
            [] => None,
            bytes => Some(AppearanceLayer::from_bytes(bytes)?),
        };
        Some(Self { appearance, ..Self::regression(regression)? })
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
    fn regression(bytes: &[u8]) -> Option<Self> {
        let mut words = Words(bytes.as_chunks().0);
        let offsets = [words.take()?, words.take()?];
        let mut outputs = Vec::with_capacity(COEFFS);
        for _ in 0..COEFFS {
            let [offset] = words.take()?;
            outputs.push(Output { offset, weights: words.take()? });
        }
        let mut inputs = Vec::with_capacity(words.0.len() / (2 + MAX_HIDDEN));
        while !words.0.is_empty() {
            let [feature, neutral] = words.take()?;
            let input = Input { feature: FeatureId::from_index(feature as usize)?, neutral };
            inputs.push((input, words.take()?));
        }
        Some(Self::new(inputs, &offsets, &outputs))
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
