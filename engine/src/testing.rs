//! Helpers that several tests use.

use crate::kernels::Kernels;

/// A small generator of pseudo-random numbers (xorshift).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    /// A number below `limit`.
    pub(crate) fn below(&mut self, limit: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        usize::try_from(self.0 >> 33).unwrap() % limit
    }

    /// Values from -1 to 1.
    pub(crate) fn values(&mut self, count: usize) -> Vec<f32> {
        (0..count).map(|_| self.below(1 << 20) as f32 / (1 << 19) as f32 - 1.0).collect()
    }
}

/// The largest accepted difference between a result of the kernels and a plain sum, as a share of the sum, or of 1 if the
/// sum is smaller. It allows several roundings in the precision of the kernels; numbers of half precision have 11 bits.
pub(crate) fn tolerance(kernels: &Kernels) -> f32 {
    if kernels.half { 3e-2 } else { SINGLE_TOLERANCE }
}

const SINGLE_TOLERANCE: f32 = 2e-5;

/// Asserts that two results differ by rounding only.
pub(crate) fn assert_close(found: &[f32], expected: &[f32], what: &str) {
    assert_within(SINGLE_TOLERANCE, found, expected, what);
}

/// Asserts that two results differ by no more than a [`tolerance`].
pub(crate) fn assert_within(tolerance: f32, found: &[f32], expected: &[f32], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
        let tolerance = tolerance * expected.abs().max(1.0);
        assert!((found - expected).abs() <= tolerance, "{what}: value {at} is {found}, expected {expected}");
    }
}
