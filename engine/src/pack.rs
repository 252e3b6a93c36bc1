//! Puts weights into the order in which the kernels read them. Each function fills its first argument, which
//! comes with zeros.

use crate::fusion::Depthwise;
use crate::graph::Shape;
use crate::kernels::{Kernels, half_precision};
use crate::values::Values;

/// Orders weights in panels of `wide` outputs. Within a panel, the weights of all its outputs for the first input come
/// first, then those for the next input. The last outputs, which do not fill a panel, form panels of `narrow` outputs.
/// `weight` gives the weight of an output and an input.
pub(crate) fn panels(
    packed: &mut [f32],
    inputs: usize,
    [wide, narrow]: [usize; 2],
    weight: impl Fn(usize, usize) -> f32,
) {
    let mut first = 0;
    let (panels, rest) = packed.split_at_mut(packed.len() / (wide * inputs) * (wide * inputs));
    for (panels, width) in [(panels, wide), (rest, narrow)] {
        for panel in panels.chunks_exact_mut(width * inputs) {
            for (input, outputs) in panel.chunks_exact_mut(width).enumerate() {
                outputs.iter_mut().enumerate().for_each(|(output, to)| *to = weight(first + output, input));
            }
            first += width;
        }
    }
}

/// Orders weights as [`panels`] does. In half precision, two take the place of one.
pub(crate) fn matrix(
    packed: &mut [f32],
    half: bool,
    inputs: usize,
    widths: [usize; 2],
    weight: impl Fn(usize, usize) -> f32,
) {
    if half {
        let pair = |pair, input| half_precision::pair([2 * pair, 2 * pair + 1].map(|output| weight(output, input)));
        panels(packed, inputs, widths.map(|width| width / 2), pair);
    } else {
        panels(packed, inputs, widths, weight);
    }
}

/// The weights of a pointwise convolution between padded channels.
pub(crate) fn pointwise(packed: &mut [f32], kernels: &Kernels, weights: &Values, from: usize, to: usize) {
    let (depth, widths) = (from.next_multiple_of(kernels.lanes), [kernels.panel, kernels.lanes]);
    let weight = |output, input| if output < to && input < from { weights.at(output * from + input) } else { 0.0 };
    matrix(packed, kernels.half, depth, widths, weight);
}

/// The biases of a pointwise convolution. They include the effect of the biases of the depthwise convolution before it.
#[expect(clippy::cast_possible_truncation, reason = "a sum is rounded once")]
pub(crate) fn pointwise_bias(packed: &mut [f32], bias: &Values, weights: &Values, depthwise: Option<Depthwise>) {
    let inputs = weights.len() / bias.len();
    for (output, (to, bias)) in packed.iter_mut().zip(bias.iter()).enumerate() {
        let before = depthwise.iter().flat_map(|depthwise| depthwise.bias.iter()).enumerate();
        let products = before.map(|(input, bias)| f64::from(weights.at(output * inputs + input)) * f64::from(bias));
        *to = (f64::from(bias) + products.sum::<f64>()) as f32;
    }
}

/// The weights of a depthwise 3 x 3 convolution: nine for each vector of channels.
pub(crate) fn depthwise(packed: &mut [f32], kernels: &Kernels, weights: &Values, channels: usize) {
    panels(
        packed,
        9,
        [kernels.vector; 2],
        |channel, tap| {
            if channel < channels { weights.at(tap * channels + channel) } else { 0.0 }
        },
    );
}

/// The weights of the first convolution: outputs for each value of the window.
pub(crate) fn stem(packed: &mut [f32], kernels: &Kernels, weights: &Values, channels: usize) {
    let values = weights.len() / channels;
    panels(packed, values, [kernels.stem_panel, kernels.lanes], |channel, value| {
        if channel < channels { weights.at(channel * values + value) } else { 0.0 }
    });
}

/// The weights of a dense layer, for a map of the given shape whose channels are padded in memory. In half precision, two take
/// the place of one.
pub(crate) fn dense(packed: &mut [f32], kernels: &Kernels, weights: &Values, from: Shape, outputs: usize, half: bool) {
    let stored = from.channels.next_multiple_of(kernels.lanes);
    let (inputs, widths) = (from.pixels() * stored, [kernels.dense_panel; 2]);
    let weight = |output, input| {
        let (pixel, channel) = (input / stored, input % stored);
        let inside = output < outputs && channel < from.channels;
        if inside { weights.at((output * from.pixels() + pixel) * from.channels + channel) } else { 0.0 }
    };
    matrix(packed, half, inputs, widths, weight);
}

/// Values, and zeros in the place of padding.
pub(crate) fn padded(packed: &mut [f32], values: &Values) {
    packed.iter_mut().zip(values.iter()).for_each(|(to, value)| *to = value);
}
