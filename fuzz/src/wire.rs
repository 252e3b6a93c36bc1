//! A second implementation of the packet's wire format, with which the library is compared.

use facewire_packet::PACKET_BYTES;

/// The bytes of a packet.
pub type Wire = [u8; PACKET_BYTES];

const CHECKSUM_AT: usize = PACKET_BYTES - 2;

/// Computes the CRC-16/MCRF4XX of the bytes before the checksum.
pub fn checksum(wire: &Wire) -> u16 {
    let step = |crc: u16| if crc & 1 == 1 { crc >> 1 ^ 0x8408 } else { crc >> 1 };
    wire[..CHECKSUM_AT].iter().fold(0xffff, |crc, byte| (0..8).fold(crc ^ u16::from(*byte), |crc, _| step(crc)))
}

/// Returns the checksum that a packet contains.
pub fn stated_checksum(wire: &Wire) -> u16 {
    u16::from_le_bytes([wire[CHECKSUM_AT], wire[CHECKSUM_AT + 1]])
}

/// Makes a packet of version 1 with a correct checksum from the first bytes of `data`, padded with 0. It decodes unless
/// version 1 does not define its reason.
pub fn sealed(data: &[u8]) -> Wire {
    let mut wire = [0; PACKET_BYTES];
    let used = data.len().min(PACKET_BYTES);
    wire[..used].copy_from_slice(&data[..used]);
    wire[..3].copy_from_slice(b"FW\x01");
    seal(wire)
}

/// Returns the packet with a correct checksum.
pub fn seal(mut wire: Wire) -> Wire {
    let checksum = checksum(&wire);
    wire[CHECKSUM_AT..].copy_from_slice(&checksum.to_le_bytes());
    wire
}
