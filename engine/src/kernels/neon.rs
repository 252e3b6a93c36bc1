//! Kernels for aarch64: 32 registers of 4 values.

use std::arch::aarch64::{
    float32x4_t, vaddq_f32, vdupq_n_f32, vfmaq_f32, vfmaq_laneq_f32, vld1q_dup_f32, vld1q_f32, vmaxq_f32, vminq_f32,
    vmulq_f32, vst1q_f32,
};

use super::generic::kernels;
use super::vector::InstructionSet;

struct Neon;

// SAFETY: `kernels::available` hands these kernels out only where NEON was detected.
unsafe impl InstructionSet for Neon {
    type Vector = float32x4_t;
    const LANES: usize = 4;
    // Eight pixels and two vectors of channels take 16 registers for sums, and as many are left for operands.
    const TILE: usize = 8;

    #[inline(always)]
    unsafe fn zero() -> Self::Vector {
        // SAFETY: the caller vouches for the instruction set.
        unsafe { vdupq_n_f32(0.0) }
    }

    #[inline(always)]
    unsafe fn load(from: *const f32) -> Self::Vector {
        // SAFETY: the caller vouches for the instruction set and the pointer.
        unsafe { vld1q_f32(from) }
    }

    #[inline(always)]
    unsafe fn store(to: *mut f32, value: Self::Vector) {
        // SAFETY: the caller vouches for the instruction set and the pointer.
        unsafe { vst1q_f32(to, value) }
    }

    #[inline(always)]
    unsafe fn splat(from: *const f32) -> Self::Vector {
        // SAFETY: the caller vouches for the instruction set and the pointer.
        unsafe { vld1q_dup_f32(from) }
    }

    #[inline(always)]
    unsafe fn add(a: Self::Vector, b: Self::Vector) -> Self::Vector {
        // SAFETY: the caller vouches for the instruction set.
        unsafe { vaddq_f32(a, b) }
    }

    #[inline(always)]
    unsafe fn mul(a: Self::Vector, b: Self::Vector) -> Self::Vector {
        // SAFETY: the caller vouches for the instruction set.
        unsafe { vmulq_f32(a, b) }
    }

    #[inline(always)]
    unsafe fn mul_add(a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector {
        // SAFETY: the caller vouches for the instruction set.
        unsafe { vfmaq_f32(c, a, b) }
    }

    #[inline(always)]
    unsafe fn max(a: Self::Vector, b: Self::Vector) -> Self::Vector {
        // SAFETY: the caller vouches for the instruction set.
        unsafe { vmaxq_f32(a, b) }
    }

    #[inline(always)]
    unsafe fn min(a: Self::Vector, b: Self::Vector) -> Self::Vector {
        // SAFETY: the caller vouches for the instruction set.
        unsafe { vminq_f32(a, b) }
    }

    /// Four channels of a pixel come in one load; each then multiplies its weights as a lane.
    #[inline(always)]
    unsafe fn product<const P: usize, const N: usize>(
        mut sums: [[Self::Vector; N]; P],
        mut operand: *const f32,
        mut panel: *const f32,
        depth: usize,
    ) -> [[Self::Vector; N]; P] {
        macro_rules! channel {
            ($values:ident, $lane:literal) => {
                let weights: [_; N] =
                    std::array::from_fn(|n| unsafe { vld1q_f32(panel.add(($lane * N + n) * Self::LANES)) });
                for (sums, value) in sums.iter_mut().zip($values) {
                    for (sum, weight) in sums.iter_mut().zip(weights) {
                        *sum = vfmaq_laneq_f32::<$lane>(*sum, weight, value);
                    }
                }
            };
        }
        for _ in 0..depth / Self::LANES {
            // SAFETY: the tile and the panel go on for `depth` channels.
            unsafe {
                let values: [_; P] = std::array::from_fn(|pixel| vld1q_f32(operand.add(pixel * Self::LANES)));
                channel!(values, 0);
                channel!(values, 1);
                channel!(values, 2);
                channel!(values, 3);
                panel = panel.add(4 * N * Self::LANES);
            }
            // After the last round the pointer is not read.
            operand = operand.wrapping_add(Self::TILE * Self::LANES);
        }
        sums
    }
}

kernels!(Neon, "neon", vectors: 2, dense_vectors: 8, features: "neon");
