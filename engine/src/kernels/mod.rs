//! The arithmetic of the networks, once for each instruction set.
//!
//! Maps are stored pixel by pixel, with the channels of a pixel beside each other; their number is padded with zeros to
//! a multiple of [`Kernels::lanes`]. A pointwise convolution is a product of two matrices, pixels and weights, which are
//! stored so that the inner loop reads both of them in order:
//!
//! - Pixels form the *operand*: the first [`Kernels::vector`] channels of all pixels, then the next channels of all
//!   pixels, and so on. The depthwise convolution before it writes this form.
//! - Weights come in *panels* of [`Kernels::panel`] output channels: all output channels of the panel for the first
//!   input channel, then for the next one. The last output channels, which do not fill a panel, come in panels of
//!   [`Kernels::lanes`].
//!
//! Each function checks the sizes of its task once for each call. It panics if they do not fit together, which is a
//! mistake of the caller.

#[cfg(all(target_arch = "arm", target_os = "linux", target_endian = "little"))]
mod armv7;
pub mod convert;
mod dense;
mod depthwise;
mod finish;
#[cfg(target_arch = "aarch64")]
mod half;
pub(crate) mod half_precision;
mod peak;
mod plain;
mod pointwise;
pub mod rows;
pub mod sample;
mod stem;
mod table;
#[cfg(test)]
mod tests;
mod vector;

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(target_arch = "aarch64")]
mod neon;

/// The functions of one instruction set and the storage orders they need.
pub struct Kernels {
    /// Name of the instruction set, in lower case.
    pub name: &'static str,
    /// Numbers of channels are padded to a multiple of this.
    pub lanes: usize,
    /// Values of a vector.
    pub vector: usize,
    /// Whether the operand and the weights of a pointwise convolution are in half precision: two values take the place of
    /// one `f32`, the first of them in the lower bits.
    pub half: bool,
    /// Output channels of a panel of weights.
    pub panel: usize,
    /// Output channels of a panel of the first convolution.
    pub stem_panel: usize,
    /// Outputs of a panel of a dense layer.
    pub dense_panel: usize,
    /// Whether the weights of a dense layer may be in half precision, as in [`half`](Self::half). Such a layer takes
    /// as long as reading its weights from memory.
    pub dense_half: bool,
    /// Computes one row of the first convolution.
    pub stem: fn(&Stem, &mut [f32]),
    /// Computes one or two rows of a depthwise 3 x 3 convolution into an operand. The last argument receives the largest
    /// value of every 2 x 2 pixels if the stride is 2; otherwise it is empty.
    pub depthwise: fn(&Depthwise, &mut [f32], &mut [f32]),
    /// Computes a pointwise convolution.
    pub pointwise: fn(&Pointwise, &mut [f32]),
    /// Computes weighted sums of a whole map.
    pub dense: fn(&Dense, &mut [f32]),
    /// Computes a number of rounds of [`peak_round`](Self::peak_round) multiply-adds that read and write no memory, and
    /// returns one of the results.
    pub peak: fn(usize) -> f32,
    /// Multiply-adds of one round.
    pub peak_round: usize,
}

impl Kernels {
    /// Copies pixels of `channels` values into an operand.
    pub fn operand_of(&self, pixels: &[f32], channels: usize, operand: &mut [f32]) {
        let plane = pixels.len() / channels * self.vector;
        for (number, pixel) in pixels.chunks_exact(channels).enumerate() {
            for (group, values) in pixel.chunks_exact(self.vector).enumerate() {
                let at = group * plane + number * self.vector;
                if self.half {
                    let halves = &mut operand[at / 2..][..self.vector / 2];
                    halves
                        .iter_mut()
                        .zip(values.as_chunks().0)
                        .for_each(|(to, pair)| *to = half_precision::pair(*pair));
                } else {
                    operand[at..at + self.vector].copy_from_slice(values);
                }
            }
        }
    }
}

/// What follows a sum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Activation<'a> {
    /// Nothing.
    None,
    /// Negative values become zero.
    Relu,
    /// Negative values are multiplied by the slope of their channel; there is one slope per padded channel.
    Prelu(&'a [f32]),
}

/// One row of the convolution that reads the picture.
#[derive(Debug, Clone, Copy)]
pub struct Stem<'a> {
    /// The rows of the picture that the windows cover. Each begins with the first value of the first window.
    pub rows: &'a [&'a [f32]],
    /// Values from one position of the window to the next.
    pub step: usize,
    /// Values of one row of the window.
    pub span: usize,
    /// Panels of weights: all output channels of the panel for the first value of the window, then for the next one.
    pub weights: &'a [f32],
    /// One addend per padded output channel.
    pub bias: &'a [f32],
    /// What follows the sum.
    pub activation: Activation<'a>,
    /// Pixels of the row.
    pub pixels: usize,
}

/// One or two rows of a depthwise 3 x 3 convolution.
#[derive(Debug, Clone, Copy)]
pub struct Depthwise<'a> {
    /// The input rows that the windows cover; three for one output row, four for two.
    pub rows: [&'a [f32]; 4],
    /// How many output rows: 1, or 2 if the stride is 1.
    pub output_rows: usize,
    /// 1 or 2.
    pub stride: usize,
    /// Nine weights for each padded channel, ordered by vector of channels, then by row, column and channel.
    pub weights: &'a [f32],
    /// Padded channels.
    pub channels: usize,
    /// Pixels of an output row. With stride 2 an input row has twice as many.
    pub columns: usize,
    /// Number of the first output pixel in the operand.
    pub first_pixel: usize,
    /// Pixels of the operand.
    pub pixels: usize,
}

/// A pointwise convolution of some pixels.
#[derive(Debug, Clone, Copy)]
pub struct Pointwise<'a> {
    /// The pixels as an operand.
    pub operand: &'a [f32],
    /// Number of pixels.
    pub pixels: usize,
    /// Padded input channels.
    pub depth: usize,
    /// Padded output channels.
    pub channels: usize,
    /// Panels of weights.
    pub weights: &'a [f32],
    /// One addend per padded output channel.
    pub bias: &'a [f32],
    /// Values that are added to the first channels of each pixel before the activation, pixel by pixel. May be empty.
    pub residual: &'a [f32],
    /// Padded channels of a pixel of the residual.
    pub residual_channels: usize,
    /// What follows the sum.
    pub activation: Activation<'a>,
}

/// Weighted sums of all values of a map.
#[derive(Debug, Clone, Copy)]
pub struct Dense<'a> {
    /// The values.
    pub input: &'a [f32],
    /// Panels of [`Kernels::dense_panel`] outputs.
    pub weights: &'a [f32],
    /// Whether the weights are in half precision.
    pub half: bool,
    /// One addend per padded output.
    pub bias: &'a [f32],
}

/// The fastest kernels of this machine.
#[must_use]
pub fn fastest() -> &'static Kernels {
    available().first().copied().unwrap_or(&plain::KERNELS)
}

/// The kernels of this machine with a given [`name`](Kernels::name).
#[must_use]
pub fn named(name: &str) -> Option<&'static Kernels> {
    available().into_iter().find(|kernels| kernels.name == name)
}

/// The kernels of this machine; the fastest come first, and the plain ones last.
#[must_use]
pub fn available() -> Vec<&'static Kernels> {
    let mut all = Vec::new();
    #[cfg(target_arch = "x86_64")]
    {
        if is_x86_feature_detected!("avx512f") {
            all.push(&avx512::KERNELS);
        }
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") && is_x86_feature_detected!("f16c") {
            all.push(&avx2::KERNELS);
        }
    }
    #[cfg(target_arch = "aarch64")]
    if std::arch::is_aarch64_feature_detected!("neon") {
        if std::arch::is_aarch64_feature_detected!("fp16") {
            all.push(&half::HALF);
        }
        all.push(&neon::KERNELS);
    }
    #[cfg(all(target_arch = "arm", target_os = "linux", target_endian = "little"))]
    if armv7::detected() {
        all.push(&armv7::KERNELS);
    }
    all.push(&plain::KERNELS);
    all
}
