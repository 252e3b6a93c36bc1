//! Multiply-adds that touch no memory: what the core computes at most.

use super::vector::InstructionSet;

/// See [`super::Kernels::peak`]. `N` sums grow independently of each other, so that the processor computes several at
/// a time.
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn peak<I: InstructionSet, const N: usize>(rounds: usize) -> f32 {
    // The compiler must not know the factors. The sums approach 2: they stay normal numbers.
    let [factor, addend] = std::hint::black_box([0.5_f32, 1.0]);
    let mut result = vec![0.0; I::LANES];
    // SAFETY: the caller vouches for the instruction set, and `result` has the length of a vector.
    unsafe {
        let (factor, addend) = (I::splat(&raw const factor), I::splat(&raw const addend));
        let mut sums = [I::zero(); N];
        for _ in 0..rounds {
            for sum in &mut sums {
                *sum = I::mul_add(*sum, factor, addend);
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
