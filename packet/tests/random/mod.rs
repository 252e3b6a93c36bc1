//! Random packets and times for the tests that compare two receivers.
#![allow(dead_code, clippy::unwrap_used, clippy::indexing_slicing, reason = "each test uses some of it")]

use facewire_packet::{LATE_MS, Packet, SILENCE_MS, State, Visibility};

/// Pseudo-random numbers (Marsaglia's xorshift).
pub struct Random(pub u32);

impl Random {
    pub fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    pub fn below(&mut self, limit: u32) -> u32 {
        (self.next() >> 8) % limit
    }

    /// A time or a distance of sequence numbers: mostly small, sometimes at a limit of the rule, rarely anything.
    pub fn step(&mut self, usual: u32) -> u32 {
        match self.below(40) {
            0 => [LATE_MS - 1, LATE_MS, SILENCE_MS - 1, SILENCE_MS][self.below(4) as usize],
            1 => self.below(2000),
            2 => 0u32.wrapping_sub(self.below(20)),
            3 if self.below(20) == 0 => self.next(),
            _ => self.below(usual),
        }
    }

    /// A packet with random values. Its rotation can be any four numbers.
    pub fn packet(&mut self, sequence: u16) -> Packet {
        let mut packet = Packet { state: State::Live, sequence, ..Packet::NEUTRAL };
        packet.rotation = [(); 4].map(|()| self.below(65535) as f32 / 32767.0 - 1.0);
        packet.coefficients = [(); 52].map(|()| self.below(65536) as f32 / 65535.0);
        if self.below(2) == 0 {
            packet.visibility = Visibility::from_values([(); 6].map(|()| self.below(16) as f32 / 15.0));
        }
        Packet::decode(&packet.encode()).unwrap()
    }
}
