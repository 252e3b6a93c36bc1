//! Sixteen pixels at a time with AVX2.

use std::arch::x86_64::{
    __m128i, __m256i, _mm_add_epi8, _mm_loadl_epi64, _mm_loadu_si128, _mm_set1_epi32, _mm_setr_epi8, _mm_setr_epi32,
    _mm_shuffle_epi8, _mm_unpacklo_epi8, _mm256_add_epi16, _mm256_and_si256, _mm256_broadcastsi128_si256,
    _mm256_cvtepu8_epi16, _mm256_loadu_si256, _mm256_mulhi_epi16, _mm256_permutevar8x32_epi32, _mm256_set1_epi16,
    _mm256_set1_epi32, _mm256_setzero_si256, _mm256_shuffle_epi8, _mm256_slli_epi16, _mm256_srli_epi16,
    _mm256_storeu_si256, _mm256_sub_epi16, _mm256_unpackhi_epi16, _mm256_unpackhi_epi32, _mm256_unpacklo_epi16,
    _mm256_unpacklo_epi32,
};

use super::{Factors, GROUP, NO_COLOUR, Packing, Pixel, Samples};

/// Bytes of the vectors that [`unpack`] reads.
const VECTOR: usize = 16;

/// The order of pairs of pixels in which [`interleaved`] returns consecutive pixels.
const PAIRS: [i32; 8] = [0, 2, 4, 6, 1, 3, 5, 7];

/// See [`super::Converter`].
///
/// # Safety
/// The processor must have AVX2, and there must be samples for all pixels.
#[target_feature(enable = "avx2")]
pub(super) unsafe fn convert(factors: &Factors, samples: &Samples, output: &mut [[Pixel; GROUP]]) {
    let constants = Constants::new(factors);
    // SAFETY: the array has eight numbers.
    let order = unsafe { _mm256_loadu_si256(PAIRS.as_ptr().cast()) };
    for (group, pixels) in output.iter_mut().enumerate() {
        // SAFETY: there are samples for this group.
        let (luma, chroma) = unsafe { load(samples, group * GROUP) };
        let [luma, chroma] = [luma, chroma].map(|pairs| _mm256_permutevar8x32_epi32(pairs, order));
        let vectors = interleaved(constants.channels(luma, chroma));
        let to = pixels.as_mut_ptr();
        for (number, vector) in vectors.into_iter().enumerate() {
            // SAFETY: a group has room for four vectors.
            unsafe { _mm256_storeu_si256(to.add(4 * number).cast(), vector) };
        }
    }
}

/// See [`super::Unpacker`].
///
/// # Safety
/// The processor must have AVX2, a pixel must have three or four bytes, and there must be bytes for all pixels.
#[target_feature(enable = "avx2")]
pub(super) unsafe fn unpack(row: &[u8], Packing { step, rgb }: Packing, output: &mut [[Pixel; GROUP]]) {
    // The vector of the last four pixels begins this many bytes before them, so that it ends with the group.
    let early = VECTOR - 4 * step;
    #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "a place in a vector")]
    let [red, green, blue] = rgb.map(|place| place as i32);
    // The place of each channel in the first pixel, and how much further it is in another one. The highest bit gives 0.
    let first = _mm_set1_epi32(red | green << 8 | blue << 16 | i32::MIN);
    #[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "a place in a vector")]
    let further = |bytes: usize| bytes as i32 * 0x01_01_01;
    let order = _mm_add_epi8(first, _mm_setr_epi32(0, further(step), further(2 * step), further(3 * step)));
    let orders = [order, order, order, _mm_add_epi8(order, _mm_set1_epi32(further(early)))];
    let starts = [0, 4 * step, 8 * step, 12 * step - early];
    for (group, pixels) in output.iter_mut().enumerate() {
        for (number, (start, order)) in starts.into_iter().zip(orders).enumerate() {
            // SAFETY: the bytes are those of this group, which has room for four vectors.
            unsafe {
                let bytes = _mm_loadu_si128(row.as_ptr().add(group * GROUP * step + start).cast());
                let four = _mm256_cvtepu8_epi16(_mm_shuffle_epi8(bytes, order));
                _mm256_storeu_si256(pixels.as_mut_ptr().add(4 * number).cast(), four);
            }
        }
    }
}

/// Loads luma of sixteen pixels, and Cb and Cr of every two of them.
///
/// # Safety
/// The processor must have AVX2, and there must be samples for sixteen pixels from number `first` on, which is even.
#[inline]
#[target_feature(enable = "avx2")]
pub(super) unsafe fn load(samples: &Samples, first: usize) -> (__m256i, __m256i) {
    // SAFETY: the caller vouches for 16 pixels: 32 bytes, or 16 of each plane, or 8 where two pixels share a sample.
    unsafe {
        let sixteen = |plane: &[u8]| _mm256_cvtepu8_epi16(_mm_loadu_si128(plane.as_ptr().add(first).cast()));
        match samples {
            Samples::Yuyv(samples) => {
                let both = _mm256_loadu_si256(samples.as_ptr().add(2 * first).cast());
                (_mm256_and_si256(both, _mm256_set1_epi16(0xff)), _mm256_srli_epi16::<8>(both))
            }
            Samples::SemiPlanar(luma, chroma) => (sixteen(luma), sixteen(chroma)),
            Samples::Planar([luma, cb, cr]) => {
                let eight = |plane: &[u8]| _mm_loadl_epi64(plane.as_ptr().add(first / 2).cast());
                (sixteen(luma), _mm256_cvtepu8_epi16(_mm_unpacklo_epi8(eight(cb), eight(cr))))
            }
            Samples::Grey(luma) => (sixteen(luma), _mm256_set1_epi16(i16::from(NO_COLOUR))),
        }
    }
}

/// The same 128 bits twice.
#[inline]
#[target_feature(enable = "avx2")]
fn both_halves(half: __m128i) -> __m256i {
    _mm256_broadcastsi128_si256(half)
}

/// The vectors that are the same for all groups. Factors of Cb and Cr alternate.
pub(super) struct Constants {
    luma: __m256i,
    black: __m256i,
    blue_red: __m256i,
    green: __m256i,
    first_of_pairs: __m256i,
    second_of_pairs: __m256i,
    swapped_pairs: __m256i,
}

impl Constants {
    #[inline]
    #[target_feature(enable = "avx2")]
    pub(super) fn new(factors: &Factors) -> Self {
        let pair = |[cb, cr]: [i16; 2]| _mm256_set1_epi32(i32::from(cr) << 16 | i32::from(cb) & 0xffff);
        Self {
            luma: _mm256_set1_epi16(factors.luma),
            black: _mm256_set1_epi16(factors.black),
            blue_red: pair([factors.blue, factors.red]),
            green: pair(factors.green),
            first_of_pairs: both_halves(_mm_setr_epi8(0, 1, 0, 1, 4, 5, 4, 5, 8, 9, 8, 9, 12, 13, 12, 13)),
            second_of_pairs: both_halves(_mm_setr_epi8(2, 3, 2, 3, 6, 7, 6, 7, 10, 11, 10, 11, 14, 15, 14, 15)),
            swapped_pairs: both_halves(_mm_setr_epi8(2, 3, 0, 1, 6, 7, 4, 5, 10, 11, 8, 9, 14, 15, 12, 13)),
        }
    }

    /// Red, green and blue of sixteen pixels.
    #[inline]
    #[target_feature(enable = "avx2")]
    pub(super) fn channels(&self, luma: __m256i, chroma: __m256i) -> [__m256i; 3] {
        // The upper 16 bits of a product are the product divided by 8 * 8192.
        let luma = _mm256_mulhi_epi16(_mm256_slli_epi16::<3>(_mm256_sub_epi16(luma, self.black)), self.luma);
        let chroma = _mm256_slli_epi16::<3>(_mm256_sub_epi16(chroma, _mm256_set1_epi16(i16::from(NO_COLOUR))));
        let blue_red = _mm256_mulhi_epi16(chroma, self.blue_red);
        let green = _mm256_mulhi_epi16(chroma, self.green);
        let green = _mm256_add_epi16(green, _mm256_shuffle_epi8(green, self.swapped_pairs));
        let red = _mm256_add_epi16(luma, _mm256_shuffle_epi8(blue_red, self.second_of_pairs));
        let blue = _mm256_add_epi16(luma, _mm256_shuffle_epi8(blue_red, self.first_of_pairs));
        [red, _mm256_add_epi16(luma, green), blue]
    }
}

/// Red, green, blue and zero of four pixels in each vector: two from the lower halves of the channels, and two from the
/// upper halves.
#[inline]
#[target_feature(enable = "avx2")]
fn interleaved([red, green, blue]: [__m256i; 3]) -> [__m256i; 4] {
    let unused = _mm256_setzero_si256();
    let [red_green, more_red_green] = [_mm256_unpacklo_epi16(red, green), _mm256_unpackhi_epi16(red, green)];
    let [blue_unused, more_blue_unused] = [_mm256_unpacklo_epi16(blue, unused), _mm256_unpackhi_epi16(blue, unused)];
    [
        _mm256_unpacklo_epi32(red_green, blue_unused),
        _mm256_unpackhi_epi32(red_green, blue_unused),
        _mm256_unpacklo_epi32(more_red_green, more_blue_unused),
        _mm256_unpackhi_epi32(more_red_green, more_blue_unused),
    ]
}
