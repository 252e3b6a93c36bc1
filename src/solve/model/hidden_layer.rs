//! The numbers of a hidden layer, and the bytes that they are built into the program as.

use super::{COEFFS, FeatureId, Words};

/// Most units of the hidden layer.
pub const MAX_HIDDEN: usize = 120;
/// Most features that are selected (eq. 4): with [`MAX_HIDDEN`] units they make a model of 256 KiB.
pub const MAX_INPUTS: usize = 470;

/// One number for each hidden unit. Units that a model does not use have 0.
pub type Hidden = [f32; MAX_HIDDEN];

/// A network with one hidden layer, `h = max(0, W x + a)` and `R = V h + b`. It takes at most 256 KiB.
#[derive(Debug, Clone, PartialEq)]
pub struct HiddenLayer {
    /// The selected features.
    pub inputs: Box<[Input]>,
    /// The columns of `W`, one for each input.
    pub hidden_weights: Box<[Hidden]>,
    /// `a` where the wearer's neutral face is known, and where it is not.
    pub offsets: [Hidden; 2],
    /// The columns of `V`, one for each hidden unit.
    pub output_weights: Box<[[f32; COEFFS]]>,
    /// `b`.
    pub output_offsets: [f32; COEFFS],
}

/// A selected feature.
#[derive(Debug, Clone, PartialEq)]
pub struct Input {
    pub feature: FeatureId,
    /// Mean of the feature over neutral faces.
    pub neutral: f32,
}

/// A blendshape as model files contain it: its row of `V` and its element of `b`.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    pub offset: f32,
    pub weights: Hidden,
}

impl HiddenLayer {
    /// Puts the numbers of the inputs and of the blendshapes into the order in which the solver reads them.
    pub fn new(inputs: Vec<(Input, Hidden)>, offsets: &[Hidden; 2], outputs: &[Output]) -> Self {
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
        }
    }

    /// Size of what the layer points to, bytes.
    pub fn heap_bytes(&self) -> usize {
        size_of_val(&*self.inputs) + size_of_val(&*self.hidden_weights) + size_of_val(&*self.output_weights)
    }

    /// The layer as little-endian words of 4 bytes: both offsets, then offset and weights of each blendshape, then
    /// index, neutral value and weights of each feature.
    pub fn to_bytes(&self) -> Vec<u8> {
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

    /// Reads what [`HiddenLayer::to_bytes`] wrote, or returns `None` if the bytes are not a layer.
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
            let input = Input { feature: FeatureId::from_index(feature as usize)?, neutral };
            inputs.push((input, words.take()?));
        }
        Some(Self::new(inputs, &offsets, &outputs))
    }
}
