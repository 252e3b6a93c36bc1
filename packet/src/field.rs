//! The wire layout: one field per line, little-endian, without gaps.

use crate::packet::PACKET_BYTES;

pub const MAGIC: Field<2> = Field { at: 0 };
pub const VERSION: Field<1> = Field { at: 2 };
pub const FLAGS: Field<1> = Field { at: 3 };
pub const SEQUENCE: Field<2> = Field { at: 4 };
pub const AGE: Field<2> = Field { at: 6 };
pub const CAPTURE: Field<4> = Field { at: 8 };
pub const ROTATION: Field<8> = Field { at: 12 };
pub const POSITION: Field<6> = Field { at: 20 };
pub const COEFFICIENTS: Field<104> = Field { at: 26 };
pub const CHECKSUM: Field<2> = Field { at: 130 };

/// `N` bytes at a fixed offset.
pub struct Field<const N: usize> {
    at: usize,
}

impl<const N: usize> Field<N> {
    /// Offset of the byte after the field.
    pub const fn end(&self) -> usize {
        self.at + N
    }

    /// The field's bytes. The table below is checked when compiled, so the fallback is never taken.
    pub fn get(&self, packet: &[u8; PACKET_BYTES]) -> [u8; N] {
        let bytes = packet.get(self.at..).and_then(<[u8]>::first_chunk);
        bytes.copied().unwrap_or([0; N])
    }

    /// Writes the field's bytes.
    pub fn put(&self, packet: &mut [u8; PACKET_BYTES], value: [u8; N]) {
        if let Some(bytes) = packet.get_mut(self.at..).and_then(<[u8]>::first_chunk_mut) {
            *bytes = value;
        }
    }
}

/// Each field begins where the one before ends, and the last one ends the packet.
const _: () = {
    assert!(MAGIC.at == 0);
    assert!(VERSION.at == MAGIC.end());
    assert!(FLAGS.at == VERSION.end());
    assert!(SEQUENCE.at == FLAGS.end());
    assert!(AGE.at == SEQUENCE.end());
    assert!(CAPTURE.at == AGE.end());
    assert!(ROTATION.at == CAPTURE.end());
    assert!(POSITION.at == ROTATION.end());
    assert!(COEFFICIENTS.at == POSITION.end());
    assert!(CHECKSUM.at == COEFFICIENTS.end());
    assert!(CHECKSUM.end() == PACKET_BYTES);
};
