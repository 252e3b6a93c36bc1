//! Packs the weights of all layers into one block of memory.

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

/// The weights of the layers that have been packed so far.
pub(super) struct Packing<'a> {
    graph: &'a Graph,
    kernels: &'static Kernels,
    maps: &'a [Map],
    layout: Layout,
    packed: Vec<(Range<usize>, Vec<f32>)>,
}

impl<'a> Packing<'a> {
    pub(super) fn new(graph: &'a Graph, kernels: &'static Kernels, maps: &'a [Map]) -> Self {
        Self { graph, kernels, maps, layout: Layout::default(), packed: Vec::new() }
    }

    /// The memory of all weights.
    pub(super) fn memory(self) -> Result<Memory, Error> {
        let mut memory = self.layout.memory()?;
        for (range, values) in self.packed {
            memory.all_mut()[range].copy_from_slice(&values);
        }
        Ok(memory)
    }

    pub(super) fn layer(&mut self, layer: &fusion::Layer, division: Division) -> Result<Layer, Error> {
        let work = self.work(layer)?;
        let activation = match layer.activation {
            fusion::Activation::None => Activation::None,
            fusion::Activation::Relu => Activation::Relu,
            fusion::Activation::Prelu(slopes) => {
                let channels = self.maps[layer.output].channels;
                Activation::Prelu(self.append(pack::padded(slopes.iter().copied(), channels)))
            }
        };
        let products = layer.products(self.graph);
        Ok(Layer { work, input: layer.input, output: layer.output, activation, products, division })
    }

    fn work(&mut self, layer: &fusion::Layer) -> Result<Work, Error> {
        let (kernels, maps) = (self.kernels, self.maps);
        let (from, to) = (&maps[layer.input], &maps[layer.output]);
        Ok(match &layer.work {
            fusion::Work::Stem { window, weights, bias } => {
                let channels = bias.len();
                check_matrix_size([to.channels, weights.len() / channels])?;
                Work::Stem {
                    size: window.size,
                    stride: window.stride,
                    span: window.size * from.true_channels,
                    weights: self.append(pack::stem(kernels, weights, channels)),
                    bias: self.append(pack::padded(bias.iter().copied(), to.channels)),
                }
            }
            fusion::Work::Block { depthwise, weights, bias, residual } => {
                if *residual != Residual::None && to.channels < from.channels {
                    return Err(Error::Unsupported("a sum has fewer channels than an operand"));
                }
                check_matrix_size([to.channels, from.channels])?;
                Work::Block {
                    depthwise: depthwise.map(|depthwise| {
                        let weights = pack::depthwise(kernels, depthwise.weights, from.true_channels);
                        Depthwise { stride: depthwise.stride, weights: self.append(weights) }
                    }),
                    weights: self.append(pack::pointwise(kernels, weights, from.true_channels, to.true_channels)),
                    bias: self.append(pack::pointwise_bias(kernels, bias, weights, *depthwise)),
                    residual: *residual,
                }
            }
            fusion::Work::Dense { weights, bias } => {
                let shape = self.graph.tensors()[layer.input];
                check_matrix_size([to.channels, from.rows * from.row])?;
                Work::Dense {
                    weights: self.append(pack::dense(kernels, weights, shape, bias.len())),
                    bias: self.append(pack::padded(bias.iter().copied(), to.channels)),
                }
            }
            fusion::Work::Gather { inputs } => Work::Gather { inputs: inputs.clone() },
        })
    }

    /// Appends values to the packed weights and returns their place.
    fn append(&mut self, values: Vec<f32>) -> Range<usize> {
        let range = self.layout.area(values.len());
        self.packed.push((range.clone(), values));
        range
    }
}

/// Refuses a matrix of weights that is larger than the memory of a network may be.
fn check_matrix_size([outputs, inputs]: [usize; 2]) -> Result<(), Error> {
    let values = outputs.saturating_mul(inputs);
    if values <= Layout::LARGEST { Ok(()) } else { Err(Error::Unsupported("a matrix of weights is too large")) }
}
