//! Kernels for x86-64 with AVX-512: 32 registers of 16 values.

use std::arch::x86_64::{
    __m512, _MM_HINT_T0, _mm_prefetch, _mm256_loadu_si256, _mm512_add_ps, _mm512_cvtph_ps, _mm512_fmadd_ps,
    _mm512_loadu_ps, _mm512_max_ps, _mm512_min_ps, _mm512_mul_ps, _mm512_set1_ps, _mm512_setzero_ps, _mm512_storeu_ps,
};

use super::table::kernels;
use super::vector::{InstructionSet, vector_functions};

struct Avx512;

// SAFETY: `kernels::available` hands these kernels out only where AVX-512 was detected.
unsafe impl InstructionSet for Avx512 {
    type Vector = __m512;
    const LANES: usize = 16;
    // Twelve pixels and two vectors of channels take 24 registers for sums.
    const TILE: usize = 12;

    #[inline(always)]
    unsafe fn prefetch(from: *const f32) {
        // SAFETY: a prefetch is a hint that never faults, so any address will do.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(from.cast()) }
    }

    vector_functions! {
        zero: _mm512_setzero_ps, load: _mm512_loadu_ps, half: _mm512_cvtph_ps of _mm256_loadu_si256,
        store: _mm512_storeu_ps, splat: _mm512_set1_ps,
        add: _mm512_add_ps, mul: _mm512_mul_ps, mul_add: _mm512_fmadd_ps, max: _mm512_max_ps, min: _mm512_min_ps,
    }
}

kernels!(Avx512, "avx512", vectors: 2, tail: 1, stem_vectors: 2, dense_vectors: 4, dense_half: true, features: "avx512f");
