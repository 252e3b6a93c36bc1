//! What other programs read in place of packets: each format turns a [`Packet`](crate::Packet) into messages.
//!
//! Contract: a format takes its memory when it is made, and then neither allocates nor panics. It calls `send` once for
//! each message. It has no clock, and remembers only what its receivers cannot, such as where an eye looked before its lid
//! was shut.

mod angles;
pub mod dmx;
pub mod ifacialmocap;
mod json_lines;
mod live_link;
mod osc;
mod vmc;
pub mod vrchat;

pub use dmx::Dmx;
pub use ifacialmocap::IFacialMocap;
pub use json_lines::JsonLines;
pub use live_link::LiveLink;
pub use vmc::Vmc;
pub use vrchat::Vrchat;

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing)]
mod testing {
    use crate::{BLENDSHAPES, Packet, State};

    /// Rotation of a head that turns 30 degrees to the person's left, unit quaternion x, y, z, w.
    pub const LEFT: [f32; 4] = [0.0, 0.258_819, 0.0, 0.965_926];

    pub fn face(look: &[(&str, f32)]) -> Packet {
        let mut packet = Packet { state: State::Live, ..Packet::NEUTRAL };
        for (name, value) in look {
            packet.coefficients[BLENDSHAPES.iter().position(|known| known == name).unwrap()] = *value;
        }
        packet
    }

    /// Returns the messages that a format sends.
    pub fn sent(encode: impl FnOnce(&mut dyn FnMut(&[u8]))) -> Vec<Vec<u8>> {
        let mut messages = Vec::new();
        encode(&mut |bytes| messages.push(bytes.to_vec()));
        messages
    }

    pub fn near(a: &[f32], b: &[f32]) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3)
    }
}
