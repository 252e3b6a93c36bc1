//! Sums of weighted rows: a dense layer whose weights are stored input by input.
//!
//! The loop is written once, without intrinsics. It is compiled for the instructions that every processor of the target
//! has, and on x86-64 once more for AVX2 and FMA. For 32-bit ARM, whose compiler may not use NEON, it is in assembly.
//!
//! Weights are numbers of single precision, or of 8 bits where there are many of them.

use std::array;

/// Rows that are added at a time, so that each sum is loaded and stored once for all of them.
const BLOCK: usize = 8;

/// Adds each row, multiplied by its factor, to the sums. Rows without a factor and factors without a row are ignored.
///
/// The order of the additions is that of the rows. Where the processor has fused multiply-adds, products are not rounded.
pub fn add_rows<const N: usize>(sums: &mut [f32; N], rows: &[[f32; N]], factors: &[f32]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor has AVX2 and FMA.
        return unsafe { add_rows_avx2(sums, rows, factors) };
    }
    #[cfg(all(target_arch = "arm", target_os = "linux", target_endian = "little"))]
    if N.is_multiple_of(4) && super::armv7::detected() {
        // SAFETY: the processor has VFPv4, and the number of columns is a multiple of four.
        return unsafe { super::armv7::add_rows(sums, rows, factors) };
    }
    add::<N, f32, { cfg!(target_arch = "aarch64") }>(sums, rows, factors);
}

/// Does the same for rows of 8-bit numbers.
pub fn add_byte_rows<const N: usize>(sums: &mut [f32; N], rows: &[[i8; N]], factors: &[f32]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor has AVX2 and FMA.
        return unsafe { add_rows_avx2(sums, rows, factors) };
    }
    #[cfg(all(target_arch = "arm", target_os = "linux", target_endian = "little"))]
    if N.is_multiple_of(8) && super::armv7::detected() {
        // SAFETY: the processor has VFPv4, and the number of columns is a multiple of eight.
        return unsafe { super::armv7::add_byte_rows(sums, rows, factors) };
    }
    add::<N, i8, { cfg!(target_arch = "aarch64") }>(sums, rows, factors);
}

/// Does the same for two rows. The compiler knows their number, so that it keeps the sums in registers.
pub fn add_pair<const N: usize>(sums: &mut [f32; N], rows: &[[f32; N]; 2], factors: [f32; 2]) {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor has AVX2 and FMA.
        return unsafe { add_pair_avx2(sums, rows, factors) };
    }
    if cfg!(target_arch = "arm") {
        return add_rows(sums, rows, &factors);
    }
    add_block::<N, 2, f32, { cfg!(target_arch = "aarch64") }>(sums, rows, &factors);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn add_pair_avx2<const N: usize>(sums: &mut [f32; N], rows: &[[f32; N]; 2], factors: [f32; 2]) {
    add_block::<N, 2, f32, true>(sums, rows, &factors);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn add_rows_avx2<const N: usize, T: Copy + Into<f32>>(sums: &mut [f32; N], rows: &[[T; N]], factors: &[f32]) {
    add::<N, T, true>(sums, rows, factors);
}

#[inline(always)]
fn add<const N: usize, T: Copy + Into<f32>, const FUSED: bool>(sums: &mut [f32; N], rows: &[[T; N]], factors: &[f32]) {
    let count = rows.len().min(factors.len());
    let ((blocks, rows), (factor_blocks, factors)) =
        (rows[..count].as_chunks::<BLOCK>(), factors[..count].as_chunks::<BLOCK>());
    for (rows, factors) in blocks.iter().zip(factor_blocks) {
        add_block::<N, BLOCK, T, FUSED>(sums, rows, factors);
    }
    for (row, factor) in rows.iter().zip(factors) {
        add_block::<N, 1, T, FUSED>(sums, array::from_ref(row), array::from_ref(factor));
    }
}

#[inline(always)]
fn add_block<const N: usize, const ROWS: usize, T: Copy + Into<f32>, const FUSED: bool>(
    sums: &mut [f32; N],
    rows: &[[T; N]; ROWS],
    factors: &[f32; ROWS],
) {
    for (column, sum) in sums.iter_mut().enumerate() {
        for (row, factor) in rows.iter().zip(factors) {
            let weight: f32 = row[column].into();
            // On a processor without the instruction, `f32::mul_add` is a slow function.
            *sum = if FUSED { weight.mul_add(*factor, *sum) } else { *sum + weight * factor };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{add, add_byte_rows, add_pair, add_rows};
    use crate::testing::{Random, assert_close};

    type Kernel<const N: usize, T> = fn(&mut [f32; N], &[[T; N]], &[f32]);

    /// Compares the sums of `count` rows with those of double precision.
    #[expect(clippy::cast_possible_truncation, reason = "a sum is rounded once")]
    fn assert_sums<const N: usize, T: Copy + Into<f32>>(count: usize, kernels: &[Kernel<N, T>], weight: fn(f32) -> T) {
        let mut random = Random::new(11);
        let mut row = || -> [f32; N] { random.values(N).try_into().unwrap() };
        let rows: Vec<[T; N]> = (0..count).map(|_| row().map(weight)).collect();
        let (factors, start) = (random.values(count), random.values(N));
        let wanted: Vec<f32> = (start.iter().enumerate())
            .map(|(column, start)| {
                let product = |(row, factor): (&[T; N], &f32)| f64::from(row[column].into()) * f64::from(*factor);
                (f64::from(*start) + rows.iter().zip(&factors).map(product).sum::<f64>()) as f32
            })
            .collect();
        for kernel in kernels {
            let mut sums: [f32; N] = start.clone().try_into().unwrap();
            kernel(&mut sums, &rows, &factors);
            let largest: f32 = wanted.iter().fold(1.0, |largest: f32, sum| largest.max(sum.abs()));
            let [sums, wanted] =
                [&sums[..], &wanted].map(|sums| sums.iter().map(|sum| sum / largest).collect::<Vec<_>>());
            assert_close(&sums, &wanted, &format!("{count} rows"));
        }
    }

    #[test]
    fn sums_of_rows_agree_with_sums_in_double_precision() {
        for count in [0, 1, 7, 8, 9, 64, 458] {
            assert_sums(count, &[add_rows::<1>, add::<1, f32, false>], |value| value);
            assert_sums(count, &[add_rows::<52>, add::<52, f32, false>], |value| value);
            assert_sums(count, &[add_rows::<120>, add::<120, f32, false>], |value| value);
        }
    }

    #[test]
    #[expect(clippy::cast_possible_truncation, reason = "from -127 to 127")]
    fn sums_of_rows_of_bytes_agree_with_sums_in_double_precision() {
        let weight = |value: f32| (value * 127.0) as i8;
        for count in [0, 1, 7, 8, 9, 64, 5760] {
            assert_sums(count, &[add_byte_rows::<1>, add::<1, i8, false>], weight);
            assert_sums(count, &[add_byte_rows::<32>, add::<32, i8, false>], weight);
        }
    }

    #[test]
    fn a_pair_of_rows_adds_what_two_rows_add() {
        let mut random = Random::new(12);
        let rows: [[f32; 32]; 2] = [(); 2].map(|()| random.values(32).try_into().unwrap());
        let (mut pair, mut two) = ([0.5; 32], [0.5; 32]);
        add_pair(&mut pair, &rows, [0.3, -0.7]);
        add_rows(&mut two, &rows, &[0.3, -0.7]);
        assert_eq!(pair.map(f32::to_bits), two.map(f32::to_bits));
    }

    #[test]
    fn rows_without_a_factor_and_factors_without_a_row_are_ignored() {
        let mut sums = [1.0];
        add_rows(&mut sums, &[[2.0], [3.0]], &[10.0]);
        add_rows(&mut sums, &[[0.5]], &[10.0, f32::NAN]);
        assert_close(&sums, &[26.0], "a row and a factor too many");
    }
}
