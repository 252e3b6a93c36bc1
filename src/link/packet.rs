//! The facewire packet, version 1: as a datagram, and as a frame on a serial line.

use facewire_packet::Packet;

use super::{Format, Output};

/// One packet per message.
#[derive(Debug)]
pub struct Datagrams;

/// One COBS frame per message.
#[derive(Debug)]
pub struct Frames;

impl Frames {
    /// The end of a frame. Sent first, it separates the first frame from leftovers on the line.
    pub const PREAMBLE: &[u8] = &[0];
}

impl Format for Datagrams {
    fn encode(&self, output: &Output, sequence: u32, send: &mut dyn FnMut(&[u8])) {
        send(&packet(output, sequence).encode());
    }
}

impl Format for Frames {
    fn encode(&self, output: &Output, sequence: u32, send: &mut dyn FnMut(&[u8])) {
        send(&packet(output, sequence).encode_frame());
    }
}

#[expect(clippy::cast_possible_truncation, reason = "the packet's clock and sequence wrap")]
fn packet(output: &Output, sequence: u32) -> Packet {
    Packet {
        state: output.state,
        reason: output.reason,
        sequence: sequence as u16,
        age_us: u32::try_from(output.age_us).unwrap_or(u32::MAX),
        capture_us: output.capture_us as u32,
        rotation: output.pose.rotation,
        position_mm: output.pose.position_mm,
        coefficients: output.pose.coefficients,
    }
}
