//! Sixteen samples at a time with AVX-512.

use std::arch::x86_64::{
    __m512, __m512i, _mm_loadu_si128, _mm512_add_epi16, _mm512_add_epi32, _mm512_and_si512, _mm512_broadcast_i32x4,
    _mm512_castsi128_si512, _mm512_cvtepi32_ps, _mm512_inserti32x4, _mm512_loadu_si512, _mm512_madd_epi16,
    _mm512_mask_blend_ps, _mm512_max_epi32, _mm512_min_epi32, _mm512_mul_ps, _mm512_mullo_epi16, _mm512_mullo_epi32,
    _mm512_or_si512, _mm512_permutex2var_ps, _mm512_set1_epi32, _mm512_set1_ps, _mm512_setzero_si512,
    _mm512_shuffle_epi8, _mm512_shuffle_epi32, _mm512_slli_epi16, _mm512_slli_epi32, _mm512_srai_epi32,
    _mm512_srli_epi32, _mm512_storeu_ps, _mm512_storeu_si512, _mm512_sub_epi16, _mm512_sub_epi32,
};

use super::{Line, Pixel, WHITE, plain};

/// Samples of a group.
const GROUP: usize = 16;

/// For each value of the thirds of a group, its place in the vector that [`group_of`] returns it in. Places in vectors 1
/// and 3 are counted from 16.
const PLACES: [[i32; 16]; 3] = places().0;
/// For each third of a group, a mask of the values that are in vectors 2 and 3.
const IN_UPPER_VECTORS: [u16; 3] = places().1;

const fn places() -> ([[i32; 16]; 3], [u16; 3]) {
    let (mut places, mut masks) = ([[0; 16]; 3], [0; 3]);
    let mut value = 0;
    while value < 3 * GROUP {
        let (sample, channel) = (value / 3, value % 3);
        let (part, vector) = (sample / 4, sample % 4);
        places[value / 16][value % 16] = (4 * part + channel + 16 * (vector % 2)) as i32;
        masks[value / 16] |= ((vector / 2) as u16) << (value % 16);
        value += 1;
    }
    (places, masks)
}

/// See [`super::Sampler`].
///
/// # Safety
/// The processor must have AVX-512 F and BW, and the line must be inside its pixels.
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) unsafe fn sample(line: &Line, output: &mut [f32]) {
    let (groups, _) = output.as_chunks_mut::<{ 3 * GROUP }>();
    let grouped = groups.len() * GROUP;
    let (mut x, mut y) = (positions(line.start[0], line.step[0]), positions(line.start[1], line.step[1]));
    let step_x = _mm512_set1_epi32(line.step[0].wrapping_mul(GROUP as i32));
    let step_y = _mm512_set1_epi32(line.step[1].wrapping_mul(GROUP as i32));
    for group in groups {
        // SAFETY: the samples are inside the pixels, a table has 16 numbers, and a third of a group 16 values.
        unsafe {
            let values = group_of(line, x, y);
            for (third, places) in PLACES.iter().enumerate() {
                let places = _mm512_loadu_si512(places.as_ptr().cast());
                let lower = _mm512_permutex2var_ps(values[0], places, values[1]);
                let upper = _mm512_permutex2var_ps(values[2], places, values[3]);
                let values = _mm512_mask_blend_ps(IN_UPPER_VECTORS[third], lower, upper);
                _mm512_storeu_ps(group.as_mut_ptr().add(16 * third), values);
            }
        }
        x = _mm512_add_epi32(x, step_x);
        y = _mm512_add_epi32(y, step_y);
    }
    if output.len() > 3 * grouped {
        plain(line, grouped, &mut output[3 * grouped..]);
    }
}

/// The positions of the first sixteen samples along one axis.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn positions(start: i32, step: i32) -> __m512i {
    let numbers = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];
    // SAFETY: the array has 16 numbers.
    let numbers = unsafe { _mm512_loadu_si512(numbers.as_ptr().cast::<i32>().cast()) };
    _mm512_add_epi32(_mm512_mullo_epi32(numbers, _mm512_set1_epi32(step)), _mm512_set1_epi32(start))
}

/// The fractional part of each position, in 1/32.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
fn fractions(positions: __m512i) -> __m512i {
    _mm512_and_si512(_mm512_srli_epi32::<11>(positions), _mm512_set1_epi32(31))
}

/// Sixteen samples. Vector `n` holds sample `4 p + n` in its part `p` of four values, the last of which is not used.
///
/// # Safety
/// The processor must have AVX-512 F and BW, and the samples must be inside the pixels.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
unsafe fn group_of(line: &Line, x: __m512i, y: __m512i) -> [__m512; 4] {
    let (right, down) = (fractions(x), fractions(y));
    // Pairs of 16-bit numbers: the weights of the left and the right pixel, and the weight of the lower row in both places.
    let left = _mm512_sub_epi32(_mm512_set1_epi32(32), right);
    let across = _mm512_or_si512(left, _mm512_slli_epi32::<16>(right));
    let down = _mm512_or_si512(down, _mm512_slli_epi32::<16>(down));
    let row = _mm512_mullo_epi32(_mm512_srai_epi32::<16>(y), _mm512_set1_epi32(line.stride as i32));
    let mut offsets = [0_u32; GROUP];
    let offset = _mm512_add_epi32(row, _mm512_srai_epi32::<16>(x));
    // SAFETY: the array has room for 16 numbers.
    unsafe { _mm512_storeu_si512(offsets.as_mut_ptr().cast(), offset) };
    macro_rules! samples {
        ($number:literal, $lane:literal) => {{
            let (across, down) = (_mm512_shuffle_epi32::<$lane>(across), _mm512_shuffle_epi32::<$lane>(down));
            let offsets = [offsets[$number], offsets[$number + 4], offsets[$number + 8], offsets[$number + 12]];
            // SAFETY: the samples are inside the pixels.
            unsafe { mixed(line, offsets, across, down) }
        }};
    }
    [samples!(0, 0x00), samples!(1, 0x55), samples!(2, 0xaa), samples!(3, 0xff)]
}

/// Four samples, given the offsets of their top left pixels and their weights.
///
/// # Safety
/// The processor must have AVX-512 F and BW, and the samples must be inside the pixels.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
unsafe fn mixed(line: &Line, offsets: [u32; 4], across: __m512i, down: __m512i) -> __m512 {
    // The order of channels in which those of the left pixel are beside those of the right one.
    const ORDER: [u8; 16] = [0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15];
    // SAFETY: the array has 16 bytes. The pixels at the offsets, to the right of them and below them are inside.
    let (order, top, bottom) = unsafe {
        let top_row = line.pixels.as_ptr();
        let order = _mm512_broadcast_i32x4(_mm_loadu_si128(ORDER.as_ptr().cast()));
        (order, pixels(top_row, offsets), pixels(top_row.add(line.stride), offsets))
    };
    let lowered = _mm512_mullo_epi16(_mm512_sub_epi16(bottom, top), down);
    let columns = _mm512_add_epi16(_mm512_slli_epi16::<5>(top), lowered);
    let levels = _mm512_madd_epi16(_mm512_shuffle_epi8(columns, order), across);
    let levels = _mm512_min_epi32(_mm512_max_epi32(levels, _mm512_setzero_si512()), _mm512_set1_epi32(WHITE));
    _mm512_mul_ps(_mm512_cvtepi32_ps(levels), _mm512_set1_ps(line.scale))
}

/// The pixels at four offsets, each with the pixel to the right of it.
///
/// # Safety
/// The processor must have AVX-512 F and BW, and the pixels must exist.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
unsafe fn pixels(row: *const Pixel, offsets: [u32; 4]) -> __m512i {
    // SAFETY: the caller vouches for the pixels.
    unsafe {
        let first = _mm512_castsi128_si512(_mm_loadu_si128(row.add(offsets[0] as usize).cast()));
        let second = _mm_loadu_si128(row.add(offsets[1] as usize).cast());
        let third = _mm_loadu_si128(row.add(offsets[2] as usize).cast());
        let fourth = _mm_loadu_si128(row.add(offsets[3] as usize).cast());
        let halves = _mm512_inserti32x4::<1>(first, second);
        _mm512_inserti32x4::<3>(_mm512_inserti32x4::<2>(halves, third), fourth)
    }
}
