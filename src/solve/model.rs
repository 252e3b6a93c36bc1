//! The numbers of a fitted model, and the bytes that they are built into the program as.
//!
//! The build script compiles this file, too: it reads `models/blendshapes.toml` and writes the bytes.

use super::{COEFFS, feature_id::FeatureId};

/// Most units of the hidden layer.
pub const MAX_HIDDEN: usize = 120;
/// Most features that are selected (eq. 4): with [`MAX_HIDDEN`] units they make a model of 256 KiB.
pub const MAX_INPUTS: usize = 470;

/// One number for each hidden unit. Units that a model does not use have 0.
pub(super) type Hidden = [f32; MAX_HIDDEN];

/// A fitted regression, `h = max(0, W x + a)` and `R = V h + b`. It takes at most 256 KiB.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    /// The selected features, `W`.
    pub(super) inputs: Box<[Input]>,
    /// `a` where the wearer's neutral face is known, and where it is not.
    pub(super) offsets: [Hidden; 2],
    /// The blendshapes, `V` and `b`.
    pub(super) outputs: Box<[Output]>,
}

/// A selected feature and its column of `W`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Input {
    pub(super) feature: FeatureId,
    /// Mean of the feature over neutral faces.
    pub(super) neutral: f32,
    pub(super) weights: Hidden,
}

/// A blendshape: its row of `V` and its number of `b`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Output {
    pub(super) offset: f32,
    pub(super) weights: Hidden,
}

impl Output {
    /// An output that is always 0.
    pub(super) const ZERO: Self = Self { offset: 0.0, weights: [0.0; MAX_HIDDEN] };
}

impl Model {
    /// Size of the model in memory, bytes.
    #[must_use]
    pub fn size_bytes(&self) -> usize {
        size_of_val(&*self.inputs) + size_of_val(&*self.outputs) + size_of::<Self>()
    }

    /// The model as little-endian words of 4 bytes: both offsets, then offset and weights of each blendshape, then
    /// index, neutral value and weights of each feature.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut write = |numbers: &[f32]| bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
        self.offsets.iter().for_each(|row| write(row));
        for Output { offset, weights } in &self.outputs {
            write(&[*offset]);
            write(weights);
        }
        for Input { feature, neutral, weights } in &self.inputs {
            // An f32 holds every index exactly.
            write(&[feature.index() as f32, *neutral]);
            write(weights);
        }
        bytes
    }

    /// Reads what [`Model::to_bytes`] wrote, or returns `None` if the bytes are not a model.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "an index")]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
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
            inputs.push(Input { feature: FeatureId::from_index(feature as usize)?, neutral, weights: words.take()? });
        }
        Some(Self { inputs: inputs.into(), offsets, outputs: outputs.into() })
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
