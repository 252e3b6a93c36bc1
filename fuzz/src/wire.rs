//! The packet's wire format, written a second time: what the library is compared with.

use facewire_packet::PACKET_BYTES;

/// A packet's bytes.
pub type Wire = [u8; PACKET_BYTES];

const CHECKSUM_AT: usize = PACKET_BYTES - 2;

/// CRC-16/MCRF4XX over what stands before the checksum.
pub fn checksum(wire: &Wire) -> u16 {
    let step = |crc: u16| if crc & 1 == 1 { crc >> 1 ^ 0x8408 } else { crc >> 1 };
    wire[..CHECKSUM_AT].iter().fold(0xffff, |crc, byte| (0..8).fold(crc ^ u16::from(*byte), |crc, _| step(crc)))
}

/// The checksum that the bytes state.
pub fn stated_checksum(wire: &Wire) -> u16 {
    u16::from_le_bytes([wire[CHECKSUM_AT], wire[CHECKSUM_AT + 1]])
}

/// The first bytes of `data`, filled up with 0, made a packet of version 1 with the right checksum. Only its reason may
/// be one that version 1 does not define.
pub fn sealed(data: &[u8]) -> Wire {
    let mut wire = [0; PACKET_BYTES];
    let used = data.len().min(PACKET_BYTES);
    wire[..used].copy_from_slice(&data[..used]);
    wire[..3].copy_from_slice(b"FW\x01");
    seal(wire)
}

/// The packet with the right checksum.
pub fn seal(mut wire: Wire) -> Wire {
    let checksum = checksum(&wire);
    wire[CHECKSUM_AT..].copy_from_slice(&checksum.to_le_bytes());
    wire
}
