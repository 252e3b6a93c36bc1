//! Samples a picture along a line by bilinear interpolation.
//!
//! Positions are in 16.16 fixed point and are rounded down to 1/32 pixel. All sums are exact in integers, so every
//! instruction set computes the same bits.
#![allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::cast_sign_loss, reason = "MAX_PIXELS")]

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(target_arch = "aarch64")]
mod neon;
#[cfg(test)]
mod tests;

/// A pixel: red, green, blue, and a value that is not used. A channel lies between -511 and 1023.
pub type Pixel = [i16; 4];

/// Full brightness of a weighted sum of four pixels, whose weights add up to 1024.
pub const WHITE: i32 = 255 << 10;

/// Largest number of pixels, so that the number of their bytes fits 32 bits.
const MAX_PIXELS: usize = 1 << 28;

/// Samples at equal distances on a straight line.
#[derive(Debug, Clone, Copy)]
pub struct Line<'a> {
    /// Rows of pixels.
    pub pixels: &'a [Pixel],
    /// Pixels from one row to the next.
    pub stride: usize,
    /// Column and row of the first sample.
    pub start: [i32; 2],
    /// Columns and rows from one sample to the next.
    pub step: [i32; 2],
    /// The value of one level. Level 0 is black, and level [`WHITE`] is full brightness.
    pub scale: f32,
}

/// Computes samples into values. The line must be inside its pixels, and a sample takes three values.
type Sampler = unsafe fn(&Line, &mut [f32]);

/// Fills `output` with red, green and blue of one sample after the other.
///
/// # Panics
/// If the line leaves the pixels, or if `output` ends within a sample.
pub fn sample(line: &Line, output: &mut [f32]) {
    assert!(output.len().is_multiple_of(3) && line.is_inside(output.len() / 3), "the line leaves the pixels");
    // SAFETY: the line is inside its pixels.
    unsafe { available().next().unwrap_or(plain_from_start)(line, output) }
}

/// The samplers for the instruction sets of this processor; the fastest comes first.
fn available() -> impl Iterator<Item = Sampler> {
    let mut all: [Option<Sampler>; 3] = [None, None, Some(plain_from_start)];
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw") {
        all[0] = Some(avx512::sample);
    }
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        all[1] = Some(avx2::sample);
    }
    #[cfg(target_arch = "aarch64")]
    if std::arch::is_aarch64_feature_detected!("neon") {
        all[1] = Some(neon::sample);
    }
    #[cfg(all(target_arch = "arm", target_os = "linux", target_endian = "little"))]
    if super::armv7::detected() {
        all[1] = Some(super::armv7::sample);
    }
    all.into_iter().flatten()
}

fn plain_from_start(line: &Line, output: &mut [f32]) {
    plain(line, 0, output);
}

impl Line<'_> {
    /// Returns whether all four pixels around each of the first `samples` samples exist.
    #[inline]
    fn is_inside(&self, samples: usize) -> bool {
        let Ok(last) = i64::try_from(samples.saturating_sub(1)) else { return false };
        let ends = |axis: usize| {
            let first = i64::from(self.start[axis]);
            [first, first + last * i64::from(self.step[axis])].map(|at| at >> 16)
        };
        // The line is straight, so it is inside if both its ends are.
        let ([left, right], [top, bottom]) = (ends(0), ends(1));
        let (Ok(stride), Ok(pixels)) = (i64::try_from(self.stride), i64::try_from(self.pixels.len())) else {
            return false;
        };
        let columns = left.min(right) >= 0 && left.max(right) + 1 < stride;
        let rows = top.min(bottom) >= 0 && (top.max(bottom) + 2).checked_mul(stride).is_some_and(|end| end <= pixels);
        columns && rows && self.pixels.len() <= MAX_PIXELS
    }

    /// The column and the row of a sample.
    pub(super) fn position(&self, number: usize) -> [i32; 2] {
        [0, 1].map(|axis| self.start[axis].wrapping_add(self.step[axis].wrapping_mul(number as i32)))
    }
}

/// Computes the samples from number `first` on.
pub(super) fn plain(line: &Line, first: usize, output: &mut [f32]) {
    for (number, sample) in output.chunks_exact_mut(3).enumerate() {
        let position = line.position(first + number);
        let [column, row] = position.map(|at| (at >> 16) as usize);
        let [right, down] = position.map(|at| at >> 11 & 31);
        let top = row * line.stride + column;
        let [top, bottom] = [top, top + line.stride].map(|at| [line.pixels[at], line.pixels[at + 1]]);
        for (channel, value) in sample.iter_mut().enumerate() {
            let mix = |row: [Pixel; 2]| {
                let [left_pixel, right_pixel] = row.map(|pixel| i32::from(pixel[channel]));
                left_pixel * (32 - right) + right_pixel * right
            };
            let level = mix(top) * (32 - down) + mix(bottom) * down;
            *value = level.clamp(0, WHITE) as f32 * line.scale;
        }
    }
}
