//! The facewire packet, version 1: as a datagram, and as a frame on a serial line.

use facewire_packet::Packet;

use super::{Format, Output};

/// One packet per message.
#[derive(Debug)]
pub struct Datagrams;

/// One COBS frame per message.
#[derive(Debug)]
pub struct Frames;

impl Format for Datagrams {
    fn encode(&mut self, output: &Output, sequence: u32, send: &mut dyn FnMut(&[u8])) {
        send(&packet(output, sequence).encode());
    }
}

impl Format for Frames {
    fn encode(&mut self, output: &Output, sequence: u32, send: &mut dyn FnMut(&[u8])) {
        send(&packet(output, sequence).encode_frame());
    }

    /// The end of a frame separates the first frame from leftovers on the line.
    fn preamble(&self) -> Vec<u8> {
        vec![0]
    }
}

fn packet(output: &Output, sequence: u32) -> Packet {
    Packet {
        state: output.state,
        reason: output.reason,
        neutral_face: output.pose.neutral_face,
        sequence: sequence as u16,
        age_us: u32::try_from(output.age_us).unwrap_or(u32::MAX),
        capture_us: output.capture_us as u32,
        rotation: output.pose.rotation,
        position_mm: output.pose.position_mm,
        coefficients: output.pose.coefficients,
    }
}

#[cfg(test)]
mod tests {
    use facewire_packet::{FrameReader, NeutralFace, Reason, State};

    use super::*;
    use crate::link::{Pose, test_output};

    #[test]
    fn datagrams_and_frames_carry_every_field_of_the_output() {
        let neutral_face = NeutralFace::Estimated;
        let (rotation, position_mm) = ([0.0, 0.6, 0.0, 0.8], [1.0, -2.0, 600.0]);
        let mut pose = Pose { rotation, position_mm, neutral_face, ..Pose::NEUTRAL };
        pose.coefficients[17] = 1.0;
        let (state, reason) = (State::Hold, Reason::NoFace);
        let output = Output { reason, pose, age_us: 200, capture_us: (7 << 32) + 5, ..test_output(state) };
        let (mut datagram, mut line) = (Vec::new(), Frames.preamble());
        Datagrams.encode(&output, 65_537, &mut |message| datagram.extend_from_slice(message));
        Frames.encode(&output, 65_537, &mut |message| line.extend_from_slice(message));
        let packet = Packet::decode(&datagram).unwrap();
        assert_eq!((packet.state, packet.reason, packet.sequence), (state, reason, 1));
        assert_eq!((packet.age_us, packet.capture_us, packet.neutral_face), (200, 5, neutral_face));
        assert_eq!((packet.position_mm, packet.coefficients), (pose.position_mm, pose.coefficients));
        assert!(packet.rotation.iter().zip(pose.rotation).all(|(got, want)| (got - want).abs() < 1e-4));
        let mut reader = FrameReader::default();
        let framed: Vec<Packet> = line.iter().filter_map(|byte| reader.push(*byte)?.ok()).collect();
        assert_eq!(framed, [packet]);
    }
}
