//! Every sampler of this machine against the plain one.

use super::{Line, Pixel, available, plain, sample};
use crate::testing::Random;

/// Pixels of the largest and smallest values that conversions give.
fn pixels(random: &mut Random, count: usize) -> Vec<Pixel> {
    (0..count).map(|_| [(); 4].map(|()| random.below(812) as i16 - 277)).collect()
}

/// A line of `samples` samples between two random positions inside.
fn line<'a>(random: &mut Random, pixels: &'a [Pixel], stride: usize, samples: usize) -> Line<'a> {
    let size = [stride, pixels.len() / stride];
    let mut position = || size.map(|size| random.below((size - 1) << 16) as i32);
    let (start, end) = (position(), position());
    let step = [0, 1].map(|axis| (end[axis] - start[axis]) / samples.max(1) as i32);
    Line { pixels, stride, start, step, scale: 0.3 }
}

#[test]
fn samples_are_those_of_the_plain_sampler_bit_for_bit() {
    let mut random = Random::new(5);
    for samples in (0..60).chain([192; 20]) {
        let stride = random.below(60) + 2;
        // Exactly as many pixels as the line may touch, so that a sanitizer detects a read past their end.
        let rows = random.below(40) + 2;
        let pixels = pixels(&mut random, stride * rows);
        let line = line(&mut random, &pixels, stride, samples);
        let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
        let mut wanted = vec![0.0; 3 * samples];
        plain(&line, 0, &mut wanted);
        let wanted = bits(wanted);
        for sampler in available() {
            let mut output = vec![f32::NAN; 3 * samples];
            // SAFETY: the line is inside its pixels.
            unsafe { sampler(&line, &mut output) };
            assert_eq!(bits(output), wanted, "{samples} samples");
        }
    }
}

#[test]
fn a_sample_is_the_weighted_mean_of_its_four_pixels_within_black_and_white() {
    let pixels = [[0, -90, 255, 0], [64, -90, 300, 0], [128, -90, 255, 0], [192, -90, 300, 0]];
    // A quarter of a pixel to the right and half a pixel down.
    let line = Line { pixels: &pixels, stride: 2, start: [1 << 14, 1 << 15], step: [0; 2], scale: 1.0 / 1024.0 };
    let mut output = [f32::NAN; 3];
    sample(&line, &mut output);
    assert_eq!(output.map(f32::to_bits), [80.0_f32, 0.0, 255.0].map(f32::to_bits));
}

#[test]
fn a_line_that_leaves_the_pixels_at_any_side_is_refused() {
    let pixels = [[0; 4]; 6 * 5];
    let at = |start: [i32; 2], step: [i32; 2]| {
        let line = Line { pixels: &pixels, stride: 6, start: start.map(|at| at << 16), step, scale: 1.0 };
        line.is_inside(9)
    };
    assert!(at([4, 3], [0; 2]) && at([0, 0], [1 << 15, 1 << 14]) && at([4, 3], [-(1 << 15), -(1 << 14)]));
    assert!(!at([5, 3], [0; 2]) && !at([4, 4], [0; 2]) && !at([-1, 0], [0; 2]) && !at([0, -1], [0; 2]));
    assert!(!at([1, 0], [1 << 15, 0]) && !at([0, 0], [0, 1 << 15]) && !at([3, 0], [-(1 << 15), 0]));
    assert!(!at([4, 0], [i32::MAX, 0]));
}
