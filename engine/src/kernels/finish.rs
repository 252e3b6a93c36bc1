//! What follows the sums of a convolution.

use super::Activation;
use super::vector::{InstructionSet, vectors};

/// What happens to a vector of sums.
#[derive(Clone, Copy)]
pub(super) enum Finish<V, const N: usize> {
    None,
    Relu,
    /// All slopes are at most 1, so that the result is the larger of a value and its product with the slope.
    GentlePrelu([V; N]),
    Prelu([V; N]),
}

/// Returns whether no slope is above 1, so that PReLU is the larger of a value and its product with the slope.
#[inline(always)]
pub(super) fn are_gentle(slopes: &[f32]) -> bool {
    slopes.iter().all(|slope| *slope <= 1.0)
}

impl<V: Copy, const N: usize> Finish<V, N> {
    /// The activation of `N` vectors of channels from `channel` on.
    ///
    /// # Safety
    /// The processor must have the instruction set, and the slopes, if any, must reach that far.
    #[inline(always)]
    pub(super) unsafe fn new<I: InstructionSet<Vector = V>>(activation: Activation, channel: usize) -> Self {
        match activation {
            Activation::None => Self::None,
            Activation::Relu => Self::Relu,
            Activation::Prelu(slopes) => {
                // SAFETY: the caller vouches for the length.
                let (slopes, all) = unsafe {
                    (slopes.get_unchecked(channel..channel + N * I::LANES), vectors::<I, N>(slopes, channel))
                };
                if are_gentle(slopes) { Self::GentlePrelu(all) } else { Self::Prelu(all) }
            }
        }
    }

    /// Applies the activation to the sums of `P` pixels.
    ///
    /// # Safety
    /// The processor must have the instruction set.
    #[inline(always)]
    pub(super) unsafe fn apply<I: InstructionSet<Vector = V>, const P: usize>(self, sums: &mut [[V; N]; P]) {
        // One loop for each activation, so that the compiler unrolls all of them and keeps the sums in registers.
        // SAFETY: the caller vouches for the instruction set.
        unsafe {
            let zero = I::zero();
            match self {
                Self::None => {}
                Self::Relu => {
                    for sum in sums.as_flattened_mut() {
                        *sum = I::max(*sum, zero);
                    }
                }
                Self::GentlePrelu(slopes) => {
                    for sums in sums {
                        for n in 0..N {
                            sums[n] = I::max(sums[n], I::mul(sums[n], slopes[n]));
                        }
                    }
                }
                Self::Prelu(slopes) => {
                    for sums in sums {
                        for n in 0..N {
                            sums[n] = I::mul_add(slopes[n], I::min(sums[n], zero), I::max(sums[n], zero));
                        }
                    }
                }
            }
        }
    }
}

/// Panics unless an activation has a slope for each of `channels`.
pub(super) fn assert_slopes(activation: Activation, channels: usize) {
    if let Activation::Prelu(slopes) = activation {
        assert!(slopes.len() >= channels, "one slope for each channel");
    }
}
