//! The wire layout: one constant per field, little-endian, without gaps.

/// The length of a packet in bytes.
pub const PACKET_BYTES: usize = 132;

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

/// A field of `N` bytes at a fixed offset of the packet.
pub struct Field<const N: usize> {
    at: usize,
}

impl<const N: usize> Field<N> {
    /// Returns the offset of the byte after the field.
    pub const fn end(&self) -> usize {
        self.at + N
    }

    /// Returns the field's bytes. The assertions below prove at compile time that the field lies within the packet, so
    /// the fallback is never used.
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

/// Every field begins where the previous field ends, and the last field ends the packet.
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
