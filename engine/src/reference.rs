//! The plainest reading of every operator, to compare the fast kernels with.
//!
//! Sums are formed in `f64`, so that a difference is always the other side's rounding.

use crate::graph::{Graph, Kind, Operator, Shape, Window};

/// Runs a network operator by operator and returns the values of its outputs.
///
/// # Panics
/// If `input` has another size than the network's input.
#[must_use]
pub fn run(graph: &Graph, input: &[f32]) -> Vec<Vec<f32>> {
    let mut tensors = vec![Vec::new(); graph.tensors().len()];
    assert_eq!(input.len(), graph.tensors()[graph.input().tensor].elements(), "size of the input");
    tensors[graph.input().tensor] = input.to_vec();
    for operator in graph.operators() {
        tensors[operator.output] = compute(operator, graph.tensors(), &tensors);
    }
    graph.outputs().iter().map(|port| tensors[port.tensor].clone()).collect()
}

fn compute(operator: &Operator, shapes: &[Shape], tensors: &[Vec<f32>]) -> Vec<f32> {
    let (from, to) = (shapes[operator.inputs[0]], shapes[operator.output]);
    let first = &tensors[operator.inputs[0]];
    let channel_of = |at: usize| at % to.channels;
    match &operator.kind {
        Kind::Convolution { window, weights, bias } => each(to, |row, column, channel| {
            let mut sum = f64::from(bias.at(channel));
            for (tap, pixel) in window.pixels(from, row, column) {
                let at = (channel * window.size * window.size + tap) * from.channels;
                let pixel = &first[pixel * from.channels..][..from.channels];
                let products = (at..).zip(pixel).map(|(at, value)| f64::from(weights.at(at)) * f64::from(*value));
                sum += products.sum::<f64>();
            }
            sum
        }),
        Kind::Depthwise { window, weights, bias } => each(to, |row, column, channel| {
            let taps = window.pixels(from, row, column).map(|(tap, pixel)| {
                f64::from(weights.at(tap * from.channels + channel)) * f64::from(first[pixel * from.channels + channel])
            });
            f64::from(bias.at(channel)) + taps.sum::<f64>()
        }),
        Kind::MaxPool { window } => each(to, |row, column, channel| {
            let values = window.pixels(from, row, column).map(|(_, pixel)| first[pixel * from.channels + channel]);
            f64::from(values.fold(f32::NEG_INFINITY, f32::max))
        }),
        Kind::Prelu { slopes } => {
            let slope = |at: usize, value: f32| if value < 0.0 { value * slopes.at(channel_of(at)) } else { value };
            first.iter().enumerate().map(|(at, value)| slope(at, *value)).collect()
        }
        Kind::Relu => first.iter().map(|value| value.max(0.0)).collect(),
        Kind::Add => first.iter().zip(&tensors[operator.inputs[1]]).map(|(a, b)| a + b).collect(),
        Kind::PadChannels => each(to, |row, column, channel| {
            let at = (row * from.columns + column) * from.channels + channel;
            if channel < from.channels { f64::from(first[at]) } else { 0.0 }
        }),
        Kind::Concatenation => operator.inputs.iter().flat_map(|&input| tensors[input].clone()).collect(),
    }
}

#[expect(clippy::cast_possible_truncation, reason = "a sum is rounded once")]
fn each(shape: Shape, value: impl Fn(usize, usize, usize) -> f64) -> Vec<f32> {
    let mut values = Vec::with_capacity(shape.elements());
    for row in 0..shape.rows {
        for column in 0..shape.columns {
            values.extend((0..shape.channels).map(|channel| value(row, column, channel) as f32));
        }
    }
    values
}

impl Window {
    /// The window's cells that lie inside the input, for the output pixel at `row` and `column`: number of the cell in
    /// the window, and number of the pixel in the input.
    fn pixels(self, input: Shape, row: usize, column: usize) -> impl Iterator<Item = (usize, usize)> {
        let cells = 0..self.size * self.size;
        cells.filter_map(move |cell| {
            let y = (row * self.stride + cell / self.size).checked_sub(self.top)?;
            let x = (column * self.stride + cell % self.size).checked_sub(self.left)?;
            (y < input.rows && x < input.columns).then_some((cell, y * input.columns + x))
        })
    }
}
