//! Kernels for aarch64 whose pointwise convolutions compute in half precision, eight values to a register, for cores that
//! have it: Cortex-A55, Cortex-A76 and later ones. All other kernels are those of [`super::neon`].
//!
//! Maps, bias and residual stay in single precision, and so do sums over more than [`GROUP`] channels. On faces, landmarks
//! then lie 0.006 px from those of single precision on average, and at most 0.04 px, in a region of 192 px. With groups of 32
//! channels they would lie 0.010 px away and at most 0.064 px; with sums in half precision over all channels 0.018 and
//! 0.103 px.

use std::arch::global_asm;

use super::finish::are_gentle;
use super::neon::Neon;
use super::pointwise::check;
use super::table::kernels;
use super::vector::InstructionSet;
use super::{Activation, Kernels, Pointwise};

global_asm!(include_str!("pointwise.s"), options(raw));

/// Output channels of a panel. With eight pixels, their sums take half of the registers.
const PANEL: usize = 16;
/// Input channels whose products are added up in half precision.
const GROUP: usize = 16;
/// Values of a vector of channels.
const VECTOR: usize = 4;

// `HALF` replaces the pointwise convolution of this table.
kernels!(Neon<true>, "neon-half", vectors: 2, tail: 4, stem_vectors: 4, dense_vectors: 8, dense_half: false, features: "neon");

pub(super) static HALF: Kernels = Kernels { half: true, panel: PANEL, pointwise: half_pointwise, ..KERNELS };

unsafe extern "C" {
    #[link_name = "facewire_engine_half_pointwise"]
    unsafe fn pointwise_panel(panel: &Panel);
}

/// A pointwise convolution to one panel of output channels, as the assembly takes it.
#[repr(C)]
struct Panel {
    operand: *const f32,
    weights: *const f32,
    bias: *const f32,
    slopes: *const f32,
    /// Whether a slope is above 1. If none is, the result is the larger of a value and its product with the slope.
    is_steep: usize,
    residual: *const f32,
    output: *mut f32,
    pixels: usize,
    /// Groups of input channels, besides the last one.
    groups: usize,
    /// Bytes from a vector of channels of the operand to the next.
    plane: usize,
    /// Bytes from pixel to pixel.
    residual_step: usize,
    output_step: usize,
}

/// See [`Kernels::pointwise`].
fn half_pointwise(task: &Pointwise, output: &mut [f32]) {
    check(task, PANEL, 2, output);
    let residual_channels = if task.residual.is_empty() { 0 } else { task.residual_channels };
    for channel in (0..task.channels).step_by(PANEL) {
        let (slopes, is_steep) = match task.activation {
            Activation::None => (&[1.0; PANEL][..], false),
            Activation::Relu => (&[0.0; PANEL][..], false),
            Activation::Prelu(slopes) => {
                let slopes = &slopes[channel..channel + PANEL];
                (slopes, !are_gentle(slopes))
            }
        };
        let (residual, residual_step) = if channel < residual_channels {
            (&task.residual[channel..], residual_channels * size_of::<f32>())
        } else {
            (&[0.0; PANEL][..], 0)
        };
        let panel = Panel {
            operand: task.operand.as_ptr(),
            weights: task.weights[channel * task.depth / 2..].as_ptr(),
            bias: task.bias[channel..].as_ptr(),
            slopes: slopes.as_ptr(),
            is_steep: usize::from(is_steep),
            residual: residual.as_ptr(),
            output: output[channel..].as_mut_ptr(),
            pixels: task.pixels,
            groups: task.depth / GROUP - 1,
            plane: task.pixels * VECTOR * size_of::<u16>(),
            residual_step,
            output_step: task.channels * size_of::<f32>(),
        };
        // SAFETY: the sizes were checked; these kernels are handed out only where half precision was detected.
        unsafe { pointwise_panel(&panel) }
    }
}
