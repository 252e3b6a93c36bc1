//! The numbers of the layer that reads how a face looks, and the bytes that they are built into the program as.
//!
//! The build script compiles this file, too.

use super::super::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS, COEFFS};
use super::Words;

/// Units of the layer.
pub const APPEARANCE_UNITS: usize = 32;
/// Values that the layer reads.
pub const APPEARANCE_VALUES: usize = APPEARANCE_LANDMARKS.len() * APPEARANCE_CHANNELS;

/// One number for each unit.
pub(in crate::solve) type Units = [f32; APPEARANCE_UNITS];
/// The weights of one value for each unit.
pub(in crate::solve) type UnitWeights = [i8; APPEARANCE_UNITS];

/// A layer `h = s W x + a` with the residual `V h + b`. It takes 198 KB.
#[derive(Debug, Clone, PartialEq)]
pub struct AppearanceLayer {
    /// The columns of `W`, one for each value: landmark by landmark, and channel by channel.
    pub(in crate::solve) weights: Box<[UnitWeights]>,
    /// `s`.
    pub(in crate::solve) scales: Units,
    /// `a`.
    pub(in crate::solve) offsets: Units,
    /// `V` and `b` where the wearer's neutral face is known, and where it is not.
    pub(in crate::solve) outputs: [ResidualOutput; 2],
}

/// From units to residuals.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::solve) struct ResidualOutput {
    /// The columns of `V`, one for each unit.
    pub(in crate::solve) weights: Box<[[f32; COEFFS]]>,
    /// `b`.
    pub(in crate::solve) offsets: [f32; COEFFS],
}

impl AppearanceLayer {
    /// Bytes outside of the structure itself.
    pub(super) fn heap_bytes(&self) -> usize {
        size_of_val(&*self.weights) + self.outputs.iter().map(|output| size_of_val(&*output.weights)).sum::<usize>()
    }

    /// The layer as little-endian words of 4 bytes and, after them, the weights of all values.
    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let outputs = self
            .outputs
            .iter()
            .flat_map(|ResidualOutput { weights, offsets }| offsets.iter().chain(weights.as_flattened()));
        let words = self.scales.iter().chain(&self.offsets).chain(outputs);
        let weights = self.weights.as_flattened().iter().map(|weight| weight.cast_unsigned());
        words.flat_map(|number| number.to_le_bytes()).chain(weights).collect()
    }

    /// Reads what [`Self::to_bytes`] wrote, or returns `None` if the bytes are not a layer.
    pub(super) fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (numbers, weights) =
            bytes.split_at_checked(bytes.len().checked_sub(APPEARANCE_VALUES * APPEARANCE_UNITS)?)?;
        let mut words = Words(numbers.as_chunks().0);
        let (scales, offsets) = (words.take()?, words.take()?);
        let outputs = [words.output()?, words.output()?];
        let weights: Vec<_> = weights.as_chunks().0.iter().map(|row: &[u8; _]| row.map(u8::cast_signed)).collect();
        words.0.is_empty().then_some(Self { weights: weights.into(), scales, offsets, outputs })
    }
}

impl Words<'_> {
    fn output(&mut self) -> Option<ResidualOutput> {
        let offsets = self.take()?;
        let weights = (0..APPEARANCE_UNITS).map(|_| self.take()).collect::<Option<_>>()?;
        Some(ResidualOutput { weights, offsets })
    }
}

/// A layer with one unit, `0.01 * 50 x - 1`, where `x` is the second value of the first landmark. `cheekPuff` is
/// `0.1 + 0.4 h` where the neutral face is known, and `0.3 h` where it is not.
#[cfg(test)]
#[allow(clippy::indexing_slicing)]
pub(in crate::solve) fn test_layer() -> AppearanceLayer {
    let output = |weight, offset| {
        let (mut weights, mut offsets) = (vec![[0.0; COEFFS]; APPEARANCE_UNITS], [0.0; COEFFS]);
        (weights[3][21], offsets[21]) = (weight, offset);
        ResidualOutput { weights: weights.into(), offsets }
    };
    let mut weights = vec![[0; APPEARANCE_UNITS]; APPEARANCE_VALUES];
    let (mut scales, mut offsets) = ([1.0; APPEARANCE_UNITS], [0.0; APPEARANCE_UNITS]);
    (weights[1][3], scales[3], offsets[3]) = (50, 0.01, -1.0);
    AppearanceLayer { weights: weights.into(), scales, offsets, outputs: [output(0.4, 0.1), output(0.3, 0.0)] }
}
