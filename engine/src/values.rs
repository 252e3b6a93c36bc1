//! The numbers of an operator, as a network's file has them.

use std::borrow::Cow;

/// Numbers of half or single precision in the bytes of a file. Each is converted when it is read, so that a network can be
/// loaded without a second copy of its numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Values<'a> {
    bytes: Cow<'a, [u8]>,
    /// Bytes of a number: 2 or 4.
    size: usize,
}

impl<'a> Values<'a> {
    /// Numbers of half precision, little-endian.
    pub(crate) fn half(bytes: &'a [u8]) -> Self {
        Self { bytes: bytes.into(), size: 2 }
    }

    /// Numbers of single precision, little-endian.
    pub(crate) fn single(bytes: &'a [u8]) -> Self {
        Self { bytes: bytes.into(), size: 4 }
    }

    pub(crate) fn is_half(&self) -> bool {
        self.size == 2
    }

    pub(crate) fn len(&self) -> usize {
        self.bytes.len() / self.size
    }

    /// The number at an index, which is below [`len`](Self::len).
    #[inline]
    pub(crate) fn at(&self, index: usize) -> f32 {
        match self.bytes[self.size * index..][..self.size] {
            [low, high] => from_half(u16::from_le_bytes([low, high])),
            [a, b, c, d] => f32::from_le_bytes([a, b, c, d]),
            _ => f32::NAN,
        }
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = f32> {
        (0..self.len()).map(|index| self.at(index))
    }
}

impl From<Vec<f32>> for Values<'_> {
    fn from(values: Vec<f32>) -> Self {
        Self { bytes: values.iter().flat_map(|value| value.to_le_bytes()).collect(), size: 4 }
    }
}

/// The value of an IEEE 754 binary16 number.
pub(crate) fn from_half(bits: u16) -> f32 {
    let sign = u32::from(bits & 0x8000) << 16;
    let (exponent, fraction) = (u32::from(bits >> 10) & 0x1f, u32::from(bits & 0x3ff));
    let magnitude = match exponent {
        // Zero and subnormal numbers: multiples of 2^-24, which an f32 holds exactly.
        0 => (fraction as f32 * 2.0_f32.powi(-24)).to_bits(),
        31 => 0x7f80_0000 | fraction << 13,
        _ => (exponent + 127 - 15) << 23 | fraction << 13,
    };
    f32::from_bits(sign | magnitude)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_precision_numbers_keep_their_value() {
        let numbers: [(u16, f32); 8] = [
            (0x0000, 0.0),
            (0x3c00, 1.0),
            (0xc000, -2.0),
            (0x7bff, 65504.0),
            (0x0400, 6.103_515_6e-5),
            (0x0001, 5.960_464_5e-8),
            (0x83ff, -6.097_555e-5),
            (0x3555, 0.333_251_95),
        ];
        for (bits, value) in numbers {
            assert_eq!(from_half(bits).to_bits(), value.to_bits(), "{bits:#x}");
        }
        assert!(from_half(0x7c00).is_infinite() && from_half(0x7e00).is_nan());
        let bytes: Vec<u8> = numbers.iter().flat_map(|(bits, _)| bits.to_le_bytes()).collect();
        assert!(Values::half(&bytes).iter().eq(Values::from(numbers.map(|(_, value)| value).to_vec()).iter()));
    }
}
