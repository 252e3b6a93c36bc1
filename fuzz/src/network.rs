//! Compares the engine with plain operators on networks of random operators.

use facewire_engine::graph::{Kind, Operator, Port, Shape, Window};
use facewire_engine::kernels::{self, Kernels};
use facewire_engine::{Graph, Network, Values, reference};

use super::input::Input;

/// Largest number of steps that build a network. Each adds one operator or a few.
const STEPS: usize = 12;
/// Largest number of values in all tensors, so that a run takes less than a millisecond.
const MOST_VALUES: usize = 1 << 14;

/// Checks that a network of any operators whose shapes agree is refused as unsupported, or gives the outputs of the plain
/// operators on all kernels of this machine.
pub fn network(data: &[u8]) {
    let mut draft = Draft::new(data);
    for _ in 0..STEPS {
        if draft.input.0.is_empty() {
            break;
        }
        draft.operator();
    }
    let Some(graph) = draft.graph() else { return };
    let values: Vec<f32> = (0..graph.tensors()[0].elements()).map(weight).collect();
    let expected = reference::run(&graph, &values);
    for kernels in kernels::available() {
        let Ok(mut network) = Network::new(&graph, kernels) else { return };
        let rows = network.input_rows();
        for (row, values) in values.chunks(values.len() / rows).enumerate() {
            network.input_row(row).copy_from_slice(values);
        }
        for _ in 0..2 {
            network.run();
            for (index, expected) in expected.iter().enumerate() {
                compare(network.output(index), expected, kernels);
            }
        }
    }
}

/// Compares an output with the expected one. The tolerance is relative to the largest value, because rounding errors are
/// relative to the values that were added, and a sum can be much smaller than these. Numbers of half precision have 11 bits.
fn compare(found: &[f32], expected: &[f32], kernels: &Kernels) {
    assert_eq!(found.len(), expected.len());
    let scale = expected.iter().fold(1.0_f32, |scale, value| scale.max(value.abs()));
    let (name, tolerance) = (kernels.name, if kernels.half { 3e-2 } else { 1e-3 });
    for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() <= tolerance * scale, "{name}: value {at} is {found}, expected {expected}");
    }
}

/// A network to which operators are added one by one.
struct Draft<'a> {
    input: Input<'a>,
    tensors: Vec<Shape>,
    operators: Vec<Operator<'static>>,
    outputs: Vec<usize>,
}

impl<'a> Draft<'a> {
    fn new(data: &'a [u8]) -> Self {
        let mut input = Input(data);
        let mut side = |most: u8| usize::from(input.byte() % most) + 1;
        let tensors = vec![Shape { rows: side(40), columns: side(40), channels: side(20) }];
        Self { input, tensors, operators: Vec::new(), outputs: Vec::new() }
    }

    /// Takes a number from 0 to `most` from the fuzzer's bytes.
    fn upto(&mut self, most: usize) -> usize {
        usize::from(self.input.byte()) % (most + 1)
    }

    /// Adds an operator that reads one of the last four tensors.
    fn operator(&mut self) {
        let (kind, from) = (self.upto(9), self.tensors.len() - 1 - self.upto(self.tensors.len().min(4) - 1));
        let shape = self.tensors[from];
        let (inputs, mut to) = (vec![from], shape);
        match kind {
            0 => {
                let size = 1 + self.upto(4);
                let window =
                    Window { size, stride: 1 + self.upto(2), top: self.upto(size - 1), left: self.upto(size - 1) };
                let positions = |count: usize, before: usize| (count + before - 1) / window.stride + 1;
                to.rows = 1 + self.upto(positions(shape.rows, window.top) - 1);
                to.columns = 1 + self.upto(positions(shape.columns, window.left) - 1);
                self.convolution(window, inputs, to);
            }
            1 | 2 => self.convolution(Window { size: 1, stride: 1, top: 0, left: 0 }, inputs, shape),
            3 if shape.rows == shape.columns && shape.rows < 8 => {
                let window = Window { size: shape.rows, stride: 1, top: 0, left: 0 };
                self.convolution(window, inputs, Shape { rows: 1, columns: 1, ..shape });
            }
            4 => {
                self.depthwise(from);
            }
            5 => self.block(from),
            6 => self.add(Kind::Prelu { slopes: weights(shape.channels) }, inputs, shape),
            7 => {
                let same = (0..self.tensors.len()).rev().find(|other| *other != from && self.tensors[*other] == shape);
                self.add(Kind::Add, vec![from, same.unwrap_or(from)], shape);
            }
            8 => self.residual(from),
            _ => self.join_or_relu(from),
        }
        if self.upto(3) == 0 {
            self.outputs.push(self.tensors.len() - 1);
        }
    }

    fn convolution(&mut self, window: Window, inputs: Vec<usize>, to: Shape) {
        let to = Shape { channels: 1 + self.upto(39), ..to };
        let count = window.size * window.size * self.tensors[inputs[0]].channels * to.channels;
        self.add(Kind::Convolution { window, weights: weights(count), bias: weights(to.channels) }, inputs, to);
    }

    /// Adds a depthwise convolution, and returns the index of its output.
    fn depthwise(&mut self, from: usize) -> usize {
        let shape = self.tensors[from];
        let stride = if shape.rows % 2 + shape.columns % 2 == 0 { 1 + self.upto(1) } else { 1 };
        let to = Shape { rows: shape.rows / stride, columns: shape.columns / stride, ..shape };
        let window = Window { size: 3, stride, top: 2 - stride, left: 2 - stride };
        let (weights, bias) = (weights(9 * shape.channels), weights(shape.channels));
        self.add(Kind::Depthwise { window, weights, bias }, vec![from], to);
        self.tensors.len() - 1
    }

    /// Adds operators that the engine computes as one layer: a depthwise and a pointwise convolution, and the sum of their
    /// output and their input.
    fn block(&mut self, from: usize) {
        let depthwise = self.depthwise(from);
        let (shape, middle) = (self.tensors[from], self.tensors[depthwise]);
        let to = Shape { channels: shape.channels + self.upto(9), ..middle };
        let kind = Kind::Convolution {
            window: Window { size: 1, stride: 1, top: 0, left: 0 },
            weights: weights(shape.channels * to.channels),
            bias: weights(to.channels),
        };
        self.add(kind, vec![depthwise], to);
        let (mut other, sum) = (from, self.tensors.len() - 1);
        if middle.rows != shape.rows {
            let window = Window { size: 2, stride: 2, top: 0, left: 0 };
            self.add(Kind::MaxPool { window }, vec![other], middle);
            other = self.tensors.len() - 1;
        }
        if to.channels > shape.channels {
            self.add(Kind::PadChannels, vec![other], to);
            other = self.tensors.len() - 1;
        }
        self.add(Kind::Add, vec![other, sum], to);
    }

    /// Adds operators that can precede the sum of a block: a maximum over pixels, more channels, or both.
    fn residual(&mut self, from: usize) {
        let shape = self.tensors[from];
        let (added, is_even) = (self.upto(9), shape.rows % 2 + shape.columns % 2 == 0);
        if is_even && self.upto(1) == 1 {
            let window = Window { size: 2, stride: 2, top: 0, left: 0 };
            let half = Shape { rows: shape.rows / 2, columns: shape.columns / 2, ..shape };
            self.add(Kind::MaxPool { window }, vec![from], half);
        }
        let from = if is_even { self.tensors.len() - 1 } else { from };
        let to = Shape { channels: self.tensors[from].channels + added, ..self.tensors[from] };
        self.add(Kind::PadChannels, vec![from], to);
    }

    fn join_or_relu(&mut self, from: usize) {
        let shape = self.tensors[from];
        if self.upto(1) == 0 {
            return self.add(Kind::Relu, vec![from], shape);
        }
        let rows = 2 * shape.pixels();
        self.add(Kind::Concatenation, vec![from, from], Shape { rows, columns: 1, channels: shape.channels });
    }

    fn add(&mut self, kind: Kind<'static>, inputs: Vec<usize>, output: Shape) {
        let values: usize = self.tensors.iter().map(|shape| shape.elements()).sum();
        if values + output.elements() <= MOST_VALUES {
            self.tensors.push(output);
            self.operators.push(Operator { kind, inputs, output: self.tensors.len() - 1 });
        }
    }

    fn graph(mut self) -> Option<Graph<'static>> {
        self.outputs.retain(|output| *output > 0);
        self.outputs.push(self.tensors.len() - 1);
        let port = |tensor| Port { name: String::new(), tensor };
        let outputs = self.outputs.into_iter().map(port).collect();
        Graph::new(self.tensors, self.operators, port(0), outputs).ok()
    }
}

fn weights(count: usize) -> Values<'static> {
    (0..count).map(weight).collect::<Vec<_>>().into()
}

/// Weights of both signs that do not repeat soon, and small enough that sums hardly grow from layer to layer.
fn weight(at: usize) -> f32 {
    ((at * 37 + 11) % 101) as f32 / 202.0 - 0.25
}
