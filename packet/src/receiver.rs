//! What a receiver shows: the newest packet, and the neutral face when no packet comes.
//!
//! The C header has the same rule in the same integers, so that both show the same face to the last bit.

use crate::{BLENDSHAPE_COUNT, Packet, SILENCE_MS, quantise};

/// A receiver ignores a packet that is not newer than the one it shows, unless that one came this long ago.
pub const LATE_MS: u32 = 250;
/// The usual time in which a receiver moves to neutral. With [`SILENCE_MS`] before it, the face is neutral 1 s after the
/// last packet, as it is 1 s after the last picture with the usual settings of a sender.
pub const TRAVEL_MS: u16 = 500;

/// The longest time by which one call moves the face on, so that the face does not jump after a delay of the program.
const STEP_MS: u32 = 100;
/// The share of a finished move.
const ARRIVED: i32 = 1 << 15;
/// 1.0 in a component of a quaternion.
const ROTATION_ONE: i32 = 32767;

/// Turns the packets of one sender into the face to show.
///
/// The face is that of the newest packet. After [`SILENCE_MS`] without a packet it moves to neutral, within the travel
/// time. When packets come again, and when the first one comes, it moves from where it is to that of the packets within
/// the same time. So it never jumps, and in one millisecond no coefficient goes further than 1 divided by the travel time,
/// in addition to the movement of the face itself.
///
/// A UDP datagram may arrive twice or after a later one. So a packet whose sequence number is not ahead of the newest
/// one's is ignored for [`LATE_MS`]. After this time any packet is taken, because a sender that has restarted counts
/// from 0. If two senders use one port, the face is that of the sender whose sequence is ahead, until it is silent for
/// [`LATE_MS`] or the other one overtakes it: give each sender a port of its own.
///
/// Times are in milliseconds from any moment and may wrap. Call [`Receiver::show`] at least once in 24 days.
///
/// ```
/// use facewire_packet::{Packet, Receiver, State, TRAVEL_MS};
///
/// let mut packet = Packet { state: State::Live, ..Packet::NEUTRAL };
/// packet.coefficients[17] = 1.0; // jawOpen
///
/// let mut receiver = Receiver::new(TRAVEL_MS);
/// for now_ms in (0..=1000).step_by(10) {
///     packet.sequence += 1;
///     receiver.receive(&packet, now_ms);
///     let _face = receiver.show(now_ms);
/// }
/// assert_eq!(receiver.show(1499).coefficients[17], 1.0);
/// let face = receiver.show(1500); // 500 ms after the last packet
/// assert!(face.is_silent);
/// # let moved = (1600..=2000).step_by(100).map(|now_ms| receiver.show(now_ms).coefficients[17]).last();
/// # assert_eq!(moved, Some(0.0));
/// ```
#[derive(Debug, Clone)]
pub struct Receiver {
    travel_ms: u32,
    /// The newest packet that was taken.
    packet: Packet,
    taken_ms: u32,
    is_silent: bool,
    /// The face where the current move began.
    start: Moving,
    /// How long the current move has taken, at most the travel time.
    moved_ms: u32,
    updated_ms: u32,
}

/// What to show.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Face {
    /// Whether no packet came for [`SILENCE_MS`], or none yet.
    pub is_silent: bool,
    /// Head rotation as in [`Packet::rotation`], with w of 0 or more.
    pub rotation: [f32; 4],
    /// The coefficients, from 0 to 1.
    pub coefficients: [f32; BLENDSHAPE_COUNT],
}

/// The moving values in the integers of the wire.
#[derive(Debug, Clone, Copy)]
struct Moving {
    /// x, y and z of a quaternion whose w is 0 or more.
    vector: [i32; 3],
    coefficients: [i32; BLENDSHAPE_COUNT],
}

impl Moving {
    const NEUTRAL: Self = Self { vector: [0; 3], coefficients: [0; BLENDSHAPE_COUNT] };
}

impl Receiver {
    /// Creates a receiver that has got no packet yet and shows the neutral face.
    ///
    /// The face takes `travel_ms` to neutral, and from there to the face of the packets; 0 means [`TRAVEL_MS`].
    #[must_use]
    pub const fn new(travel_ms: u16) -> Self {
        Self {
            travel_ms: if travel_ms > 0 { travel_ms } else { TRAVEL_MS } as u32,
            packet: Packet::NEUTRAL,
            taken_ms: 0,
            is_silent: true,
            start: Moving::NEUTRAL,
            moved_ms: 0,
            updated_ms: 0,
        }
    }

    /// Takes a packet. Returns `false` if it is a duplicate or comes too late, and therefore is ignored.
    pub fn receive(&mut self, packet: &Packet, now_ms: u32) -> bool {
        self.update(now_ms);
        let ahead = packet.sequence.wrapping_sub(self.packet.sequence);
        let is_newer = (1..1 << 15).contains(&ahead);
        if !self.is_silent && !is_newer && elapsed_ms(self.taken_ms, now_ms) < LATE_MS {
            return false;
        }
        if self.is_silent {
            self.begin_move(false);
        }
        self.packet = *packet;
        self.taken_ms = now_ms;
        true
    }

    /// Returns the face to show now.
    pub fn show(&mut self, now_ms: u32) -> Face {
        self.update(now_ms);
        let shown = self.shown();
        Face {
            is_silent: self.is_silent,
            rotation: quantise::rotation_back(self.whole_rotation(shown.vector)),
            coefficients: shown.coefficients.map(|value| quantise::coefficient_back(clamped_u16(value))),
        }
    }

    /// Returns the newest packet that was taken, or [`Packet::NEUTRAL`] before the first one. Its head position, state and
    /// reason are as the sender gave them, however long ago.
    #[must_use]
    pub const fn newest(&self) -> &Packet {
        &self.packet
    }

    /// Continues the current move, and begins the one to neutral if packets have stopped.
    fn update(&mut self, now_ms: u32) {
        let step_ms = elapsed_ms(self.updated_ms, now_ms).min(STEP_MS);
        self.updated_ms = now_ms;
        self.moved_ms = (self.moved_ms + step_ms).min(self.travel_ms);
        if !self.is_silent && elapsed_ms(self.taken_ms, now_ms) >= SILENCE_MS {
            self.begin_move(true);
        }
    }

    /// Begins to move from what is shown, to neutral or to the packets.
    fn begin_move(&mut self, is_silent: bool) {
        self.start = self.shown();
        self.is_silent = is_silent;
        self.moved_ms = 0;
    }

    /// Where the face is on its move.
    fn shown(&self) -> Moving {
        let target = self.target();
        let share = self.share();
        let between = |start: i32, end: i32| start + (end - start) * share / ARRIVED;
        let mut shown = self.start;
        for (value, end) in shown.coefficients.iter_mut().zip(target.coefficients) {
            *value = between(*value, end);
        }
        for (value, end) in shown.vector.iter_mut().zip(target.vector) {
            *value = between(*value, end);
        }
        shown
    }

    /// Where the move goes.
    fn target(&self) -> Moving {
        if self.is_silent {
            return Moving::NEUTRAL;
        }
        let [x, y, z, _] = upright(self.packet.rotation);
        Moving {
            vector: [x, y, z],
            coefficients: self.packet.coefficients.map(|value| quantise::coefficient(value).into()),
        }
    }

    /// The share of the current move that is done, of [`ARRIVED`].
    fn share(&self) -> i32 {
        (self.moved_ms * ARRIVED.unsigned_abs() / self.travel_ms).cast_signed()
    }

    /// Adds w to a rotation. At a packet's rotation it is the packet's own w, elsewhere what makes the length 1.
    fn whole_rotation(&self, [x, y, z]: [i32; 3]) -> [i16; 4] {
        let w = if self.is_silent || self.share() < ARRIVED {
            let rest = ROTATION_ONE * ROTATION_ONE - (x * x).saturating_add(y * y).saturating_add(z * z);
            rest.max(0).isqrt()
        } else {
            let [.., w] = upright(self.packet.rotation);
            w
        };
        [x, y, z, w].map(clamped_i16)
    }
}

/// The time from one moment to another, or 0 if the other one lies before it. Both may have wrapped.
fn elapsed_ms(from_ms: u32, to_ms: u32) -> u32 {
    to_ms.wrapping_sub(from_ms).cast_signed().max(0).unsigned_abs()
}

/// A rotation in the integers of the wire, with the sign that makes w at least 0. Both signs are the same rotation.
fn upright(rotation: [f32; 4]) -> [i32; 4] {
    let components = quantise::rotation(rotation).map(i32::from);
    let [.., w] = components;
    if w < 0 { components.map(|component| -component) } else { components }
}

fn clamped_u16(value: i32) -> u16 {
    u16::try_from(value.max(0)).unwrap_or(u16::MAX)
}

fn clamped_i16(value: i32) -> i16 {
    i16::try_from(value).unwrap_or(i16::MAX)
}
