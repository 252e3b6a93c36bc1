//! Kernels for 32-bit ARM with NEON, in assembly: this target has no stable intrinsics, and its compiler may not use NEON
//! for `f32` by itself. Each assembly function computes one panel or one row; the functions here check the sizes of a
//! task and fill in the structure that the assembly reads, whose fields it finds by their offsets.
//!
//! NEON of this architecture treats subnormal values as zero. Multiply-adds are fused, as in the other kernels, which takes
//! VFPv4: Cortex-A5, A7, A15 and all later cores have it. Cortex-A8 and A9 use the plain kernels.

mod convert;
mod sample;

use std::arch::global_asm;
use std::ffi::c_ulong;
use std::ptr::null;

use super::finish::are_gentle;
use super::peak::FACTOR;
use super::{Activation, Dense, Depthwise, Kernels, Pointwise, Stem};
use super::{dense, depthwise, pointwise, stem};

global_asm!(
    include_str!("start.s"),
    include_str!("pointwise.s"),
    include_str!("depthwise.s"),
    include_str!("stem.s"),
    include_str!("dense.s"),
    include_str!("convert.s"),
    include_str!("sample.s"),
    include_str!("rows.s"),
    include_str!("byte_rows.s"),
    include_str!("peak.s"),
    include_str!("end.s"),
    options(raw)
);

pub(super) use convert::convert;
pub(super) use sample::sample;

pub(super) static KERNELS: Kernels = Kernels {
    name: "neon",
    lanes: PANEL,
    vector: VECTOR,
    half: false,
    stem_panel: PANEL,
    panel: PANEL,
    dense_panel: DENSE_PANEL,
    dense_half: false,
    stem: compute_stem,
    depthwise: compute_depthwise,
    pointwise: compute_pointwise,
    dense: compute_dense,
    // SAFETY: these kernels are handed out only where VFPv4 was detected.
    peak: |rounds| f32::from_bits(unsafe { peak_rounds(rounds, FACTOR.to_bits()) }),
    peak_round: 8 * VECTOR,
};

/// Values of a register.
const VECTOR: usize = 4;
/// Output channels of a panel of the convolutions. With two pixels, their sums fill half of the registers.
const PANEL: usize = 16;
/// Outputs of a panel of a dense layer. Their sums fill half of the registers.
const DENSE_PANEL: usize = 32;
/// Rows of the largest window of the first convolution.
const MAX_WINDOW: usize = 8;
/// Bytes of a value.
const VALUE: usize = size_of::<f32>();

/// Whether the processor has NEON and VFPv4, according to the kernel of the operating system.
pub(super) fn detected() -> bool {
    unsafe extern "C" {
        safe fn getauxval(entry: c_ulong) -> c_ulong;
    }
    const AT_HWCAP: c_ulong = 16;
    const HWCAP_NEON: c_ulong = 1 << 12;
    const HWCAP_VFPV4: c_ulong = 1 << 16;
    let needed = HWCAP_NEON | HWCAP_VFPV4;
    getauxval(AT_HWCAP) & needed == needed
}

unsafe extern "C" {
    #[link_name = "facewire_engine_neon_pointwise"]
    unsafe fn pointwise_panel(panel: &PointwisePanel);
    #[link_name = "facewire_engine_neon_depthwise"]
    unsafe fn depthwise_row(row: &DepthwiseRow);
    #[link_name = "facewire_engine_neon_depthwise_stride_2"]
    unsafe fn depthwise_row_of_stride_2(row: &DepthwiseRow);
    #[link_name = "facewire_engine_neon_depthwise_stride_2_largest"]
    unsafe fn depthwise_row_of_stride_2_with_largest(row: &DepthwiseRow);
    #[link_name = "facewire_engine_neon_stem"]
    unsafe fn stem_panel(panel: &StemPanel);
    #[link_name = "facewire_engine_neon_dense"]
    unsafe fn dense_panels(panels: &DensePanels);
    #[link_name = "facewire_engine_neon_rows"]
    unsafe fn weighted_rows(rows: &Rows);
    #[link_name = "facewire_engine_neon_byte_rows"]
    unsafe fn weighted_byte_rows(rows: &ByteRows);
    /// Takes and returns the bits of `f32`, because the ABIs of 32-bit ARM use different registers for an `f32`.
    #[link_name = "facewire_engine_neon_peak"]
    unsafe fn peak_rounds(rounds: usize, factor: u32) -> u32;
}

/// The activation of a panel, as the assembly reads it: its slopes, and the number that `start.s` lists at `finish`.
fn finish(activation: Activation, channel: usize) -> (*const f32, usize) {
    match activation {
        Activation::None => (null(), 0),
        Activation::Relu => (null(), 1),
        Activation::Prelu(slopes) => {
            let slopes = &slopes[channel..channel + PANEL];
            (slopes.as_ptr(), if are_gentle(slopes) { 2 } else { 3 })
        }
    }
}

/// A pointwise convolution to one panel of output channels. Steps are in bytes, from pixel to pixel.
#[repr(C)]
struct PointwisePanel {
    operand: *const f32,
    weights: *const f32,
    bias: *const f32,
    slopes: *const f32,
    activation: usize,
    /// Null if there is none.
    residual: *const f32,
    output: *mut f32,
    pixels: usize,
    /// Input channels, in units of sixteen.
    sixteens: usize,
    /// Bytes from a vector of channels of the operand to the next.
    plane: usize,
    residual_step: usize,
    output_step: usize,
}

fn compute_pointwise(task: &Pointwise, output: &mut [f32]) {
    pointwise::check(task, PANEL, 1, output);
    let residual_channels = if task.residual.is_empty() { 0 } else { task.residual_channels };
    for channel in (0..task.channels).step_by(PANEL) {
        let (slopes, activation) = finish(task.activation, channel);
        let panel = PointwisePanel {
            operand: task.operand.as_ptr(),
            weights: task.weights[channel * task.depth..].as_ptr(),
            bias: task.bias[channel..].as_ptr(),
            slopes,
            activation,
            residual: if channel < residual_channels { task.residual[channel..].as_ptr() } else { null() },
            output: output[channel..].as_mut_ptr(),
            pixels: task.pixels,
            sixteens: task.depth / 16,
            plane: task.pixels * VECTOR * VALUE,
            residual_step: residual_channels * VALUE,
            output_step: task.channels * VALUE,
        };
        // SAFETY: the sizes were checked; these kernels are handed out only where VFPv4 was detected.
        unsafe { pointwise_panel(&panel) }
    }
}

/// One output row of a depthwise convolution, with all channels.
#[repr(C)]
struct DepthwiseRow {
    rows: [*const f32; 3],
    /// Bytes from pixel to pixel of the rows.
    step: usize,
    weights: *const f32,
    output: *mut f32,
    /// How many times the assembly's loop runs, and how many columns or windows follow it.
    rounds: isize,
    rest: isize,
    /// Vectors of channels.
    vectors: usize,
    /// Bytes from a vector of channels of the output to the next.
    plane: usize,
    largest: *mut f32,
}

fn compute_depthwise(task: &Depthwise, output: &mut [f32], largest: &mut [f32]) {
    depthwise::check(task, VECTOR, output, largest);
    // Columns that the loop takes four at a time, or windows that it takes two at a time.
    let columns = task.columns.cast_signed();
    let (rounds, rest) = match (task.stride, columns) {
        (1, ..3) => (columns - 3, 0),
        (1, _) => ((columns - 3) / 4, (columns - 3) % 4),
        _ => ((columns - 1) / 2, (columns - 1) % 2),
    };
    for row in 0..task.output_rows {
        let row = DepthwiseRow {
            rows: std::array::from_fn(|above| task.rows[row + above].as_ptr()),
            step: task.channels * VALUE,
            weights: task.weights.as_ptr(),
            output: output[(task.first_pixel + row * task.columns) * VECTOR..].as_mut_ptr(),
            rounds,
            rest,
            vectors: task.channels / VECTOR,
            plane: task.pixels * VECTOR * VALUE,
            largest: largest.as_mut_ptr(),
        };
        // SAFETY: the sizes were checked; these kernels are handed out only where VFPv4 was detected.
        unsafe {
            match (task.stride, largest.is_empty()) {
                (1, _) => depthwise_row(&row),
                (_, true) => depthwise_row_of_stride_2(&row),
                (_, false) => depthwise_row_of_stride_2_with_largest(&row),
            }
        }
    }
}

/// One row of the first convolution, to one panel of output channels.
#[repr(C)]
struct StemPanel {
    rows: *const *const f32,
    weights: *const f32,
    bias: *const f32,
    slopes: *const f32,
    activation: usize,
    output: *mut f32,
    pixels: usize,
    row_count: usize,
    /// Values of a row of the window, without the last one: how many pairs, and whether one value follows them.
    pairs: usize,
    rest: usize,
    /// Bytes from one window to the next.
    step: usize,
    /// Bytes from pixel to pixel of the output.
    output_step: usize,
}

fn compute_stem(task: &Stem, output: &mut [f32]) {
    stem::check(task, PANEL, output);
    let mut rows = [null(); MAX_WINDOW];
    for (pointer, row) in rows[..task.rows.len()].iter_mut().zip(task.rows) {
        *pointer = row.as_ptr();
    }
    for channel in (0..task.bias.len()).step_by(PANEL) {
        let (slopes, activation) = finish(task.activation, channel);
        let panel = StemPanel {
            rows: rows.as_ptr(),
            weights: task.weights[channel * task.rows.len() * task.span..].as_ptr(),
            bias: task.bias[channel..].as_ptr(),
            slopes,
            activation,
            output: output[channel..].as_mut_ptr(),
            pixels: task.pixels,
            row_count: task.rows.len(),
            pairs: (task.span - 1) / 2,
            rest: (task.span - 1) % 2,
            step: task.step * VALUE,
            output_step: task.bias.len() * VALUE,
        };
        // SAFETY: the sizes were checked; these kernels are handed out only where VFPv4 was detected.
        unsafe { stem_panel(&panel) }
    }
}

/// A dense layer.
#[repr(C)]
struct DensePanels {
    input: *const f32,
    weights: *const f32,
    bias: *const f32,
    output: *mut f32,
    depth: usize,
    panels: usize,
}

fn compute_dense(task: &Dense, output: &mut [f32]) {
    dense::check(task, DENSE_PANEL, output);
    let panels = DensePanels {
        input: task.input.as_ptr(),
        weights: task.weights.as_ptr(),
        bias: task.bias.as_ptr(),
        output: output.as_mut_ptr(),
        depth: task.input.len(),
        panels: task.bias.len() / DENSE_PANEL,
    };
    if panels.panels > 0 {
        // SAFETY: the sizes were checked; these kernels are handed out only where VFPv4 was detected.
        unsafe { dense_panels(&panels) }
    }
}

/// Weighted rows that are added to sums.
#[repr(C)]
struct Rows {
    sums: *mut f32,
    rows: *const f32,
    factors: *const f32,
    count: usize,
    /// A multiple of four.
    columns: usize,
    row_bytes: usize,
}

/// See [`super::rows::add_rows`].
///
/// # Safety
/// The processor must have VFPv4, and `N` must be a multiple of four.
pub(super) unsafe fn add_rows<const N: usize>(sums: &mut [f32; N], rows: &[[f32; N]], factors: &[f32]) {
    let rows = Rows {
        sums: sums.as_mut_ptr(),
        rows: rows.as_ptr().cast(),
        factors: factors.as_ptr(),
        count: rows.len().min(factors.len()),
        columns: N,
        row_bytes: N * VALUE,
    };
    // SAFETY: the caller vouches for VFPv4 and the number of columns.
    unsafe { weighted_rows(&rows) }
}

/// Weighted rows of 8-bit numbers that are added to sums.
#[repr(C)]
struct ByteRows {
    sums: *mut f32,
    rows: *const i8,
    factors: *const f32,
    count: usize,
    /// Units of eight columns.
    eights: usize,
}

/// See [`super::rows::add_byte_rows`].
///
/// # Safety
/// The processor must have VFPv4, and `N` must be a multiple of eight.
pub(super) unsafe fn add_byte_rows<const N: usize>(sums: &mut [f32; N], rows: &[[i8; N]], factors: &[f32]) {
    let rows = ByteRows {
        sums: sums.as_mut_ptr(),
        rows: rows.as_ptr().cast(),
        factors: factors.as_ptr(),
        count: rows.len().min(factors.len()),
        eights: N / 8,
    };
    // SAFETY: the caller vouches for VFPv4 and the number of columns.
    unsafe { weighted_byte_rows(&rows) }
}
