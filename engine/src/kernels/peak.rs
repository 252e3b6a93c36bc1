//! Multiply-adds that use no memory, to measure the highest rate of the core.

use super::vector::InstructionSet;

/// Each sum begins with 1, and each round adds this share of the sum to it. The share is so small that millions of
/// rounds do not overflow.
pub(super) const FACTOR: f32 = 1.0 / 65536.0;

/// See [`super::Kernels::peak`]. `N` sums grow independently of each other, so that the processor computes several at
/// a time.
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn peak<I: InstructionSet, const N: usize>(rounds: usize) -> f32 {
    // The compiler must not know the factor. Each sum is an operand of its own product: ARM's multiply-add replaces its
    // addend by the result, and a constant addend would have to be copied first.
    let factor = std::hint::black_box(FACTOR);
    let mut result = vec![0.0; I::LANES];
    // SAFETY: the caller vouches for the instruction set, and `result` has the length of a vector.
    unsafe {
        let factor = I::splat(&raw const factor);
        let mut sums = [I::splat(&1.0); N];
        for _ in 0..rounds {
            for sum in &mut sums {
                *sum = I::mul_add(*sum, factor, *sum);
            }
        }
        let mut total = I::zero();
        for sum in sums {
            total = I::add(total, sum);
        }
        I::store(result.as_mut_ptr(), total);
    }
    result[0]
}
