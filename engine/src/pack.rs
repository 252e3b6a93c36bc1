//! Puts weights into the order in which the kernels read them.

use crate::fusion::Depthwise;
use crate::graph::Shape;
use crate::kernels::{Kernels, half_precision};

/// Orders weights in panels of `wide` outputs. Within a panel, the weights of all its outputs for the first input come
/// first, then those for the next input. The last outputs, which do not fill a panel, form panels of `narrow` outputs.
/// `weight` gives the weight of an output and an input.
pub(crate) fn panels(
    outputs: usize,
    inputs: usize,
    [wide, narrow]: [usize; 2],
    weight: impl Fn(usize, usize) -> f32,
) -> Vec<f32> {
    let mut packed = Vec::with_capacity(outputs * inputs);
    let mut first = 0;
    while first < outputs {
        let width = if outputs - first >= wide { wide } else { narrow };
        for input in 0..inputs {
            packed.extend((first..first + width).map(|output| weight(output, input)));
        }
        first += width;
    }
    // Without spare capacity, a sanitizer detects a kernel that reads past the end.
    packed.shrink_to_fit();
    packed
}

/// The weights of a pointwise convolution between padded channels.
pub(crate) fn pointwise(kernels: &Kernels, weights: &[f32], from: usize, to: usize) -> Vec<f32> {
    let [depth, channels] = [from, to].map(|count| count.next_multiple_of(kernels.lanes));
    let packed = panels(channels, depth, [kernels.panel, kernels.lanes], |output, input| {
        if output < to && input < from { weights[output * from + input] } else { 0.0 }
    });
    if kernels.half { half_precision::pairs(&packed).collect() } else { packed }
}

/// The biases of a pointwise convolution. They include the effect of the biases of the depthwise convolution before it.
#[expect(clippy::cast_possible_truncation, reason = "a sum is rounded once")]
pub(crate) fn pointwise_bias(
    kernels: &Kernels,
    bias: &[f32],
    weights: &[f32],
    depthwise: Option<Depthwise>,
) -> Vec<f32> {
    let before = depthwise.map_or(&[][..], |depthwise| depthwise.bias);
    let rows = weights.chunks(weights.len() / bias.len());
    let sums = bias.iter().zip(rows).map(|(bias, row)| {
        let products = row.iter().zip(before).map(|(weight, bias)| f64::from(*weight) * f64::from(*bias));
        (f64::from(*bias) + products.sum::<f64>()) as f32
    });
    padded(sums, bias.len().next_multiple_of(kernels.lanes))
}

/// The weights of a depthwise 3 x 3 convolution: nine for each vector of channels.
pub(crate) fn depthwise(kernels: &Kernels, weights: &[f32], channels: usize) -> Vec<f32> {
    panels(channels.next_multiple_of(kernels.lanes), 9, [kernels.vector; 2], |channel, tap| {
        if channel < channels { weights[tap * channels + channel] } else { 0.0 }
    })
}

/// The weights of the first convolution: outputs for each value of the window.
pub(crate) fn stem(kernels: &Kernels, weights: &[f32], channels: usize) -> Vec<f32> {
    let values = weights.len() / channels;
    panels(channels.next_multiple_of(kernels.lanes), values, [kernels.stem_panel, kernels.lanes], |channel, value| {
        if channel < channels { weights[channel * values + value] } else { 0.0 }
    })
}

/// The weights of a dense layer, for a map of the given shape whose channels are padded in memory.
pub(crate) fn dense(kernels: &Kernels, weights: &[f32], from: Shape, outputs: usize) -> Vec<f32> {
    let stored = from.channels.next_multiple_of(kernels.lanes);
    let padded = outputs.next_multiple_of(kernels.dense_panel);
    panels(padded, from.pixels() * stored, [kernels.dense_panel; 2], |output, input| {
        let (pixel, channel) = (input / stored, input % stored);
        let inside = output < outputs && channel < from.channels;
        if inside { weights[(output * from.pixels() + pixel) * from.channels + channel] } else { 0.0 }
    })
}

/// Values followed by zeros.
pub(crate) fn padded(values: impl IntoIterator<Item = f32>, length: usize) -> Vec<f32> {
    let mut padded: Vec<f32> = values.into_iter().collect();
    padded.resize(length, 0.0);
    padded.shrink_to_fit();
    padded
}
