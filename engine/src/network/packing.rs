//! Packs the weights of all layers into one block of memory, straight from the file.

use std::ops::Range;

use super::layer::{Activation, Depthwise, Layer, Work};
use super::map::Map;
use super::strips::Division;
use crate::arena::{Layout, Memory};
use crate::error::Error;
use crate::fusion::{self, Residual};
use crate::graph::Graph;
use crate::kernels::Kernels;
use crate::pack;
use crate::values::Values;

/// Writes an array of packed weights.
type Fill<'a> = Box<dyn FnOnce(&mut [f32]) + 'a>;

/// Where the weights of the layers so far will lie, and how they are packed there.
pub(super) struct Packing<'a> {
    graph: &'a Graph<'a>,
    kernels: &'static Kernels,
    maps: &'a [Map],
    layout: Layout,
    arrays: Vec<(Range<usize>, Fill<'a>)>,
}

impl<'a> Packing<'a> {
    pub(super) fn new(graph: &'a Graph<'a>, kernels: &'static Kernels, maps: &'a [Map]) -> Self {
        Self { graph, kernels, maps, layout: Layout::default(), arrays: Vec::new() }
    }

    /// Packs the weights of all layers.
    pub(super) fn memory(self) -> Result<Memory, Error> {
        let mut memory = self.layout.memory()?;
        for (range, fill) in self.arrays {
            fill(&mut memory.all_mut()[range]);
        }
        Ok(memory)
    }

    pub(super) fn layer(&mut self, layer: &'a fusion::Layer, division: Division) -> Result<Layer, Error> {
        let work = self.work(layer)?;
        let activation = match layer.activation {
            fusion::Activation::None => Activation::None,
            fusion::Activation::Relu => Activation::Relu,
            fusion::Activation::Prelu(slopes) => Activation::Prelu(self.padded(slopes, layer)),
        };
        let products = layer.products(self.graph);
        Ok(Layer { work, input: layer.input, output: layer.output, activation, products, division })
    }

    fn work(&mut self, layer: &'a fusion::Layer) -> Result<Work, Error> {
        let (kernels, maps) = (self.kernels, self.maps);
        let (from, to) = (&maps[layer.input], &maps[layer.output]);
        Ok(match &layer.work {
            fusion::Work::Stem { window, weights, bias } => {
                let (channels, inputs) = (bias.len(), weights.len() / bias.len());
                let length = matrix([to.channels, inputs], false)?;
                Work::Stem {
                    size: window.size,
                    stride: window.stride,
                    span: window.size * from.true_channels,
                    weights: self.append(length, move |packed| pack::stem(packed, kernels, weights, channels)),
                    bias: self.padded(bias, layer),
                }
            }
            fusion::Work::Block { depthwise, weights, bias, residual } => {
                if *residual != Residual::None && to.channels < from.channels {
                    return Err(Error::Unsupported("a sum has fewer channels than an operand"));
                }
                let length = matrix([to.channels, from.channels], kernels.half)?;
                let (depthwise, inputs, outputs) = (*depthwise, from.true_channels, to.true_channels);
                Work::Block {
                    depthwise: depthwise.map(|depthwise| {
                        let fill =
                            move |packed: &mut [f32]| pack::depthwise(packed, kernels, depthwise.weights, inputs);
                        Depthwise { stride: depthwise.stride, weights: self.append(9 * from.channels, fill) }
                    }),
                    weights: self
                        .append(length, move |packed| pack::pointwise(packed, kernels, weights, inputs, outputs)),
                    bias: self
                        .append(to.channels, move |packed| pack::pointwise_bias(packed, bias, weights, depthwise)),
                    residual: *residual,
                }
            }
            fusion::Work::Dense { weights, bias } => {
                let (shape, half) = (self.graph.tensors()[layer.input], kernels.dense_half && weights.is_half());
                let length = matrix([to.channels, from.rows * from.row], half)?;
                let fill = move |packed: &mut [f32]| pack::dense(packed, kernels, weights, shape, bias.len(), half);
                Work::Dense { weights: self.append(length, fill), bias: self.padded(bias, layer), half }
            }
            fusion::Work::Gather { inputs } => Work::Gather { inputs: inputs.clone() },
        })
    }

    /// One value for each channel of a layer's output.
    fn padded(&mut self, values: &'a Values, layer: &fusion::Layer) -> Range<usize> {
        self.append(self.maps[layer.output].channels, |packed| pack::padded(packed, values))
    }

    /// Appends an array of `length` to the packed weights and returns its place.
    fn append(&mut self, length: usize, fill: impl FnOnce(&mut [f32]) + 'a) -> Range<usize> {
        let range = self.layout.area(length);
        self.arrays.push((range.clone(), Box::new(fill)));
        range
    }
}

/// The length of a packed matrix of weights. Refuses one with more values than the memory of a network may have.
fn matrix([outputs, inputs]: [usize; 2], half: bool) -> Result<usize, Error> {
    let values = outputs.saturating_mul(inputs);
    if values > Layout::LARGEST {
        return Err(Error::Unsupported("a matrix of weights is too large"));
    }
    Ok(if half { values / 2 } else { values })
}
