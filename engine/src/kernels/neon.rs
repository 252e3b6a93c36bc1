//! Kernels for aarch64: 32 registers of 4 values.

use std::arch::aarch64::{
    float32x4_t, uint16x4_t, vaddq_f32, vdupq_n_f32, vfmaq_f32, vfmaq_laneq_f32, vld1q_dup_f32, vld1q_f32, vmaxq_f32,
    vminq_f32, vmulq_f32, vst1_u16, vst1q_f32,
};
use std::arch::asm;

use super::table::kernels;
use super::vector::{InstructionSet, broadcast_row, consecutive};

/// With `HALF`, the values of the operand of a pointwise convolution are stored in half precision.
pub(super) struct Neon<const HALF: bool>;

/// Adds the products of the windows of four pixels, which begin six values apart. Each value is a lane of a loaded vector.
macro_rules! lanes_row {
    ($sums:ident, $from:ident, $panel:ident, [$($value:literal)*]) => {{
        let mut sums = $sums;
        // The number of the last value of the last window.
        const LAST: usize = [$($value),*].len() + 17;
        let values = consecutive::<Self, { LAST / 4 + 1 }>($from);
        $(
            let weights = consecutive::<Self, N>($panel.add($value * N * Self::LANES));
            for n in 0..N {
                sums[0][n] = vfmaq_laneq_f32::<{ $value % 4 }>(sums[0][n], weights[n], values[$value / 4]);
                sums[1][n] = vfmaq_laneq_f32::<{ (6 + $value) % 4 }>(sums[1][n], weights[n], values[(6 + $value) / 4]);
                sums[2][n] = vfmaq_laneq_f32::<{ $value % 4 }>(sums[2][n], weights[n], values[(12 + $value) / 4]);
                sums[3][n] = vfmaq_laneq_f32::<{ (6 + $value) % 4 }>(sums[3][n], weights[n], values[(18 + $value) / 4]);
            }
        )*
        sums
    }};
}

// SAFETY: `kernels::available` hands these kernels out only where NEON was detected.
unsafe impl<const HALF: bool> InstructionSet for Neon<HALF> {
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
    unsafe fn store_operand(operand: *mut f32, at: usize, value: Self::Vector) {
        // SAFETY: the caller vouches for the instruction set and the pointer.
        unsafe {
            if HALF {
                let halves: uint16x4_t;
                // The intrinsic of this instruction, which every processor with NEON has, is not stable in Rust 1.92.
                asm!("fcvtn {0:v}.4h, {1:v}.4s", out(vreg) halves, in(vreg) value, options(pure, nomem, nostack, preserves_flags));
                vst1_u16(operand.cast::<u16>().add(at), halves);
            } else {
                Self::store(operand.add(at), value);
            }
        }
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

    /// One load reads four channels of a pixel. Each channel is a lane, by which its weights are multiplied.
    #[inline(always)]
    unsafe fn product<const P: usize, const N: usize>(
        mut sums: [[Self::Vector; N]; P],
        mut operand: *const f32,
        mut panel: *const f32,
        depth: usize,
        plane: usize,
    ) -> [[Self::Vector; N]; P] {
        macro_rules! channel {
            ($values:ident, $lane:literal) => {
                let weights = consecutive::<Self, N>(panel.add($lane * N * Self::LANES));
                for (sums, value) in sums.iter_mut().zip($values) {
                    for (sum, weight) in sums.iter_mut().zip(weights) {
                        *sum = vfmaq_laneq_f32::<$lane>(*sum, weight, value);
                    }
                }
            };
        }
        // Two vectors of channels per round halve the cost of the loop itself; channels come in multiples of eight.
        for _ in 0..depth / (2 * Self::LANES) {
            for _ in 0..2 {
                // SAFETY: the operand and the panel go on for `depth` channels.
                unsafe {
                    let values = consecutive::<Self, P>(operand);
                    channel!(values, 0);
                    channel!(values, 1);
                    channel!(values, 2);
                    channel!(values, 3);
                    panel = panel.add(4 * N * Self::LANES);
                }
                // After the last round the pointer is not read.
                operand = operand.wrapping_add(plane);
            }
        }
        sums
    }

    /// Four windows six values apart overlap so much that a few loads cover all of them; each value is then a lane.
    #[inline(always)]
    unsafe fn window_row<const P: usize, const N: usize, const SPAN: usize>(
        sums: [[Self::Vector; N]; P],
        from: *const f32,
        panel: *const f32,
        step: usize,
        span: usize,
    ) -> [[Self::Vector; N]; P] {
        // SAFETY: the caller vouches for the pointers.
        unsafe {
            match (P, SPAN) {
                (4, 9) => lanes_row!(sums, from, panel, [0 1 2 3 4 5 6 7 8]),
                (4, 15) => lanes_row!(sums, from, panel, [0 1 2 3 4 5 6 7 8 9 10 11 12 13 14]),
                _ => broadcast_row::<Self, P, N>(sums, from, panel, step, span),
            }
        }
    }
}

kernels!(Neon<false>, "neon", vectors: 2, tail: 2, stem_vectors: 4, dense_vectors: 8, dense_half: false, features: "neon");
