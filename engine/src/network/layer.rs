//! A layer whose weights are packed, and the work of one thread on it.

use std::array;
use std::ops::Range;

use super::MAX_SHARES;
use super::map::Map;
use super::strips::Division;
use crate::fusion::Residual;
use crate::kernels::{self, Kernels};

/// A layer whose weights are packed. Its ranges lie in the memory of the packed weights.
pub(super) struct Layer {
    pub work: Work,
    /// The map that the layer reads.
    pub input: usize,
    /// The map that the layer writes.
    pub output: usize,
    pub activation: Activation,
    /// Number of multiply-adds.
    pub products: usize,
    pub division: Division,
}

pub(super) enum Work {
    Stem { size: usize, stride: usize, span: usize, weights: Range<usize>, bias: Range<usize> },
    Block { depthwise: Option<Depthwise>, weights: Range<usize>, bias: Range<usize>, residual: Residual },
    Dense { weights: Range<usize>, bias: Range<usize>, half: bool },
    Gather { inputs: Vec<usize> },
}

#[derive(Clone)]
pub(super) struct Depthwise {
    pub stride: usize,
    pub weights: Range<usize>,
}

pub(super) enum Activation {
    None,
    Relu,
    Prelu(Range<usize>),
}

impl Layer {
    pub(super) fn describe(&self, from: &Map, to: &Map) -> String {
        let kind = match &self.work {
            Work::Stem { .. } => "stem",
            Work::Block { depthwise: None, .. } => "pointwise",
            Work::Block { depthwise: Some(Depthwise { stride: 1, .. }), .. } => "block",
            Work::Block { .. } => "block /2",
            Work::Dense { .. } => "dense",
            Work::Gather { .. } => "gather",
        };
        format!("{kind} {}x{}x{} from {}", to.rows, to.columns, to.true_channels, from.true_channels)
    }
}

/// The part of a layer that one thread computes, and the memory that this thread alone uses meanwhile.
pub(super) struct Share<'a> {
    /// Output rows, or panels of outputs of a dense layer.
    pub range: Range<usize>,
    /// The memory that the range is written to.
    pub output: &'a mut [f32],
    pub scratch: &'a mut [f32],
}

impl<'a> Share<'a> {
    /// Divides a share among threads. A row or panel has `values` values, and each thread uses `scratch` values of scratch
    /// memory. Returns the shares at the beginning of an array, and their number.
    pub(super) fn divide(self, division: &Division, values: usize, scratch: usize) -> ([Share<'a>; MAX_SHARES], usize) {
        let per_share = division.share_size(self.range.len());
        let count = self.range.len().div_ceil(per_share);
        let mut starts = self.range.step_by(per_share);
        let mut outputs = self.output.chunks_mut(per_share * values);
        let mut scratch = self.scratch.chunks_mut(scratch);
        let shares = array::from_fn(|_| {
            let (start, output) = (starts.next().unwrap_or_default(), outputs.next().unwrap_or_default());
            let range = start..start + output.len() / values;
            Share { range, output, scratch: scratch.next().unwrap_or_default() }
        });
        (shares, count)
    }
}

/// The data that all threads read while they compute a layer.
pub(super) struct Sources<'a> {
    pub kernels: &'static Kernels,
    pub layer: &'a Layer,
    pub from: &'a Map,
    pub to: &'a Map,
    /// All packed weights.
    pub weights: &'a [f32],
    /// The area of the map `from`.
    pub input: &'a [f32],
    /// Zeros, at least as many as a row of `from` has values.
    pub zeros: &'a [f32],
}

impl Sources<'_> {
    /// Computes a share.
    pub(super) fn compute(&self, share: &mut Share) {
        match &self.layer.work {
            Work::Stem { size, stride, span, weights, bias } => {
                let task = kernels::Stem {
                    rows: &[],
                    step: stride * self.from.true_channels,
                    span: *span,
                    weights: &self.weights[weights.clone()],
                    bias: &self.weights[bias.clone()],
                    activation: self.activation(),
                    pixels: self.to.columns,
                };
                self.stem(*size, *stride, task, share);
            }
            Work::Block { .. } => self.block(share),
            Work::Dense { weights, bias, half } => {
                self.dense(&self.weights[weights.clone()], &self.weights[bias.clone()], *half, share);
            }
            // `Network::run_step` copies maps by itself.
            Work::Gather { .. } => {}
        }
    }

    fn stem(&self, size: usize, stride: usize, task: kernels::Stem, share: &mut Share) {
        for (row, output) in share.range.clone().zip(share.output.chunks_exact_mut(self.to.row)) {
            let mut covered = [&self.zeros[..0]; MAX_WINDOW];
            for (covered, y) in covered.iter_mut().zip(row * stride..row * stride + size) {
                *covered = &self.input[y * self.from.row..(y + 1) * self.from.row];
            }
            (self.kernels.stem)(&kernels::Stem { rows: &covered[..size], ..task }, output);
        }
    }

    fn dense(&self, weights: &[f32], bias: &[f32], half: bool, share: &mut Share) {
        let panel = self.kernels.dense_panel;
        let outputs = share.range.start * panel..share.range.end * panel;
        let in_weights = |output: usize| output * self.input.len() / if half { 2 } else { 1 };
        let weights = &weights[in_weights(outputs.start)..in_weights(outputs.end)];
        (self.kernels.dense)(&kernels::Dense { input: self.input, weights, half, bias: &bias[outputs] }, share.output);
    }

    pub(super) fn activation(&self) -> kernels::Activation<'_> {
        match &self.layer.activation {
            Activation::None => kernels::Activation::None,
            Activation::Relu => kernels::Activation::Relu,
            Activation::Prelu(slopes) => kernels::Activation::Prelu(&self.weights[slopes.clone()]),
        }
    }
}

/// Copies maps without their padding, one after the other.
pub(super) fn gather<'a>(maps: impl Iterator<Item = &'a Map>, arena: &[f32], mut output: &mut [f32]) {
    for from in maps {
        for pixel in arena[from.area.clone()].chunks_exact(from.channels) {
            let Some((copy, rest)) = output.split_at_mut_checked(from.true_channels) else { return };
            copy.copy_from_slice(&pixel[..from.true_channels]);
            output = rest;
        }
    }
}

/// Rows of the largest window of the first layer.
const MAX_WINDOW: usize = 7;
