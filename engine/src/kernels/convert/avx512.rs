//! Sixteen pixels at a time with AVX-512.

use std::arch::x86_64::{
    _mm512_castsi256_si512, _mm512_inserti64x4, _mm512_loadu_si512, _mm512_permutex2var_epi16, _mm512_storeu_si512,
    _mm512_zextsi256_si512,
};

use super::avx2::{Constants, load};
use super::{Factors, GROUP, Pixel, Samples};

/// For each value of both halves of a group, its place in the list of first all red, then all green, all blue and all
/// unused values of the group.
const PLACES: [[u16; 32]; 2] = places();

#[expect(clippy::cast_possible_truncation, reason = "64 values")]
const fn places() -> [[u16; 32]; 2] {
    let mut places = [[0; 32]; 2];
    let mut value = 0;
    while value < 4 * GROUP {
        let (pixel, channel) = (value / 4, value % 4);
        places[value / 32][value % 32] = (channel * GROUP + pixel) as u16;
        value += 1;
    }
    places
}

/// See [`super::Converter`].
///
/// # Safety
/// The processor must have AVX2 and AVX-512 F and BW, and there must be samples for all pixels.
#[target_feature(enable = "avx2,avx512f,avx512bw")]
pub(super) unsafe fn convert(factors: &Factors, samples: &Samples, output: &mut [[Pixel; GROUP]]) {
    let constants = Constants::new(factors);
    // SAFETY: each table has 32 numbers.
    let places = PLACES.each_ref().map(|places| unsafe { _mm512_loadu_si512(places.as_ptr().cast()) });
    for (group, pixels) in output.iter_mut().enumerate() {
        // SAFETY: there are samples for this group.
        let (luma, chroma) = unsafe { load(samples, group * GROUP) };
        let [red, green, blue] = constants.channels(luma, chroma);
        let red_green = _mm512_inserti64x4::<1>(_mm512_castsi256_si512(red), green);
        let blue_unused = _mm512_zextsi256_si512(blue);
        for (half, places) in places.into_iter().enumerate() {
            let vector = _mm512_permutex2var_epi16(red_green, places, blue_unused);
            // SAFETY: a group has room for two vectors.
            unsafe { _mm512_storeu_si512(pixels.as_mut_ptr().add(half * GROUP / 2).cast(), vector) };
        }
    }
}
