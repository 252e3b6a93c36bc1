//! Lays out the memory of a network and orders its strips.

use std::sync::Arc;

use super::layer::Work as PackedWork;
use super::map::{Input, Map};
use super::packing::Packing;
use super::strips::{Division, KEPT_MULTIPLE, Sharing};
use super::{Network, layer};
use crate::arena::Layout;
use crate::error::Error;
use crate::fusion::{self, Layer, Residual, Work};
use crate::graph::{Graph, Window};
use crate::kernels::Kernels;
use crate::schedule::{Needs, Rows, Schedule};
use crate::team::Team;

/// The layers and maps of a network.
pub(super) struct Builder<'a> {
    graph: &'a Graph<'a>,
    kernels: &'static Kernels,
    sharing: Sharing,
    layers: Vec<Layer<'a>>,
    maps: Vec<Map>,
    layout: Layout,
}

impl<'a> Builder<'a> {
    pub(super) fn new(graph: &'a Graph<'a>, kernels: &'static Kernels, sharing: Sharing) -> Result<Self, Error> {
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
        Ok(Self { graph, kernels, sharing, layers, maps, layout: Layout::default() })
    }

    pub(super) fn network(mut self, team: Option<Arc<Team>>) -> Result<Network, Error> {
        let outputs: Vec<usize> = self.graph.outputs().iter().map(|port| self.final_map(port.tensor)).collect();
        let divisions: Vec<Division> = self.layers.iter().map(|layer| self.division(layer)).collect();
        let rows: Vec<Rows> = self.layers.iter().zip(&divisions).map(|parts| self.rows_of(parts)).collect();
        let heights: Vec<usize> = self.maps.iter().map(|map| map.rows).collect();
        let schedule = Schedule::new(&rows, &heights, &outputs, KEPT_MULTIPLE);
        for (map, kept) in self.maps.iter_mut().zip(&schedule.kept_rows) {
            map.kept = *kept;
        }
        let input = self.lay_out()?;
        let mut packing = Packing::new(self.graph, self.kernels, &self.maps);
        let layers = self.layers.iter().zip(divisions).map(|(layer, division)| packing.layer(layer, division));
        let layers = layers.collect::<Result<Vec<_>, _>>()?;
        let weights = packing.memory()?;
        let mut scratch = Layout::default();
        let largest = layers.iter().map(|layer| self.scratch_of(layer)).max();
        let scratch_length = Layout::lines(largest.unwrap_or_default().max(1));
        scratch.area(self.sharing.threads * scratch_length);
        let (arena, scratch) = (self.layout.memory()?, scratch.memory()?);
        let outputs = self.graph.outputs().iter().zip(outputs).map(|(port, map)| {
            let start = self.maps[map].area.start;
            start..start + self.graph.tensors()[port.tensor].elements()
        });
        let outputs = outputs.collect();
        let (kernels, steps, maps) = (self.kernels, schedule.steps, self.maps);
        Ok(Network { kernels, layers, steps, maps, input, outputs, weights, arena, scratch, scratch_length, team })
    }

    /// The map that the caller reads for an output: the copy without padding, if there is one.
    fn final_map(&self, tensor: usize) -> usize {
        let first_copy = self.graph.tensors().len();
        let mut copies = self.layers.iter().filter(|layer| layer.output >= first_copy && layer.input == tensor);
        copies.next().map_or(tensor, |copy| copy.output)
    }

    fn division(&self, layer: &Layer) -> Division {
        let to = &self.maps[layer.output];
        match &layer.work {
            Work::Gather { .. } => Division::whole(to),
            Work::Dense { .. } => Division::of_panels(layer.products(self.graph), self.sharing),
            Work::Stem { .. } | Work::Block { .. } => Division::of_rows(to, layer.products(self.graph), self.sharing),
        }
    }

    fn rows_of(&self, (layer, division): (&Layer, &Division)) -> Rows {
        let (height, strip) = (self.maps[layer.output].rows, division.strip);
        let mut rows = Rows { inputs: vec![layer.input], output: layer.output, height, strip, needs: Needs::All };
        match &layer.work {
            // The caller has written the whole input.
            Work::Stem { .. } | Work::Dense { .. } => {}
            Work::Block { depthwise: None, .. } => rows.needs = Needs::Window { size: 1, stride: 1, above: 0 },
            Work::Block { depthwise: Some(depthwise), .. } => {
                let stride = depthwise.stride;
                rows.needs = Needs::Window { size: 3, stride, above: 2 - stride };
            }
            Work::Gather { inputs } => rows.inputs.clone_from(inputs),
        }
        rows
    }

    /// Lays out a row of zeros, the input, and the outputs of all layers in their order.
    fn lay_out(&mut self) -> Result<Input, Error> {
        let blocks = self.layers.iter().filter(|layer| matches!(layer.work, Work::Block { .. }));
        let zeros = blocks.map(|layer| self.maps[layer.input].row).max();
        self.layout.area(zeros.unwrap_or_default());
        let input = self.lay_out_input()?;
        for layer in &self.layers {
            let map = &mut self.maps[layer.output];
            map.area = self.layout.area(map.kept * map.row);
        }
        Ok(input)
    }

    /// Lays out the input. The first convolution reads it with the zeros around it, so that its windows need no check.
    fn lay_out_input(&mut self) -> Result<Input, Error> {
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

    /// Values of scratch memory that one thread needs for a layer.
    fn scratch_of(&self, layer: &layer::Layer) -> usize {
        let PackedWork::Block { residual, .. } = &layer.work else { return 0 };
        let (from, to) = (&self.maps[layer.input], &self.maps[layer.output]);
        let operand = layer.division.rows_at_a_time * to.columns * from.channels;
        if *residual == Residual::Largest { 2 * operand } else { operand }
    }
}
