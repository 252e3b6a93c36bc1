//! Packets on a serial line: COBS frames that each end with a zero byte, the only zero in the frame.
//!
//! Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999) splits the data at its zero bytes into blocks. It puts a
//! byte before the first block and in place of each zero, and writes to it the distance to the end of the next block. A
//! packet is shorter than 254 bytes, the length at which COBS splits a block even without a zero, so every frame has the
//! same length.

use core::mem;

use crate::{DecodeError, PACKET_BYTES, Packet};

/// The length of an encoded packet on a serial line, including the zero byte at the end.
pub const FRAME_BYTES: usize = PACKET_BYTES + 2;

impl Packet {
    /// Encodes the packet for a serial line. Values out of range are treated as in [`Packet::encode`].
    #[must_use]
    pub fn encode_frame(&self) -> [u8; FRAME_BYTES] {
        let mut frame = [0; FRAME_BYTES];
        let [first, body @ .., _end] = &mut frame;
        let mut distance = 1;
        for (slot, byte) in body.iter_mut().zip(self.encode()).rev() {
            *slot = if byte == 0 { mem::take(&mut distance) } else { byte };
            distance += 1;
        }
        *first = distance;
        frame
    }
}

/// Extracts packets from the byte stream of a serial line.
///
/// After lost bytes or garbage, such as the start-up messages of a board, the reader resynchronises at the next zero
/// byte.
///
/// ```
/// use facewire_packet::{FrameReader, Packet};
///
/// let line = [&b"Booting\r\n\0"[..], &Packet::NEUTRAL.encode_frame()].concat();
/// let mut reader = FrameReader::default();
/// let packets: Vec<Packet> = line.iter().filter_map(|byte| reader.push(*byte)?.ok()).collect();
/// assert_eq!(packets, [Packet::decode(&Packet::NEUTRAL.encode())?]);
/// # Ok::<(), facewire_packet::DecodeError>(())
/// ```
#[derive(Debug, Clone)]
pub struct FrameReader {
    bytes: [u8; PACKET_BYTES],
    /// Decoded bytes of the current frame. Bytes beyond the length of a packet are counted, but not stored.
    length: usize,
    /// Remaining bytes of the current COBS block, or `None` before the first byte of a frame.
    left: Option<u8>,
}

impl Default for FrameReader {
    fn default() -> Self {
        Self { bytes: [0; PACKET_BYTES], length: 0, left: None }
    }
}

impl FrameReader {
    /// Processes the next byte of the line.
    ///
    /// Returns a packet or an error if the byte ends a frame, and `None` otherwise. Empty frames are skipped.
    pub fn push(&mut self, byte: u8) -> Option<Result<Packet, DecodeError>> {
        let Some(distance) = byte.checked_sub(1) else {
            return mem::take(self).finish();
        };
        self.left = match self.left {
            None => Some(distance),
            Some(0) => {
                self.store(0);
                Some(distance)
            }
            Some(left) => {
                self.store(byte);
                Some(left - 1)
            }
        };
        None
    }

    fn store(&mut self, byte: u8) {
        if let Some(slot) = self.bytes.get_mut(self.length) {
            *slot = byte;
        }
        self.length = self.length.saturating_add(1);
    }

    /// Decodes the completed frame. Returns `None` if the frame is empty.
    fn finish(self) -> Option<Result<Packet, DecodeError>> {
        match (self.left?, self.length) {
            (0, PACKET_BYTES) => Some(Packet::decode(&self.bytes)),
            (0, length) => Some(Err(DecodeError::Length(length))),
            _ => Some(Err(DecodeError::Cut)),
        }
    }
}
