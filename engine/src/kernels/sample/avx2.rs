//! Eight samples at a time with AVX2.

use std::arch::x86_64::{
    __m256, __m256i, _mm_castps_pd, _mm_loadu_si128, _mm_movehl_ps, _mm_store_ss, _mm_storel_pd, _mm_storeu_ps,
    _mm256_add_epi16, _mm256_add_epi32, _mm256_and_si256, _mm256_castps256_ps128, _mm256_castsi128_si256,
    _mm256_cvtepi32_ps, _mm256_extractf128_ps, _mm256_inserti128_si256, _mm256_madd_epi16, _mm256_max_epi32,
    _mm256_min_epi32, _mm256_mul_ps, _mm256_mullo_epi16, _mm256_mullo_epi32, _mm256_or_si256, _mm256_set1_epi32,
    _mm256_set1_ps, _mm256_setr_epi8, _mm256_setr_epi32, _mm256_setzero_si256, _mm256_shuffle_epi8,
    _mm256_shuffle_epi32, _mm256_slli_epi16, _mm256_slli_epi32, _mm256_srai_epi32, _mm256_srli_epi32,
    _mm256_storeu_si256, _mm256_sub_epi16, _mm256_sub_epi32,
};

use super::{Line, Pixel, WHITE, plain};

/// Samples of a group.
const GROUP: usize = 8;

/// See [`super::Sampler`].
///
/// # Safety
/// The processor must have AVX2, and the line must be inside its pixels.
#[target_feature(enable = "avx2")]
pub(super) unsafe fn sample(line: &Line, output: &mut [f32]) {
    let groups = output.len() / 3 / GROUP;
    let (grouped, rest) = output.split_at_mut(groups * 3 * GROUP);
    let to = grouped.as_mut_ptr();
    let (mut x, mut y) = (positions(line.start[0], line.step[0]), positions(line.start[1], line.step[1]));
    let group_step = |step: i32| step.wrapping_mul(GROUP as i32);
    let (step_x, step_y) = (_mm256_set1_epi32(group_step(line.step[0])), _mm256_set1_epi32(group_step(line.step[1])));
    for group in 0..groups {
        // SAFETY: the samples are inside the pixels. A store also writes one value after its sample, which the store of the
        // next sample overwrites. No value follows the last sample, which is why it is stored in parts.
        unsafe {
            let values = group_of(line, x, y);
            let to = to.add(group * 3 * GROUP);
            for (number, values) in values.iter().enumerate() {
                _mm_storeu_ps(to.add(3 * number), _mm256_castps256_ps128(*values));
            }
            for (number, values) in values.iter().enumerate().take(3) {
                _mm_storeu_ps(to.add(12 + 3 * number), _mm256_extractf128_ps::<1>(*values));
            }
            let eighth = _mm256_extractf128_ps::<1>(values[3]);
            if group + 1 < groups {
                _mm_storeu_ps(to.add(21), eighth);
            } else {
                _mm_storel_pd(to.add(21).cast(), _mm_castps_pd(eighth));
                _mm_store_ss(to.add(23), _mm_movehl_ps(eighth, eighth));
            }
        }
        x = _mm256_add_epi32(x, step_x);
        y = _mm256_add_epi32(y, step_y);
    }
    if !rest.is_empty() {
        plain(line, groups * GROUP, rest);
    }
}

/// The positions of the first eight samples along one axis.
#[inline]
#[target_feature(enable = "avx2")]
fn positions(start: i32, step: i32) -> __m256i {
    let numbers = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
    _mm256_add_epi32(_mm256_mullo_epi32(numbers, _mm256_set1_epi32(step)), _mm256_set1_epi32(start))
}

/// The fractional part of each position, in 1/32.
#[inline]
#[target_feature(enable = "avx2")]
fn fractions(positions: __m256i) -> __m256i {
    _mm256_and_si256(_mm256_srli_epi32::<11>(positions), _mm256_set1_epi32(31))
}

/// Eight samples. Vector `n` holds sample `n` in its lower half, and sample `n + 4` in its upper half.
///
/// # Safety
/// The processor must have AVX2, and the samples must be inside the pixels.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn group_of(line: &Line, x: __m256i, y: __m256i) -> [__m256; 4] {
    let (right, down) = (fractions(x), fractions(y));
    // Pairs of 16-bit numbers: the weights of the left and the right pixel, and the weight of the lower row in both places.
    let left = _mm256_sub_epi32(_mm256_set1_epi32(32), right);
    let across = _mm256_or_si256(left, _mm256_slli_epi32::<16>(right));
    let down = _mm256_or_si256(down, _mm256_slli_epi32::<16>(down));
    let row = _mm256_mullo_epi32(_mm256_srai_epi32::<16>(y), _mm256_set1_epi32(line.stride as i32));
    let mut offsets = [0_u32; GROUP];
    let offset = _mm256_add_epi32(row, _mm256_srai_epi32::<16>(x));
    // SAFETY: the array has room for eight numbers.
    unsafe { _mm256_storeu_si256(offsets.as_mut_ptr().cast(), offset) };
    macro_rules! pair {
        ($number:literal, $lane:literal) => {{
            let (across, down) = (_mm256_shuffle_epi32::<$lane>(across), _mm256_shuffle_epi32::<$lane>(down));
            // SAFETY: the samples are inside the pixels.
            unsafe { mixed(line, [offsets[$number], offsets[$number + 4]], across, down) }
        }};
    }
    [pair!(0, 0x00), pair!(1, 0x55), pair!(2, 0xaa), pair!(3, 0xff)]
}

/// Two samples, given the offsets of their top left pixels and their weights.
///
/// # Safety
/// The processor must have AVX2, and the samples must be inside the pixels.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn mixed(line: &Line, offsets: [u32; 2], across: __m256i, down: __m256i) -> __m256 {
    // The order of channels in which those of the left pixel are beside those of the right one.
    let order = _mm256_setr_epi8(
        0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15, 0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15,
    );
    // SAFETY: the pixels at the offsets, to the right of them and below them are inside.
    let (top, bottom) = unsafe {
        let first = line.pixels.as_ptr().add(offsets[0] as usize);
        let second = line.pixels.as_ptr().add(offsets[1] as usize);
        (two_pixels(first, second), two_pixels(first.add(line.stride), second.add(line.stride)))
    };
    let lowered = _mm256_mullo_epi16(_mm256_sub_epi16(bottom, top), down);
    let columns = _mm256_add_epi16(_mm256_slli_epi16::<5>(top), lowered);
    let levels = _mm256_madd_epi16(_mm256_shuffle_epi8(columns, order), across);
    let levels = _mm256_min_epi32(_mm256_max_epi32(levels, _mm256_setzero_si256()), _mm256_set1_epi32(WHITE));
    _mm256_mul_ps(_mm256_cvtepi32_ps(levels), _mm256_set1_ps(line.scale))
}

/// The pixels at two places, each with the pixel to the right of it.
///
/// # Safety
/// The processor must have AVX2, and the pointers must be valid for two pixels.
#[inline]
#[target_feature(enable = "avx2")]
unsafe fn two_pixels(first: *const Pixel, second: *const Pixel) -> __m256i {
    // SAFETY: the caller vouches for the pointers.
    unsafe {
        let first = _mm256_castsi128_si256(_mm_loadu_si128(first.cast()));
        _mm256_inserti128_si256::<1>(first, _mm_loadu_si128(second.cast()))
    }
}
