//! Measures the multiply-adds per second of single kernels for several numbers of channels, with all operands in the cache.
//! Usage: kernels [KERNELS]. Without a name it measures all kernels that this machine can run.

use std::env;
use std::hint::black_box;
use std::time::Instant;

use facewire_engine::kernels::{self, Activation, Depthwise, Pointwise};

fn main() {
    let wanted = env::args().nth(1);
    for kernels in kernels::available() {
        if wanted.as_ref().is_none_or(|name| name == kernels.name) {
            println!("{}: channels, pixels, G multiply-adds/s of depthwise, of pointwise", kernels.name);
            for (channels, columns) in [(16, 96), (32, 48), (64, 24), (128, 12)] {
                time(kernels, channels, columns);
            }
        }
    }
}

fn time(kernels: &kernels::Kernels, channels: usize, columns: usize) {
    let pixels = 2 * columns;
    let rows = vec![0.5; 4 * columns * channels];
    let weights = vec![0.01; 9 * channels];
    let mut operand = vec![0.1; pixels * channels];
    let row = |y: usize| &rows[y * columns * channels..(y + 1) * columns * channels];
    let depthwise = Depthwise {
        rows: [row(0), row(1), row(2), row(3)],
        output_rows: 2,
        stride: 1,
        weights: &weights,
        channels,
        columns,
        first_pixel: 0,
        pixels,
    };
    let depthwise_rate = rate(9 * channels * pixels, || (kernels.depthwise)(&depthwise, &mut operand, &mut []));
    let (weights, bias) = (vec![0.01; channels * channels], vec![0.1; channels]);
    let residual = vec![0.3; pixels * channels];
    let pointwise = Pointwise {
        operand: &operand,
        pixels,
        depth: channels,
        channels,
        weights: &weights,
        bias: &bias,
        residual: &residual,
        residual_channels: channels,
        activation: Activation::Prelu(&bias),
    };
    let mut output = vec![0.0; pixels * channels];
    let pointwise_rate = rate(channels * channels * pixels, || (kernels.pointwise)(&pointwise, &mut output));
    println!("  {channels:4} {pixels:4} {depthwise_rate:8.1} {pointwise_rate:8.1}");
}

/// Thousand millions of multiply-adds per second, from the fastest of 200 measurements.
fn rate(products: usize, mut run: impl FnMut()) -> f64 {
    let times = (0..200).map(|_| {
        let start = Instant::now();
        (0..20).for_each(|_| black_box(&mut run)());
        start.elapsed().as_secs_f64() / 20.0
    });
    products as f64 / times.fold(f64::INFINITY, f64::min) / 1e9
}
