//! Every kernel of this machine against plain sums, on shapes that fill no tile, panel or vector. All slices are exactly
//! as long as they must be, so that a sanitizer detects a read or write past their ends.

use super::half_precision::tests::values;
use super::{Activation, Dense, Depthwise, Kernels, Pointwise, Stem, available};
use crate::pack;
use crate::testing::{Random, assert_close, assert_within, tolerance};

/// An array of `length` values that `fill` packs.
fn packed(length: usize, fill: impl FnOnce(&mut [f32])) -> Vec<f32> {
    let mut packed = vec![0.0; length];
    fill(&mut packed);
    packed
}

fn activate(value: f32, activation: &Activation, channel: usize) -> f32 {
    match activation {
        Activation::Relu => value.max(0.0),
        Activation::Prelu(slopes) if value < 0.0 => value * slopes[channel],
        Activation::None | Activation::Prelu(_) => value,
    }
}

/// None, ReLU, and PReLU with slopes below and above 1, for a number of channels.
fn activations(slopes: &[f32]) -> [Activation<'_>; 4] {
    let (gentle, any) = slopes.split_at(slopes.len() / 2);
    [Activation::None, Activation::Relu, Activation::Prelu(gentle), Activation::Prelu(any)]
}

fn slopes(random: &mut Random, channels: usize) -> Vec<f32> {
    let mut slopes = random.values(channels);
    slopes.extend(random.values(channels).iter().map(|slope| slope * 3.0));
    slopes
}

/// Pixels, channel by channel within a pixel, as an operand.
fn operand(kernels: &Kernels, pixels: &[f32], channels: usize) -> Vec<f32> {
    let mut operand = vec![f32::NAN; pixels.len()];
    kernels.operand_of(pixels, channels, &mut operand);
    operand
}

/// The values of an operand in single precision, in the order of the operand.
fn values_of(kernels: &Kernels, operand: &[f32]) -> Vec<f32> {
    if kernels.half { values(&operand[..operand.len() / 2]) } else { operand.to_vec() }
}

#[test]
fn pointwise_convolutions_agree_with_plain_sums() {
    for kernels in available() {
        let mut random = Random::new(1);
        for round in 0..120 {
            let lanes = kernels.lanes;
            let [depth, channels] = [random.below(5) + 1, random.below(6) + 1].map(|count| count * lanes);
            let pixels = random.below(40) + 1;
            let residual_channels = lanes * random.below(channels / lanes + 1);
            let input = random.values(pixels * depth);
            let weights = random.values(channels * depth);
            let length = weights.len() / if kernels.half { 2 } else { 1 };
            let bias = random.values(channels);
            let residual = random.values(pixels * residual_channels);
            let slopes = slopes(&mut random, channels);
            let activation = activations(&slopes)[round % 4];
            let task = Pointwise {
                operand: &operand(kernels, &input, depth),
                pixels,
                depth,
                channels,
                weights: &packed(length, |to| pack::pointwise(to, kernels, &weights.clone().into(), depth, channels)),
                bias: &bias,
                residual: &residual,
                residual_channels,
                activation,
            };
            let mut output = vec![f32::NAN; pixels * channels];
            (kernels.pointwise)(&task, &mut output);
            let expected = (0..pixels * channels).map(|at| {
                let (pixel, channel) = (at / channels, at % channels);
                let products = input[pixel * depth..][..depth].iter().zip(&weights[channel * depth..]);
                let mut sum = bias[channel] + products.map(|(a, b)| a * b).sum::<f32>();
                if channel < residual_channels {
                    sum += residual[pixel * residual_channels + channel];
                }
                activate(sum, &activation, channel)
            });
            assert_within(tolerance(kernels), &output, &expected.collect::<Vec<_>>(), kernels.name);
        }
    }
}

#[test]
fn depthwise_convolutions_agree_with_plain_sums() {
    for kernels in available() {
        let mut random = Random::new(2);
        for _ in 0..120 {
            let channels = kernels.lanes * (random.below(3) + 1);
            let columns = random.below(21) + 1;
            let stride = random.below(2) + 1;
            let output_rows = if stride == 1 { random.below(2) + 1 } else { 1 };
            let (first_pixel, width) = (random.below(9), columns * stride);
            let pixels = first_pixel + output_rows * columns + random.below(5);
            let rows: [Vec<f32>; 4] = std::array::from_fn(|row| {
                let unused = row >= output_rows + 2;
                if unused { Vec::new() } else { random.values(width * channels) }
            });
            let weights = random.values(9 * channels);
            let task = Depthwise {
                rows: [&rows[0], &rows[1], &rows[2], &rows[3]],
                output_rows,
                stride,
                weights: &packed(weights.len(), |to| pack::depthwise(to, kernels, &weights.clone().into(), channels)),
                channels,
                columns,
                first_pixel,
                pixels,
            };
            let pool = stride == 2 && random.below(2) == 0;
            let mut output = operand(kernels, &vec![7.0; pixels * channels], channels);
            let mut largest = vec![f32::NAN; if pool { columns * channels } else { 0 }];
            (kernels.depthwise)(&task, &mut output, &mut largest);
            let mut expected = vec![7.0; pixels * channels];
            for at in 0..output_rows * columns * channels {
                let (pixel, channel) = (at / channels, at % channels);
                let (row, column) = (pixel / columns, pixel % columns);
                let taps = (0..9).filter_map(|tap| {
                    let x = (column * stride + tap % 3 + stride).checked_sub(2).filter(|x| *x < width)?;
                    Some(rows[row + tap / 3][x * channels + channel] * weights[tap * channels + channel])
                });
                expected[(first_pixel + pixel) * channels + channel] = taps.sum();
            }
            let expected = values_of(kernels, &operand(kernels, &expected, channels));
            assert_within(tolerance(kernels), &values_of(kernels, &output), &expected, kernels.name);
            let expected = (0..largest.len()).map(|at| {
                let (column, channel) = (at / channels, at % channels);
                let four =
                    [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(y, x)| rows[y][(2 * column + x) * channels + channel]);
                four.into_iter().fold(f32::NEG_INFINITY, f32::max)
            });
            assert_close(&largest, &expected.collect::<Vec<_>>(), kernels.name);
        }
    }
}

#[test]
fn first_convolutions_agree_with_plain_sums() {
    for kernels in available() {
        let mut random = Random::new(3);
        for round in 0..60 {
            let channels = kernels.lanes * (random.below(4) + 1);
            let (size, pixels) = ([3, 5, 1, 4][random.below(4)], random.below(30) + 1);
            let step = 3 * (random.below(2) + 1);
            let span = 3 * size;
            let length = ((pixels - 1) * step + span).next_multiple_of(4);
            let rows: Vec<Vec<f32>> = (0..size).map(|_| random.values(length)).collect();
            let weights = random.values(channels * size * span);
            let bias = random.values(channels);
            let slopes = slopes(&mut random, channels);
            let activation = activations(&slopes)[round % 4];
            let task = Stem {
                rows: &rows.iter().map(Vec::as_slice).collect::<Vec<_>>(),
                step,
                span,
                weights: &packed(weights.len(), |to| pack::stem(to, kernels, &weights.clone().into(), channels)),
                bias: &bias,
                activation,
                pixels,
            };
            let mut output = vec![f32::NAN; pixels * channels];
            (kernels.stem)(&task, &mut output);
            let expected = (0..pixels * channels).map(|at| {
                let (pixel, channel) = (at / channels, at % channels);
                let values = (0..size * span).map(|value| {
                    rows[value / span][pixel * step + value % span] * weights[channel * size * span + value]
                });
                activate(bias[channel] + values.sum::<f32>(), &activation, channel)
            });
            assert_close(&output, &expected.collect::<Vec<_>>(), kernels.name);
        }
    }
}

#[test]
fn dense_layers_agree_with_plain_sums() {
    for kernels in available() {
        let mut random = Random::new(4);
        for _ in 0..20 {
            let (depth, outputs) = (random.below(70) + 1, kernels.dense_panel * (random.below(3) + 1));
            // These have few digits, so that they lose nothing in half precision.
            let (input, mut weights) = (random.values(depth), random.values(depth * outputs));
            for weight in &mut weights {
                *weight = (*weight * 64.0).round() / 64.0;
            }
            let bias = random.values(outputs);
            let (weight, widths) = (|output, input| weights[output * depth + input], [kernels.dense_panel; 2]);
            let single = packed(weights.len(), |to| pack::panels(to, depth, widths, weight));
            let mut output = vec![f32::NAN; outputs];
            (kernels.dense)(&Dense { input: &input, weights: &single, half: false, bias: &bias }, &mut output);
            if kernels.dense_half {
                let weights = &packed(weights.len() / 2, |to| pack::matrix(to, true, depth, widths, weight));
                let mut from_half = vec![f32::NAN; outputs];
                (kernels.dense)(&Dense { input: &input, weights, half: true, bias: &bias }, &mut from_half);
                assert_eq!(from_half, output, "{}", kernels.name);
            }
            let sum = |row: &[f32]| row.iter().zip(&input).map(|(a, b)| a * b).sum::<f32>();
            let expected: Vec<f32> = weights.chunks(depth).zip(&bias).map(|(row, bias)| bias + sum(row)).collect();
            assert_close(&output, &expected, kernels.name);
        }
    }
}
