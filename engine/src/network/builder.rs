//! Packs the weights of a network, lays out its memory and orders its strips.

use std::ops::Range;

use super::{Input, Map, Network, Ready, ReadyActivation, ReadyWork, Scratch};
use crate::arena::Layout;
use crate::error::Error;
use crate::fusion::{self, Layer, Residual, Work};
use crate::graph::{Graph, Shape, Window};
use crate::kernels::Kernels;
use crate::pack;
use crate::schedule::{Needs, Rows, Schedule};

/// Collects the parts of a network.
pub(super) struct Builder<'a> {
    graph: &'a Graph,
    kernels: &'static Kernels,
    layers: Vec<Layer<'a>>,
    maps: Vec<Map>,
    layout: Layout,
    weight_layout: Layout,
    packed: Vec<(Range<usize>, Vec<f32>)>,
}

impl<'a> Builder<'a> {
    pub(super) fn new(graph: &'a Graph, kernels: &'static Kernels) -> Result<Self, Error> {
        let mut layers = fusion::layers(graph)?;
        let mut maps: Vec<Map> = graph.tensors().iter().map(|shape| Map::new(*shape, kernels.lanes)).collect();
        for layer in &layers {
            match &layer.work {
                Work::Dense { .. } => maps[layer.output].pad_channels(kernels.dense_panel),
                Work::Gather { .. } => maps[layer.output].pad_channels(1),
                _ => {}
            }
        }
        let written_by = |layer: &Layer| matches!(layer.work, Work::Dense { .. } | Work::Gather { .. });
        let flat: Vec<usize> = layers.iter().filter(|layer| written_by(layer)).map(|layer| layer.output).collect();
        let reads_flat = |layer: &Layer| !matches!(layer.work, Work::Gather { .. }) && flat.contains(&layer.input);
        if layers.iter().any(reads_flat) {
            return Err(Error::Unsupported("a convolution reads a dense layer or a concatenation"));
        }
        // Outputs whose channels are padded are copied without the padding.
        for port in graph.outputs() {
            let map = &maps[port.tensor];
            if map.channels != map.true_channels && map.rows * map.columns > 1 {
                let copy = Map { channels: map.true_channels, row: map.columns * map.true_channels, ..map.clone() };
                maps.push(copy);
                let (inputs, output) = (vec![port.tensor], maps.len() - 1);
                let work = Work::Gather { inputs };
                layers.push(Layer { work, input: port.tensor, output, activation: fusion::Activation::None });
            }
        }
        let (layout, weight_layout) = (Layout::default(), Layout::default());
        Ok(Self { graph, kernels, layers, maps, layout, weight_layout, packed: Vec::new() })
    }

    pub(super) fn network(mut self) -> Result<Network, Error> {
        let outputs: Vec<usize> = self.graph.outputs().iter().map(|port| self.final_map(port.tensor)).collect();
        let rows: Vec<Rows> = self.layers.iter().map(|layer| self.rows_of(layer)).collect();
        let heights: Vec<usize> = self.maps.iter().map(|map| map.rows).collect();
        let schedule = Schedule::new(&rows, &heights, &outputs, KEPT_MULTIPLE);
        for (map, kept) in self.maps.iter_mut().zip(&schedule.kept_rows) {
            map.kept = *kept;
        }
        let scratch = self.scratch(&rows);
        let input = self.input()?;
        for index in 0..self.maps.len() {
            if index != self.graph.input().tensor {
                let length = self.maps[index].kept * self.maps[index].row;
                self.maps[index].area = self.layout.area(length);
            }
        }
        let layers = std::mem::take(&mut self.layers);
        let layers = layers.iter().map(|layer| self.ready(layer)).collect::<Result<Vec<_>, _>>()?;
        let mut weights = self.weight_layout.memory()?;
        for (range, values) in self.packed {
            weights.all_mut()[range].copy_from_slice(&values);
        }
        let arena = self.layout.memory()?;
        let outputs = self.graph.outputs().iter().zip(outputs).map(|(port, map)| {
            let start = self.maps[map].area.start;
            start..start + self.graph.tensors()[port.tensor].elements()
        });
        let outputs = outputs.collect();
        let (kernels, steps, maps) = (self.kernels, schedule.steps, self.maps);
        Ok(Network { kernels, layers, steps, maps, input, outputs, scratch, weights, arena })
    }

    /// The map that the caller reads for an output: the copy without padding, if there is one.
    fn final_map(&self, tensor: usize) -> usize {
        let first_copy = self.graph.tensors().len();
        let mut copies = self.layers.iter().filter(|layer| layer.output >= first_copy && layer.input == tensor);
        copies.next().map_or(tensor, |copy| copy.output)
    }

    fn rows_of(&self, layer: &Layer) -> Rows {
        let to = &self.maps[layer.output];
        let strip = match to.columns {
            ..12 => to.rows,
            12..24 => 4,
            _ => 2,
        };
        let mut rows =
            Rows { inputs: vec![layer.input], output: layer.output, height: to.rows, strip, needs: Needs::All };
        match &layer.work {
            // The caller has written the whole input.
            Work::Stem { .. } => {}
            Work::Block { depthwise: None, .. } => rows.needs = Needs::Window { size: 1, stride: 1, above: 0 },
            Work::Block { depthwise: Some(depthwise), .. } => {
                let stride = depthwise.stride;
                rows.needs = Needs::Window { size: 3, stride, above: 2 - stride };
            }
            Work::Dense { .. } => rows.strip = to.rows,
            Work::Gather { inputs } => (rows.inputs, rows.strip) = (inputs.clone(), to.rows),
        }
        rows
    }

    fn scratch(&mut self, rows: &[Rows]) -> Scratch {
        let (mut operand, mut largest, mut zeros) = (0, 0, 0);
        for (layer, rows) in self.layers.iter().zip(rows) {
            if let Work::Block { .. } = layer.work {
                let (from, to) = (&self.maps[layer.input], &self.maps[layer.output]);
                let pixels = rows.strip * to.columns;
                operand = operand.max(pixels * from.channels);
                largest = largest.max(pixels * from.channels);
                zeros = zeros.max(from.row);
            }
        }
        let [zeros, operand, largest] = [zeros, operand, largest].map(|length| self.layout.area(length));
        Scratch { zeros, operand, largest }
    }

    /// Lays out the input. The first convolution reads it with the zeros around it, so that its windows need no check.
    fn input(&mut self) -> Result<Input, Error> {
        let tensor = self.graph.input().tensor;
        let stem = |layer: &Layer| match layer.work {
            Work::Stem { window, .. } if layer.input == tensor => Some((window, layer.output)),
            _ => None,
        };
        let shape = self.graph.tensors()[tensor];
        let map = &mut self.maps[tensor];
        let readers = self.layers.iter().filter(|layer| layer.input == tensor).count();
        if let Some((Window { size, stride, top, left }, output)) = self.layers.iter().find_map(stem) {
            if readers != 1 {
                return Err(Error::Unsupported("two layers read the picture"));
            }
            let to = self.graph.tensors()[output];
            let padded =
                |count: usize, before: usize, outputs: usize| (count + before).max((outputs - 1) * stride + size);
            // The kernels read rows of the window in vectors of four.
            map.row = (padded(map.columns, left, to.columns) * map.true_channels + 3).next_multiple_of(4);
            map.area = self.layout.area(padded(map.rows, top, to.rows) * map.row);
            let start = map.area.start + top * map.row + left * map.true_channels;
            return Ok(Input { shape, start, step: map.row });
        }
        if map.channels != map.true_channels {
            return Err(Error::Unsupported("the channels of the input do not fill a vector"));
        }
        map.kept = map.rows;
        map.area = self.layout.area(map.rows * map.row);
        Ok(Input { shape, start: map.area.start, step: map.row })
    }

    fn ready(&mut self, layer: &Layer<'a>) -> Result<Ready, Error> {
        let kernels = self.kernels;
        let (from, to) = (self.maps[layer.input].clone(), self.maps[layer.output].clone());
        let outputs = to.rows * to.columns;
        let (work, products) = match &layer.work {
            Work::Stem { window, weights, bias } => {
                let channels = bias.len();
                affordable([to.channels, weights.len() / channels])?;
                let work = ReadyWork::Stem {
                    size: window.size,
                    stride: window.stride,
                    span: window.size * from.true_channels,
                    weights: self.keep(pack::stem(kernels, weights, channels)),
                    bias: self.keep(pack::padded(bias.iter().copied(), to.channels)),
                };
                (work, outputs * weights.len())
            }
            Work::Block { depthwise, weights, bias, residual } => {
                if *residual != Residual::None && to.channels < from.channels {
                    return Err(Error::Unsupported("a sum has fewer channels than an operand"));
                }
                affordable([to.channels, from.channels])?;
                let work = ReadyWork::Block {
                    depthwise: depthwise.map(|depthwise| {
                        let taps = pack::depthwise(kernels, depthwise.weights, from.true_channels);
                        (depthwise.stride, self.keep(taps))
                    }),
                    weights: self.keep(pack::pointwise(kernels, weights, from.true_channels, to.true_channels)),
                    bias: self.keep(pack::pointwise_bias(kernels, bias, weights, *depthwise)),
                    residual: *residual,
                };
                (work, outputs * (weights.len() + depthwise.map_or(0, |depthwise| depthwise.weights.len())))
            }
            Work::Dense { weights, bias } => {
                let shape = self.graph.tensors()[layer.input];
                affordable([to.channels, from.rows * from.row])?;
                let work = ReadyWork::Dense {
                    weights: self.keep(pack::dense(kernels, weights, shape, bias.len())),
                    bias: self.keep(pack::padded(bias.iter().copied(), to.channels)),
                };
                (work, weights.len())
            }
            Work::Gather { inputs } => (ReadyWork::Gather { inputs: inputs.clone() }, 0),
        };
        let activation = match layer.activation {
            fusion::Activation::None => ReadyActivation::None,
            fusion::Activation::Relu => ReadyActivation::Relu,
            fusion::Activation::Prelu(slopes) => {
                ReadyActivation::Prelu(self.keep(pack::padded(slopes.iter().copied(), to.channels)))
            }
        };
        Ok(Ready { work, input: layer.input, output: layer.output, activation, products })
    }

    fn keep(&mut self, values: Vec<f32>) -> Range<usize> {
        let range = self.weight_layout.area(values.len());
        self.packed.push((range.clone(), values));
        range
    }
}

/// Refuses a matrix of weights that is larger than the memory of a network may be.
fn affordable([outputs, inputs]: [usize; 2]) -> Result<(), Error> {
    let values = outputs.saturating_mul(inputs);
    if values <= Layout::LARGEST { Ok(()) } else { Err(Error::Unsupported("a matrix of weights is too large")) }
}

/// Kept rows are a multiple of the rows of every strip, so that the rows of a strip lie beside each other.
const KEPT_MULTIPLE: usize = 4;

impl Map {
    fn new(shape: Shape, lanes: usize) -> Self {
        let Shape { rows, columns, channels } = shape;
        let padded = channels.next_multiple_of(lanes);
        let row = columns * padded;
        Self { area: 0..0, rows, kept: rows, row, columns, channels: padded, true_channels: channels }
    }

    fn pad_channels(&mut self, multiple: usize) {
        self.channels = self.true_channels.next_multiple_of(multiple);
        self.row = self.columns * self.channels;
    }
}
