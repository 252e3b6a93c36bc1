//! Weighted sums of a whole map, written once over [`InstructionSet`].

use super::Dense;
use super::vector::{InstructionSet, prefetch, vectors};

/// Panics if an area of a task is too small, or if the number of outputs is no multiple of `panel`.
pub(super) fn check(task: &Dense, panel: usize, output: &[f32]) {
    let (outputs, depth) = (task.bias.len(), task.input.len());
    assert!(outputs.is_multiple_of(panel) && output.len() >= outputs);
    assert!(task.weights.len() >= outputs * depth / if task.half { 2 } else { 1 });
}

/// See [`super::Kernels::dense`].
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn dense<I: InstructionSet, const N: usize>(task: &Dense, output: &mut [f32]) {
    check(task, N * I::LANES, output);
    // SAFETY: all sizes were checked above.
    unsafe { if task.half { panels::<I, N, true>(task, output) } else { panels::<I, N, false>(task, output) } }
}

/// [`dense`] with weights of half precision if `HALF`.
///
/// # Safety
/// The processor must have the instruction set; the sizes must be those that [`check`] checks.
#[inline(always)]
unsafe fn panels<I: InstructionSet, const N: usize, const HALF: bool>(task: &Dense, output: &mut [f32]) {
    let of_weights = |values: usize| if HALF { values / 2 } else { values };
    let (outputs, depth) = (task.bias.len(), task.input.len());
    for first in (0..outputs).step_by(N * I::LANES) {
        // SAFETY: the caller vouches for all sizes.
        unsafe {
            let mut sums = vectors::<I, N>(task.bias, first);
            let mut weights = task.weights.as_ptr().add(of_weights(first * depth));
            for value in task.input {
                let value = I::splat(value);
                for (n, sum) in sums.iter_mut().enumerate() {
                    let from = weights.add(of_weights(n * I::LANES));
                    *sum = I::mul_add(value, if HALF { I::load_half(from) } else { I::load(from) }, *sum);
                }
                prefetch::<I, N>(weights);
                weights = weights.add(of_weights(N * I::LANES));
            }
            for (n, sum) in sums.into_iter().enumerate() {
                I::store(output.as_mut_ptr().add(first + n * I::LANES), sum);
            }
        }
    }
}
