//! Packets on a serial line: COBS frames, each ended by the only 0 in it.
//!
//! Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999) puts before the bytes, and in place of each 0 among
//! them, the distance to the next of these places. A packet is shorter than the 254 bytes after which COBS needs a
//! further place, so every frame has the same length.

use core::mem;

use crate::{DecodeError, PACKET_BYTES, Packet};

/// Bytes of a packet on a serial line, the 0 at the end included.
pub const FRAME_BYTES: usize = PACKET_BYTES + 2;

impl Packet {
    /// The bytes to send on a serial line. Values are treated as by [`Packet::encode`].
    #[must_use]
    pub fn encode_frame(&self) -> [u8; FRAME_BYTES] {
        let mut frame = [0; FRAME_BYTES];
        let [first, body @ .., _end] = &mut frame;
        let mut distance = 1;
        for (place, byte) in body.iter_mut().zip(self.encode()).rev() {
            *place = if byte == 0 { mem::take(&mut distance) } else { byte };
            distance += 1;
        }
        *first = distance;
        frame
    }
}

/// Finds packets in the bytes of a serial line, whatever pieces they come in.
///
/// After lost bytes, or garbage such as a board's start-up messages, it is in step again with the next 0.
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
    /// Bytes the frame has so far; those beyond a packet are counted, not kept.
    length: usize,
    /// Bytes up to the next place of a 0; `None` before the frame's first byte.
    left: Option<u8>,
}

impl Default for FrameReader {
    fn default() -> Self {
        Self { bytes: [0; PACKET_BYTES], length: 0, left: None }
    }
}

impl FrameReader {
    /// Takes the next byte of the line. The byte that ends a frame gives its packet, or why it holds none; empty frames
    /// give nothing.
    pub fn push(&mut self, byte: u8) -> Option<Result<Packet, DecodeError>> {
        let Some(distance) = byte.checked_sub(1) else {
            return mem::take(self).end();
        };
        self.left = match self.left {
            None => Some(distance),
            Some(0) => {
                self.keep(0);
                Some(distance)
            }
            Some(left) => {
                self.keep(byte);
                Some(left - 1)
            }
        };
        None
    }

    fn keep(&mut self, byte: u8) {
        if let Some(place) = self.bytes.get_mut(self.length) {
            *place = byte;
        }
        self.length = self.length.saturating_add(1);
    }

    /// What the frame holds.
    fn end(self) -> Option<Result<Packet, DecodeError>> {
        match (self.left?, self.length) {
            (0, PACKET_BYTES) => Some(Packet::decode(&self.bytes)),
            (0, length) => Some(Err(DecodeError::Length(length))),
            _ => Some(Err(DecodeError::Cut)),
        }
    }
}
