//! Converts luma and chroma to red, green and blue, for [`sample`](super::sample).
//!
//! Factors are in units of 1/8192, and each product is rounded down by itself.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(target_arch = "aarch64")]
mod neon;
#[cfg(test)]
mod tests;

use super::sample::Pixel;

/// Pixels that are converted at a time.
pub const GROUP: usize = 16;

/// The factors of a conversion, in units of 1/8192.
#[derive(Debug, Clone, Copy)]
pub struct Factors {
    /// The factor of luma in all channels.
    pub luma: i16,
    /// The luma of black.
    pub black: i16,
    /// The factor of Cr in red.
    pub red: i16,
    /// The factors of Cb and Cr in green.
    pub green: [i16; 2],
    /// The factor of Cb in blue.
    pub blue: i16,
}

/// Samples of consecutive pixels of a row. The first pixel shares its chroma with the second one.
#[derive(Debug, Clone, Copy)]
pub enum Samples<'a> {
    /// `Y0 Cb Y1 Cr`.
    Yuyv(&'a [u8]),
    /// A plane of luma, and a plane with `Cb Cr` for every two pixels.
    SemiPlanar(&'a [u8], &'a [u8]),
    /// Planes of luma, Cb and Cr. Two pixels share a sample of Cb and Cr.
    Planar([&'a [u8]; 3]),
    /// Luma only.
    Grey(&'a [u8]),
}

impl Samples<'_> {
    /// How many pixels have all their samples.
    fn pixels(&self) -> usize {
        match self {
            Self::Yuyv(samples) => samples.len() / 4 * 2,
            Self::SemiPlanar(luma, chroma) => luma.len().min(chroma.len() / 2 * 2),
            Self::Planar([luma, cb, cr]) => luma.len().min(2 * cb.len()).min(2 * cr.len()),
            Self::Grey(luma) => luma.len(),
        }
    }

    /// Luma, Cb and Cr of one pixel.
    fn pixel(&self, number: usize) -> [u8; 3] {
        let (pair, first) = (number / 2, number / 2 * 2);
        match self {
            Self::Yuyv(samples) => [samples[2 * number], samples[4 * pair + 1], samples[4 * pair + 3]],
            Self::SemiPlanar(luma, chroma) => [luma[number], chroma[first], chroma[first + 1]],
            Self::Planar([luma, cb, cr]) => [luma[number], cb[pair], cr[pair]],
            Self::Grey(luma) => [luma[number], NO_COLOUR, NO_COLOUR],
        }
    }
}

/// Chroma of a grey pixel.
pub const NO_COLOUR: u8 = 128;

/// Converts whole groups of pixels. There must be samples for all of them.
type Converter = unsafe fn(&Factors, &Samples, &mut [[Pixel; GROUP]]);

/// Converts as many pixels as `output` has.
///
/// # Panics
/// If there are fewer samples.
pub fn convert(factors: &Factors, samples: &Samples, output: &mut [[Pixel; GROUP]]) {
    assert!(samples.pixels() >= output.as_flattened().len(), "there are fewer samples than pixels");
    // SAFETY: there are enough samples.
    unsafe { available().next().unwrap_or(plain)(factors, samples, output) }
}

/// The converters for the instruction sets of this processor; the fastest comes first.
fn available() -> impl Iterator<Item = Converter> {
    let mut all: [Option<Converter>; 3] = [None, None, Some(plain)];
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        all[1] = Some(avx2::convert);
        if is_x86_feature_detected!("avx512f") && is_x86_feature_detected!("avx512bw") {
            all[0] = Some(avx512::convert);
        }
    }
    #[cfg(target_arch = "aarch64")]
    if std::arch::is_aarch64_feature_detected!("neon") {
        all[1] = Some(neon::convert);
    }
    #[cfg(all(target_arch = "arm", target_os = "linux", target_endian = "little"))]
    if super::armv7::detected() {
        all[1] = Some(super::armv7::convert);
    }
    all.into_iter().flatten()
}

/// Copies groups of pixels out of bytes. There must be bytes for all of them, and each place must be below the step.
type Unpacker = unsafe fn(&[u8], Packing, &mut [[Pixel; GROUP]]);

/// Pixels of `step` bytes, in which red, green and blue are at the places `rgb`.
#[derive(Debug, Clone, Copy)]
pub struct Packing {
    /// Bytes from one pixel to the next.
    pub step: usize,
    /// The places of red, green and blue among the bytes of a pixel.
    pub rgb: [usize; 3],
}

/// Copies as many pixels as `output` has out of the bytes of a row. Without bytes for all of them, or with a place outside of a
/// pixel, the output remains as it is.
pub fn unpack(row: &[u8], packing: Packing, output: &mut [[Pixel; GROUP]]) {
    let Packing { step, rgb } = packing;
    if rgb.iter().all(|place| *place < step) && row.len() / step >= output.as_flattened().len() {
        // SAFETY: there are enough pixels, and each has its colours.
        unsafe { unpackers(packing).next().unwrap_or(unpack_plain)(row, packing, output) }
    }
}

/// The unpackers for the instruction sets of this processor; the fastest comes first.
fn unpackers(packing: Packing) -> impl Iterator<Item = Unpacker> {
    let vectors = if matches!(packing.step, 3 | 4) { unpacker_of_vectors() } else { None };
    [vectors, Some(unpack_plain as Unpacker)].into_iter().flatten()
}

#[cfg(target_arch = "x86_64")]
fn unpacker_of_vectors() -> Option<Unpacker> {
    is_x86_feature_detected!("avx2").then_some(avx2::unpack as Unpacker)
}

#[cfg(target_arch = "aarch64")]
fn unpacker_of_vectors() -> Option<Unpacker> {
    std::arch::is_aarch64_feature_detected!("neon").then_some(neon::unpack as Unpacker)
}

#[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
fn unpacker_of_vectors() -> Option<Unpacker> {
    None
}

fn unpack_plain(row: &[u8], Packing { step, rgb }: Packing, output: &mut [[Pixel; GROUP]]) {
    // The compiler makes code of its own for the usual formats.
    match (step, rgb) {
        (3, [0, 1, 2]) => unpack_each(row, 3, [0, 1, 2], output),
        (3, [2, 1, 0]) => unpack_each(row, 3, [2, 1, 0], output),
        (4, [0, 1, 2]) => unpack_each(row, 4, [0, 1, 2], output),
        (4, [2, 1, 0]) => unpack_each(row, 4, [2, 1, 0], output),
        _ => unpack_each(row, step, rgb, output),
    }
}

#[inline(always)]
fn unpack_each(row: &[u8], step: usize, rgb: [usize; 3], output: &mut [[Pixel; GROUP]]) {
    for (pixel, bytes) in output.as_flattened_mut().iter_mut().zip(row.chunks_exact(step)) {
        let [red, green, blue] = rgb.map(|place| bytes.get(place).map_or(0, |value| i16::from(*value)));
        *pixel = [red, green, blue, 0];
    }
}

fn plain(factors: &Factors, samples: &Samples, output: &mut [[Pixel; GROUP]]) {
    for (number, pixel) in output.as_flattened_mut().iter_mut().enumerate() {
        *pixel = factors.pixel(samples.pixel(number));
    }
}

impl Factors {
    /// Converts one pixel.
    #[must_use]
    #[inline]
    pub fn pixel(&self, [luma, cb, cr]: [u8; 3]) -> Pixel {
        #[expect(clippy::cast_possible_truncation, reason = "a sample has 9 bits, and a factor counts 1/8192")]
        let product = |sample: i16, factor: i16| ((i32::from(sample) * i32::from(factor)) >> 13) as i16;
        let luma = product(i16::from(luma) - self.black, self.luma);
        let [cb, cr] = [cb, cr].map(|chroma| i16::from(chroma) - i16::from(NO_COLOUR));
        let green = product(cb, self.green[0]) + product(cr, self.green[1]);
        [luma + product(cr, self.red), luma + green, luma + product(cb, self.blue), 0]
    }
}
