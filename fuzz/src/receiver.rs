//! Compares the receiver's decisions with a clock that never wraps, and watches its movements.

use facewire_packet::{Face, LATE_MS, Packet, Receiver, SILENCE_MS};

use super::input::Input;

/// The longest time that one call moves the face by.
const STEP_MS: u64 = 100;
/// Two steps of the wire format, for rounding.
const ROUNDING: f32 = 2.0 / 65535.0;

/// What the receiver should know.
struct Expected {
    now_ms: u64,
    /// When the newest packet was taken, and its face.
    taken: Option<(u64, Packet)>,
    /// Whether packets have stopped, as of the last call.
    is_silent: bool,
    /// How long the current move has taken.
    moved_ms: u64,
}

/// Lets a receiver see packets and be looked at, at any times of a clock that starts anywhere. It takes a packet exactly if it
/// has to, is silent exactly from 500 ms on, never leaves the range of a face, never moves faster than its travel time
/// allows, and arrives.
pub fn receiver(data: &[u8]) {
    let mut input = Input(data);
    let (start_ms, travel_ms) = (input.word(), input.short().max(1));
    let mut receiver = Receiver::new(travel_ms);
    let mut expected = Expected { now_ms: 0, taken: None, is_silent: true, moved_ms: 0 };
    let mut before = receiver.show(start_ms);
    while !input.0.is_empty() {
        let operation = input.byte();
        let wait_ms = if operation & 1 == 0 { u64::from(operation >> 2) } else { u64::from(input.short()) };
        expected.wait(wait_ms);
        let now_ms = start_ms.wrapping_add(u32::try_from(expected.now_ms & 0xffff_ffff).unwrap());
        let moved = wait_ms.min(STEP_MS) as f32 / f32::from(travel_ms) + ROUNDING;
        let is_packet = operation & 2 == 2;
        let follows = is_packet && !expected.is_silent;
        if is_packet {
            let packet = packet(&mut input);
            assert_eq!(receiver.receive(&packet, now_ms), expected.takes(packet));
        }
        let face = receiver.show(now_ms);
        expected.judge(&face, u64::from(travel_ms));
        if !follows {
            let steps = face.coefficients.iter().zip(before.coefficients).map(|(after, before)| (after - before).abs());
            assert!(steps.fold(0.0, f32::max) <= moved, "{before:?} {face:?}");
        }
        before = face;
    }
}

/// A packet of any values, among them some that no sender sends.
fn packet(input: &mut Input) -> Packet {
    let mut packet = Packet { sequence: input.short(), ..Packet::NEUTRAL };
    packet.rotation = [(); 4].map(|()| f32::from(input.short().cast_signed()) / 32767.0);
    for value in packet.coefficients.iter_mut().step_by(13) {
        *value = f32::from(input.short()) / 65535.0;
    }
    Packet::decode(&packet.encode()).unwrap()
}

impl Expected {
    fn wait(&mut self, ms: u64) {
        self.now_ms += ms;
        self.moved_ms += ms.min(STEP_MS);
        if !self.is_silent && self.age_ms() >= u64::from(SILENCE_MS) {
            (self.is_silent, self.moved_ms) = (true, 0);
        }
    }

    /// The time since the newest packet.
    fn age_ms(&self) -> u64 {
        self.taken.map_or(u64::MAX, |(taken_ms, _)| self.now_ms - taken_ms)
    }

    fn takes(&mut self, packet: Packet) -> bool {
        let ahead = self.taken.map_or(1, |(_, newest)| packet.sequence.wrapping_sub(newest.sequence).cast_signed());
        if !self.is_silent && ahead <= 0 && self.age_ms() < u64::from(LATE_MS) {
            return false;
        }
        if self.is_silent {
            (self.is_silent, self.moved_ms) = (false, 0);
        }
        self.taken = Some((self.now_ms, packet));
        true
    }

    fn judge(&self, face: &Face, travel_ms: u64) {
        assert_eq!(face.is_silent, self.is_silent);
        assert!(face.coefficients.iter().all(|value| (0.0..=1.0).contains(value)));
        assert!(face.rotation.iter().all(|value| (-1.0..=1.0).contains(value)) && face.rotation[3] >= 0.0);
        if self.moved_ms < travel_ms {
            return;
        }
        let target = if self.is_silent { Packet::NEUTRAL } else { self.taken.unwrap().1 };
        assert_eq!(face.coefficients, target.coefficients);
        let sign = if target.rotation[3] < 0.0 { -1.0 } else { 1.0 };
        assert_eq!(face.rotation, target.rotation.map(|component| sign * component));
    }
}
