//! The convolution that reads the picture, written once over [`InstructionSet`]. The kernel computes one row of pixels; a
//! row of its window is one run of values, because the channels of neighbouring pixels lie beside each other.

use super::Stem;
use super::finish::{Finish, assert_slopes};
use super::vector::{InstructionSet, vectors};

/// Panics if an area of a task is too small, or if the number of output channels is no multiple of `lanes`.
pub(super) fn check(task: &Stem, lanes: usize, output: &[f32]) {
    let (channels, values) = (task.bias.len(), task.rows.len() * task.span);
    assert!(channels.is_multiple_of(lanes) && values > 0 && task.weights.len() >= channels * values);
    assert!(output.len() >= task.pixels * channels && task.pixels > 0);
    assert!(task.rows.iter().all(|row| row.len() >= ((task.pixels - 1) * task.step + task.span).next_multiple_of(4)));
    assert_slopes(task.activation, channels);
}

/// See [`super::Kernels::stem`].
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn stem<I: InstructionSet, const N: usize, const TAIL: usize>(task: &Stem, output: &mut [f32]) {
    check(task, TAIL * I::LANES, output);
    let (mut channel, channels) = (0, task.bias.len());
    // SAFETY: all sizes were checked above.
    unsafe {
        while channel + N * I::LANES <= channels {
            stem_spans::<I, N>(task, channel, output);
            channel += N * I::LANES;
        }
        while channel < channels {
            stem_spans::<I, TAIL>(task, channel, output);
            channel += TAIL * I::LANES;
        }
    }
}

/// Runs the code that is compiled for the windows of facewire's networks, or the code for any window.
///
/// # Safety
/// As [`stem_panel`].
#[inline(always)]
unsafe fn stem_spans<I: InstructionSet, const N: usize>(task: &Stem, channel: usize, output: &mut [f32]) {
    // SAFETY: the caller vouches for all sizes.
    unsafe {
        match (task.step, task.span) {
            (6, 9) => stem_panel::<I, N, 9>(task, channel, output),
            (6, 15) => stem_panel::<I, N, 15>(task, channel, output),
            _ => stem_panel::<I, N, 0>(task, channel, output),
        }
    }
}

/// Computes `N` vectors of output channels, from `channel` on, of all pixels of the row.
///
/// # Safety
/// The processor must have the instruction set; the sizes must be those that [`check`] checks.
#[inline(always)]
unsafe fn stem_panel<I: InstructionSet, const N: usize, const SPAN: usize>(
    task: &Stem,
    channel: usize,
    output: &mut [f32],
) {
    let mut pixel = 0;
    // SAFETY: the caller vouches for all sizes.
    unsafe {
        let finish = Finish::<I::Vector, N>::new::<I>(task.activation, channel);
        while pixel < task.pixels {
            let output = output.as_mut_ptr().add(pixel * task.bias.len() + channel);
            let done = match task.pixels - pixel {
                12.. if I::TILE == 12 => stem_pixels::<I, 12, N, SPAN>(task, channel, pixel, finish, output),
                6.. if I::TILE == 6 => stem_pixels::<I, 6, N, SPAN>(task, channel, pixel, finish, output),
                4.. => stem_pixels::<I, 4, N, SPAN>(task, channel, pixel, finish, output),
                _ => stem_pixels::<I, 1, N, SPAN>(task, channel, pixel, finish, output),
            };
            pixel += done;
        }
    }
}

/// Computes `P` pixels and returns their number.
///
/// # Safety
/// As [`stem_panel`].
#[inline(always)]
unsafe fn stem_pixels<I: InstructionSet, const P: usize, const N: usize, const SPAN: usize>(
    task: &Stem,
    channel: usize,
    pixel: usize,
    finish: Finish<I::Vector, N>,
    output: *mut f32,
) -> usize {
    // SAFETY: the caller vouches for all sizes.
    unsafe {
        let mut sums = [vectors::<I, N>(task.bias, channel); P];
        let mut weights = task.weights.as_ptr().add(channel * task.rows.len() * task.span);
        for row in task.rows {
            sums =
                I::window_row::<P, N, SPAN>(sums, row.as_ptr().add(pixel * task.step), weights, task.step, task.span);
            weights = weights.add(task.span * N * I::LANES);
        }
        finish.apply::<I, P>(&mut sums);
        for (pixel, sums) in sums.into_iter().enumerate() {
            for (n, sum) in sums.into_iter().enumerate() {
                I::store(output.add(pixel * task.bias.len() + n * I::LANES), sum);
            }
        }
        P
    }
}
