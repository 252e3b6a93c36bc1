//! Pointwise convolutions, written once over [`InstructionSet`]: products of a tile of pixels and a panel of weights,
//! whose sums stay in registers until they are finished.

use super::Pointwise;
use super::finish::{Finish, assert_slopes};
use super::vector::{InstructionSet, vectors};

/// Panics if an area of a task is too small, or if a number of channels is no multiple of `lanes`. Each `f32` of operand and
/// weights holds `packed` numbers: 2 in half precision.
pub(super) fn check(task: &Pointwise, lanes: usize, packed: usize, output: &[f32]) {
    let &Pointwise { pixels, depth, channels, residual, residual_channels, .. } = task;
    assert!([depth, channels, residual_channels].iter().all(|count| count.is_multiple_of(lanes)));
    assert!(depth > 0 && residual_channels <= channels);
    assert!(task.operand.len() >= pixels * depth / packed);
    assert!(task.weights.len() >= depth * channels / packed && task.bias.len() >= channels);
    assert!(output.len() >= pixels * channels);
    assert!(residual.is_empty() || residual.len() >= pixels * residual_channels);
    assert_slopes(task.activation, channels);
}

/// See [`super::Kernels::pointwise`].
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn pointwise<I: InstructionSet, const N: usize, const TAIL: usize>(
    task: &Pointwise,
    output: &mut [f32],
) {
    check(task, TAIL * I::LANES, 1, output);
    let (mut channel, channels) = (0, task.channels);
    // SAFETY: all sizes were checked above, and each panel lies below `channels`.
    unsafe {
        while channel + N * I::LANES <= channels {
            panel::<I, N>(task, channel, output);
            channel += N * I::LANES;
        }
        while channel < channels {
            panel::<I, TAIL>(task, channel, output);
            channel += TAIL * I::LANES;
        }
    }
}

/// Computes `N` vectors of output channels, from `channel` on, of all pixels.
///
/// # Safety
/// The processor must have the instruction set; the sizes must be those that [`check`] checks.
#[inline(always)]
unsafe fn panel<I: InstructionSet, const N: usize>(task: &Pointwise, channel: usize, output: &mut [f32]) {
    let residual_vectors = if task.residual.is_empty() { 0 } else { task.residual_channels };
    // SAFETY: the caller vouches for all sizes.
    unsafe {
        let finish = Finish::<I::Vector, N>::new::<I>(task.activation, channel);
        let work = Panel {
            weights: task.weights.as_ptr().add(channel * task.depth),
            depth: task.depth,
            plane: task.pixels * I::LANES,
            bias: vectors::<I, N>(task.bias, channel),
            residual_step: task.residual_channels,
            residual_vectors: (residual_vectors.saturating_sub(channel) / I::LANES).min(N),
            finish,
            step: task.channels,
        };
        let mut operand = task.operand.as_ptr();
        let mut residual = task.residual.as_ptr().wrapping_add(channel);
        let mut output = output.as_mut_ptr().add(channel);
        let mut left = task.pixels;
        while left > 0 {
            let done = match left {
                12.. if I::TILE == 12 => work.run::<I, 12>(operand, residual, output),
                8.. if I::TILE >= 8 => work.run::<I, 8>(operand, residual, output),
                6.. if I::TILE == 6 => work.run::<I, 6>(operand, residual, output),
                4.. => work.run::<I, 4>(operand, residual, output),
                _ => work.run::<I, 1>(operand, residual, output),
            };
            operand = operand.wrapping_add(done * I::LANES);
            residual = residual.wrapping_add(done * work.residual_step);
            output = output.wrapping_add(done * work.step);
            left -= done;
        }
    }
}

/// A panel of weights, the bias that its sums begin with, and the activation that they end with.
struct Panel<V, const N: usize> {
    weights: *const f32,
    depth: usize,
    /// Values from a vector of channels of the operand to the next.
    plane: usize,
    bias: [V; N],
    residual_step: usize,
    /// Vectors of the panel that have a residual: the first ones.
    residual_vectors: usize,
    finish: Finish<V, N>,
    step: usize,
}

impl<V: Copy, const N: usize> Panel<V, N> {
    /// Computes `P` pixels and returns their number.
    ///
    /// # Safety
    /// The processor must have the instruction set; the pointers must be those of `P` pixels.
    #[inline(always)]
    unsafe fn run<I: InstructionSet<Vector = V>, const P: usize>(
        &self,
        operand: *const f32,
        residual: *const f32,
        output: *mut f32,
    ) -> usize {
        // SAFETY: the caller vouches for the pointers.
        unsafe {
            let mut sums = [self.bias; P];
            if self.residual_vectors == N {
                for (pixel, sums) in sums.iter_mut().enumerate() {
                    let residual = residual.add(pixel * self.residual_step);
                    for (n, sum) in sums.iter_mut().enumerate() {
                        *sum = I::add(self.bias[n], I::load(residual.add(n * I::LANES)));
                    }
                }
            } else if self.residual_vectors > 0 {
                for (pixel, sums) in sums.iter_mut().enumerate() {
                    let residual = residual.add(pixel * self.residual_step);
                    for (n, sum) in sums.iter_mut().enumerate().take(self.residual_vectors) {
                        *sum = I::add(self.bias[n], I::load(residual.add(n * I::LANES)));
                    }
                }
            }
            let mut sums = I::product::<P, N>(sums, operand, self.weights, self.depth, self.plane);
            self.finish.apply::<I, P>(&mut sums);
            for (pixel, sums) in sums.into_iter().enumerate() {
                for (n, sum) in sums.into_iter().enumerate() {
                    I::store(output.add(pixel * self.step + n * I::LANES), sum);
                }
            }
            P
        }
    }
}
