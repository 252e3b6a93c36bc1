//! A network that is ready to run: weights in the order of the kernels, a schedule of strips, and one block of memory.

mod builder;

use std::ops::Range;

use self::builder::Builder;
use crate::arena::Memory;
use crate::error::Error;
use crate::fusion::Residual;
use crate::graph::{Graph, Shape};
use crate::kernels::{self, Activation, Kernels};
use crate::schedule::Step;

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
    shape: Shape,
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
        let Shape { rows, columns, channels } = self.input.shape;
        assert!(row < rows, "the input has {rows} rows");
        let start = self.input.start + row * self.input.step;
        &mut self.arena.all_mut()[start..start + columns * channels]
    }

    /// Number of rows of the input.
    #[must_use]
    pub fn input_rows(&self) -> usize {
        self.input.shape.rows
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

    /// Computes the outputs and calls `seen` after each strip of rows, with the index of its layer in
    /// [`layers`](Self::layers). A layer has several strips, and the strips of different layers alternate. The time of a
    /// layer is the sum of the times between the calls for it and the calls, or the start of the run, before them.
    pub fn run_watched(&mut self, mut seen: impl FnMut(usize)) {
        for step in 0..self.steps.len() {
            self.run_step(step);
            seen(self.steps[step].layer);
        }
    }

    /// A description and the number of multiply-adds of each layer.
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
            let (here, rest) =
                if pool { largest.split_at_mut(columns * from.channels) } else { (&mut [][..], largest) };
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
