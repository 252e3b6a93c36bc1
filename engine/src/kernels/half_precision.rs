//! Numbers of half precision (IEEE 754 binary16), two in the place of one `f32`.

/// Rounds two values to half precision and puts them into the bits of one `f32`, the first into the lower bits.
pub(crate) fn pair([low, high]: [f32; 2]) -> f32 {
    f32::from_bits(u32::from(rounded(low)) | u32::from(rounded(high)) << 16)
}

/// Rounds a value to the nearest number of half precision and returns its bits. A value in the middle between two numbers
/// becomes the one with the even mantissa. A value that is too large becomes infinite.
#[expect(clippy::cast_possible_truncation, reason = "a half-precision number has 16 bits")]
fn rounded(value: f32) -> u16 {
    const INFINITY: u32 = 0x7c00;
    /// The smallest normal number, 2^-14.
    const NORMAL: f32 = 1.0 / 16384.0;
    let sign = value.to_bits() >> 16 & 0x8000;
    let magnitude = value.abs();
    if value.is_nan() {
        return (sign | INFINITY | 1) as u16;
    }
    let nearest = if magnitude < NORMAL {
        // From 0.5 to 1, numbers of single precision are as far apart as subnormal numbers of half precision, so that the
        // addition rounds to the latter.
        (magnitude + 0.5).to_bits() - 0.5_f32.to_bits()
    } else {
        // The exponents of both precisions differ by 112, and the mantissas by 13 bits.
        let bits = magnitude.to_bits() - (112 << 23);
        (bits + 0xfff + (bits >> 13 & 1)) >> 13
    };
    (sign | nearest.min(INFINITY)) as u16
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::values::from_half;

    /// The values of pairs, as `f32`.
    pub(crate) fn values(pairs: &[f32]) -> Vec<f32> {
        let bytes = pairs.iter().flat_map(|pair| pair.to_bits().to_le_bytes()).collect::<Vec<_>>();
        bytes.as_chunks().0.iter().map(|half| from_half(u16::from_le_bytes(*half))).collect()
    }

    #[test]
    fn every_number_of_half_precision_keeps_its_bits_and_others_become_the_nearest() {
        for bits in 0..=u16::MAX {
            let value = from_half(bits);
            if value.is_nan() {
                assert!(from_half(rounded(value)).is_nan());
                continue;
            }
            assert_eq!(rounded(value), bits, "{value}");
            let next = from_half(bits.wrapping_add(1));
            if bits & 0x7fff < 0x7bff {
                let even = if bits & 1 == 0 { bits } else { bits + 1 };
                let middle = f32::midpoint(value, next);
                assert_eq!(rounded(middle), even, "{middle}");
                assert_eq!(rounded(middle * 0.9999), bits, "{middle}");
                assert_eq!(rounded(middle * 1.0001), bits + 1, "{middle}");
            }
        }
        assert_eq!([rounded(65519.0), rounded(65520.0), rounded(-1e30)], [0x7bff, 0x7c00, 0xfc00]);
    }
}
