//! A network that is ready to run: weights in the order of the kernels, a schedule of strips, and one block of memory.

use std::ops::Range;

use crate::arena::{Layout, Memory};
use crate::error::Error;
use crate::fusion::{self, Layer, Residual, Work};
use crate::graph::{Graph, Shape, Window};
use crate::kernels::{self, Activation, Kernels};
use crate::pack;
use crate::schedule::{Needs, Rows, Schedule, Step};

/// A network with its memory. Running it allocates nothing, locks nothing and cannot fail.
pub struct Network {
    kernels: &'static Kernels,
    layers: Vec<Ready>,
    steps: Vec<Step>,
    maps: Vec<Map>,
    input: Input,
    outputs: Vec<Range<usize>>,
    scratch: Scratch,
    weights: Memory,
    arena: Memory,
}

/// A map in memory.
#[derive(Debug, Clone)]
struct Map {
    area: Range<usize>,
    rows: usize,
    /// Rows that are kept; row `y` lies where row `y % kept` does.
    kept: usize,
    /// Values of a row.
    row: usize,
    columns: usize,
    /// Padded channels.
    channels: usize,
    /// Channels without the padding.
    true_channels: usize,
}

impl Map {
    /// Where some rows lie within the map's area. They must lie beside each other.
    fn rows(&self, rows: Range<usize>) -> Range<usize> {
        let start = rows.start % self.kept * self.row;
        start..start + rows.len() * self.row
    }
}

/// Where the caller's values go.
#[derive(Debug)]
struct Input {
    rows: usize,
    /// Values of a row that the caller writes.
    values: usize,
    /// The first value.
    start: usize,
    /// From one row to the next.
    step: usize,
}

/// Memory that every strip uses anew.
#[derive(Debug)]
struct Scratch {
    /// A row outside a map. Nothing writes it.
    zeros: Range<usize>,
    operand: Range<usize>,
    largest: Range<usize>,
}

/// A layer whose weights are packed. Ranges are those of the weights' memory.
struct Ready {
    work: ReadyWork,
    input: usize,
    output: usize,
    activation: ReadyActivation,
    products: usize,
}

enum ReadyWork {
    Stem { size: usize, stride: usize, span: usize, weights: Range<usize>, bias: Range<usize> },
    Block { depthwise: Option<(usize, Range<usize>)>, weights: Range<usize>, bias: Range<usize>, residual: Residual },
    Dense { weights: Range<usize>, bias: Range<usize> },
    Gather { inputs: Vec<usize> },
}

enum ReadyActivation {
    None,
    Relu,
    Prelu(Range<usize>),
}

impl Network {
    /// Prepares a network for the kernels of an instruction set.
    ///
    /// # Errors
    /// [`Error::Unsupported`] if the network does not consist of the layers that this engine knows.
    pub fn new(graph: &Graph, kernels: &'static Kernels) -> Result<Self, Error> {
        Builder::new(graph, kernels)?.network()
    }

    /// One row of the input, to be written before a run: pixel by pixel, and channel by channel within a pixel.
    ///
    /// # Panics
    /// If the input has no such row.
    pub fn input_row(&mut self, row: usize) -> &mut [f32] {
        assert!(row < self.input.rows, "the input has {} rows", self.input.rows);
        let start = self.input.start + row * self.input.step;
        &mut self.arena.all_mut()[start..start + self.input.values]
    }

    /// Number of rows of the input.
    #[must_use]
    pub fn input_rows(&self) -> usize {
        self.input.rows
    }

    /// The values of an output after a run: row by row, pixel by pixel and channel by channel.
    ///
    /// # Panics
    /// If there is no such output.
    #[must_use]
    pub fn output(&self, index: usize) -> &[f32] {
        &self.arena.all()[self.outputs[index].clone()]
    }

    /// Number of outputs.
    #[must_use]
    pub fn outputs(&self) -> usize {
        self.outputs.len()
    }

    /// Computes the outputs from the input.
    pub fn run(&mut self) {
        for step in 0..self.steps.len() {
            self.run_step(step);
        }
    }

    /// Computes the outputs and hands `seen` the number of each layer after each of its strips.
    pub fn run_watched(&mut self, mut seen: impl FnMut(usize)) {
        for step in 0..self.steps.len() {
            self.run_step(step);
            seen(self.steps[step].layer);
        }
    }

    /// A name and the number of multiplications of each layer.
    #[must_use]
    pub fn layers(&self) -> Vec<(String, usize)> {
        self.layers.iter().map(|layer| (self.describe(layer), layer.products)).collect()
    }

    /// Bytes of packed weights, and of activations.
    #[must_use]
    pub fn memory(&self) -> [usize; 2] {
        [&self.weights, &self.arena].map(|memory| size_of_val(memory.all()))
    }

    fn describe(&self, layer: &Ready) -> String {
        let (from, to) = (&self.maps[layer.input], &self.maps[layer.output]);
        let kind = match &layer.work {
            ReadyWork::Stem { .. } => "stem",
            ReadyWork::Block { depthwise: None, .. } => "pointwise",
            ReadyWork::Block { depthwise: Some((1, _)), .. } => "block",
            ReadyWork::Block { .. } => "block /2",
            ReadyWork::Dense { .. } => "dense",
            ReadyWork::Gather { .. } => "gather",
        };
        format!("{kind} {}x{}x{} from {}", to.rows, to.columns, to.true_channels, from.true_channels)
    }

    fn run_step(&mut self, step: usize) {
        let Self { kernels, layers, steps, maps, scratch, weights, arena, .. } = self;
        let (Step { layer, rows }, weights, arena) = (&steps[step], weights.all(), arena.all_mut());
        let layer = &layers[*layer];
        let (from, to) = (&maps[layer.input], &maps[layer.output]);
        let activation = match &layer.activation {
            ReadyActivation::None => Activation::None,
            ReadyActivation::Relu => Activation::Relu,
            ReadyActivation::Prelu(slopes) => Activation::Prelu(&weights[slopes.clone()]),
        };
        if let ReadyWork::Gather { inputs } = &layer.work {
            return gather(arena, maps, inputs, to);
        }
        let areas = [&scratch.zeros, &scratch.operand, &scratch.largest, &from.area, &to.area].map(Clone::clone);
        let Ok([zeros, operand, largest, input, output]) = arena.get_disjoint_mut(areas) else {
            debug_assert!(false, "the areas of the arena overlap");
            return;
        };
        let (zeros, input) = (&*zeros, &*input);
        let output = &mut output[to.rows(rows.clone())];
        match &layer.work {
            ReadyWork::Stem { size, stride, span, weights: packed, bias } => {
                for (row, output) in rows.clone().zip(output.chunks_exact_mut(to.row)) {
                    let mut covered = [&zeros[..0]; MAX_WINDOW];
                    for (covered, y) in covered.iter_mut().zip(row * stride..row * stride + size) {
                        *covered = &input[y * from.row..(y + 1) * from.row];
                    }
                    let task = kernels::Stem {
                        rows: &covered[..*size],
                        step: stride * from.true_channels,
                        span: *span,
                        weights: &weights[packed.clone()],
                        bias: &weights[bias.clone()],
                        activation,
                        pixels: to.columns,
                    };
                    (kernels.stem)(&task, output);
                }
            }
            ReadyWork::Block { depthwise, weights: packed, bias, residual } => {
                if let Some((stride, taps)) = depthwise {
                    let strip = Depthwise { kernels, stride: *stride, taps: &weights[taps.clone()], from, to };
                    strip.run(rows.clone(), [input, zeros], operand, largest, *residual == Residual::Largest);
                } else {
                    kernels.operand_of(&input[from.rows(rows.clone())], from.channels, operand);
                }
                let pixels = rows.len() * to.columns;
                let task = kernels::Pointwise {
                    operand,
                    pixels,
                    depth: from.channels,
                    channels: to.channels,
                    weights: &weights[packed.clone()],
                    bias: &weights[bias.clone()],
                    residual: match residual {
                        Residual::None => &[],
                        Residual::Input => &input[from.rows(rows.clone())],
                        Residual::Largest => largest,
                    },
                    residual_channels: if *residual == Residual::None { 0 } else { from.channels },
                    activation,
                };
                (kernels.pointwise)(&task, output);
            }
            ReadyWork::Dense { weights: packed, bias } => {
                let task = kernels::Dense { input, weights: &weights[packed.clone()], bias: &weights[bias.clone()] };
                (kernels.dense)(&task, output);
            }
            ReadyWork::Gather { .. } => {}
        }
    }
}

/// The depthwise convolution of a block.
struct Depthwise<'a> {
    kernels: &'static Kernels,
    stride: usize,
    taps: &'a [f32],
    from: &'a Map,
    to: &'a Map,
}

impl Depthwise<'_> {
    /// Computes output rows, two at a time where the stride is 1.
    fn run(
        &self,
        rows: Range<usize>,
        [input, zeros]: [&[f32]; 2],
        operand: &mut [f32],
        mut largest: &mut [f32],
        pool: bool,
    ) {
        let (from, columns) = (self.from, self.to.columns);
        let (mut row, mut first_pixel) = (rows.start, 0);
        while row < rows.end {
            let output_rows = if self.stride == 1 { (rows.end - row).min(2) } else { 1 };
            // The first row that the window covers, plus one: with stride 1 the window begins above the output row.
            let top = row * self.stride + self.stride - 1;
            let covered: [&[f32]; 4] = std::array::from_fn(|offset| match (top + offset).checked_sub(1) {
                Some(y) if y < from.rows => &input[from.rows(y..y + 1)],
                _ => &zeros[..from.row],
            });
            let task = kernels::Depthwise {
                rows: covered,
                output_rows,
                stride: self.stride,
                weights: self.taps,
                channels: from.channels,
                columns,
                first_pixel,
                pixels: rows.len() * columns,
            };
            let (here, rest) = if pool { largest.split_at_mut(columns * from.channels) } else { (&mut [][..], largest) };
            (self.kernels.depthwise)(&task, operand, here);
            largest = rest;
            row += output_rows;
            first_pixel += output_rows * columns;
        }
    }
}

/// Copies maps without their padding, one after the other.
fn gather(arena: &mut [f32], maps: &[Map], inputs: &[usize], to: &Map) {
    let mut at = to.area.start;
    for from in inputs.iter().map(|input| &maps[*input]) {
        for pixel in from.area.clone().step_by(from.channels) {
            arena.copy_within(pixel..pixel + from.true_channels, at);
            at += from.true_channels;
        }
    }
}

/// Rows of the largest window of the first layer.
const MAX_WINDOW: usize = 7;

/// Collects the parts of a network.
struct Builder<'a> {
    graph: &'a Graph,
    kernels: &'static Kernels,
    layers: Vec<Layer<'a>>,
    maps: Vec<Map>,
    layout: Layout,
    weight_layout: Layout,
    packed: Vec<(Range<usize>, Vec<f32>)>,
}

impl<'a> Builder<'a> {
    fn new(graph: &'a Graph, kernels: &'static Kernels) -> Result<Self, Error> {
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

    fn network(mut self) -> Result<Network, Error> {
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
        let outputs = outputs.into_iter().map(|output| {
            let map = &self.maps[output];
            map.area.start..map.area.start + map.rows * map.columns * map.true_channels
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
        let (from, to) = (&self.maps[layer.input], &self.maps[layer.output]);
        let strip = match to.columns {
            ..12 => to.rows,
            12..24 => 4,
            _ => 2,
        };
        let mut rows = Rows { inputs: vec![layer.input], output: layer.output, rows: to.rows, strip, needs: Needs::All };
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
        debug_assert!(from.rows >= to.rows || matches!(layer.work, Work::Gather { .. }));
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
        let map = &mut self.maps[tensor];
        let (rows, values) = (map.rows, map.columns * map.true_channels);
        let readers = self.layers.iter().filter(|layer| layer.input == tensor).count();
        if let Some((Window { size, stride, top, left }, output)) = self.layers.iter().find_map(stem) {
            if readers != 1 {
                return Err(Error::Unsupported("two layers read the picture"));
            }
            let to = self.graph.tensors()[output];
            let padded = |count: usize, before: usize, outputs: usize| (count + before).max((outputs - 1) * stride + size);
            // The kernels read rows of the window in vectors of four.
            map.row = (padded(map.columns, left, to.columns) * map.true_channels + 3).next_multiple_of(4);
            map.area = self.layout.area(padded(rows, top, to.rows) * map.row);
            let start = map.area.start + top * map.row + left * map.true_channels;
            return Ok(Input { rows, values, start, step: map.row });
        }
        if map.channels != map.true_channels {
            return Err(Error::Unsupported("the channels of the input do not fill a vector"));
        }
        map.kept = map.rows;
        map.area = self.layout.area(map.rows * map.row);
        Ok(Input { rows, values, start: map.area.start, step: map.row })
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
