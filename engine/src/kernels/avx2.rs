//! Kernels for x86-64 with AVX2, FMA and F16C: 16 registers of 8 values.

use std::arch::x86_64::{
    __m256, _mm_loadu_si128, _mm256_add_ps, _mm256_cvtph_ps, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_max_ps,
    _mm256_min_ps, _mm256_mul_ps, _mm256_set1_ps, _mm256_setzero_ps, _mm256_storeu_ps,
};

use super::table::kernels;
use super::vector::{InstructionSet, vector_functions};

struct Avx2;

// SAFETY: `kernels::available` hands these kernels out only where AVX2, FMA and F16C were detected.
unsafe impl InstructionSet for Avx2 {
    type Vector = __m256;
    const LANES: usize = 8;
    // Six pixels and two vectors of channels take 12 registers for sums.
    const TILE: usize = 6;

    vector_functions! {
        zero: _mm256_setzero_ps, load: _mm256_loadu_ps, half: _mm256_cvtph_ps of _mm_loadu_si128,
        store: _mm256_storeu_ps, splat: _mm256_set1_ps,
        add: _mm256_add_ps, mul: _mm256_mul_ps, mul_add: _mm256_fmadd_ps, max: _mm256_max_ps, min: _mm256_min_ps,
    }
}

kernels!(Avx2, "avx2", vectors: 2, tail: 1, stem_vectors: 2, dense_vectors: 4, dense_half: true, features: "avx2,fma,f16c");
