//! The packet as a plain struct, with its encoder and decoder.

use crc::{CRC_16_MCRF4XX, Crc, NoTable};

use crate::{BLENDSHAPE_COUNT, DecodeError, NeutralFace, PACKET_BYTES, Reason, State, Visibility, field, quantise};

/// The version of the format that this crate writes and reads.
pub const VERSION: u8 = 1;
/// A receiver must move to neutral on its own if no valid packet arrives for this long.
pub const SILENCE_MS: u32 = 500;

/// A gap of this size means that the sender has restarted, not that packets were lost.
const RESTART_GAP: u16 = 1024;
const MAGIC: [u8; 2] = *b"FW";
/// What stands in the flags in place of the neutral face while a part of the face is covered, which is to say that less than
/// half of it is in view. The lowest 4 bits of the first coefficients are then [`Carried`]. Receivers that do not support this
/// assume the mean of many people, and read coefficients that are wrong by less than 1/4000.
const COVERED: u8 = 3;
/// Computed bit by bit: this takes 1 microsecond per packet, and a table would take 512 bytes of a microcontroller.
const CRC: Crc<u16, NoTable> = Crc::<u16, NoTable>::new(&CRC_16_MCRF4XX);

/// The visibility of each part in fifteenths, and then the neutral face.
type Carried = [u8; Visibility::NAMES.len() + 1];

/// One pose of the face, as sent to a receiver.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Packet {
    /// How much the sender trusts the pose.
    pub state: State,
    /// Why the state is not live.
    pub reason: Reason,
    /// The neutral face from which the coefficients are measured.
    pub neutral_face: NeutralFace,
    /// How much of each part of the face is in view; [`Visibility::WHOLE`] while no face is followed. Sent in fifteenths while
    /// a part is covered, and otherwise received as [`Visibility::WHOLE`].
    pub visibility: Visibility,
    /// Increases by one with each packet and wraps. A gap means lost packets.
    pub sequence: u16,
    /// Time from capture to sending in microseconds. Sent in steps of 100 microseconds, at most 6.5535 s.
    pub age_us: u32,
    /// Capture time of the frame on the sender's monotonic clock, in microseconds. Wraps after 71 minutes.
    pub capture_us: u32,
    /// Head rotation as a unit quaternion x y z w, identity when the head faces the camera. The axes point to the
    /// person's left (x), up (y) and out of the face (z).
    pub rotation: [f32; 4],
    /// Head position in camera coordinates, in millimetres: x right in the picture, y down, z away from the camera.
    pub position_mm: [f32; 3],
    /// The blendshape coefficients, from 0 to 1, in the order of [`crate::BLENDSHAPES`]. Sent in steps of 1/65535; while a
    /// part is covered, the first seven in steps of 1/4095.
    pub coefficients: [f32; BLENDSHAPE_COUNT],
}

impl Packet {
    /// The neutral face of a sender that has not seen a face yet.
    pub const NEUTRAL: Self = Self {
        state: State::Neutral,
        reason: Reason::None,
        neutral_face: NeutralFace::Mean,
        visibility: Visibility::WHOLE,
        sequence: 0,
        age_us: u32::MAX,
        capture_us: 0,
        rotation: [0.0, 0.0, 0.0, 1.0],
        position_mm: [0.0; 3],
        coefficients: [0.0; BLENDSHAPE_COUNT],
    };

    /// Returns how many packets were lost between `earlier` and this one. `earlier` is the packet that the receiver got
    /// from the same sender just before this one. Packets that come twice, late, or from a sender that has restarted
    /// are no losses.
    #[must_use]
    pub const fn lost_since(&self, earlier: &Self) -> u16 {
        let gap = self.sequence.wrapping_sub(earlier.sequence).wrapping_sub(1);
        if gap < RESTART_GAP { gap } else { 0 }
    }

    /// Encodes the packet. Values out of range saturate, NaN becomes 0, and a quaternion with a component that is not
    /// finite becomes the identity.
    #[must_use]
    pub fn encode(&self) -> [u8; PACKET_BYTES] {
        let mut bytes = [0; PACKET_BYTES];
        let wire = &mut bytes;
        field::MAGIC.put(wire, MAGIC);
        field::VERSION.put(wire, [VERSION]);
        let mut coefficients = self.coefficients.map(quantise::coefficient);
        let carried = self.carried();
        if let Some(carried) = carried {
            insert(carried, &mut coefficients);
        }
        let neutral_face = if carried.is_some() { COVERED } else { self.neutral_face as u8 };
        field::FLAGS.put(wire, [self.state as u8 | neutral_face << 2 | (self.reason as u8) << 4]);
        field::SEQUENCE.put(wire, self.sequence.to_le_bytes());
        field::AGE.put(wire, quantise::age(self.age_us).to_le_bytes());
        field::CAPTURE.put(wire, self.capture_us.to_le_bytes());
        field::ROTATION.put(wire, i16s_to_bytes(quantise::rotation(self.rotation)));
        field::POSITION.put(wire, i16s_to_bytes(quantise::position(self.position_mm)));
        field::COEFFICIENTS.put(wire, coefficients_to_bytes(coefficients));
        field::CHECKSUM.put(wire, checksum(wire).to_le_bytes());
        bytes
    }

    /// Decodes a packet from exactly [`PACKET_BYTES`] bytes.
    ///
    /// # Errors
    /// Returns a [`DecodeError`] if the bytes are not a packet of version 1.
    pub fn decode(bytes: &[u8]) -> Result<Self, DecodeError> {
        let wire = verified(bytes)?;
        let [flags] = field::FLAGS.get(wire);
        let reason = flags >> 4;
        let mut coefficients = coefficients_from_bytes(&field::COEFFICIENTS.get(wire));
        let (visibility, neutral_face) = match flags >> 2 & 0b11 {
            COVERED => extract(&mut coefficients),
            neutral_face => (Visibility::WHOLE, neutral_face),
        };
        Ok(Self {
            state: State::from_bits(flags),
            reason: Reason::from_number(reason).ok_or(DecodeError::Reason(reason))?,
            neutral_face: NeutralFace::from_bits(neutral_face),
            visibility,
            sequence: u16::from_le_bytes(field::SEQUENCE.get(wire)),
            age_us: quantise::age_back(u16::from_le_bytes(field::AGE.get(wire))),
            capture_us: u32::from_le_bytes(field::CAPTURE.get(wire)),
            rotation: quantise::rotation_back(i16s_from_bytes(&field::ROTATION.get(wire))),
            position_mm: i16s_from_bytes(&field::POSITION.get(wire)).map(f32::from),
            coefficients: coefficients.map(quantise::coefficient_back),
        })
    }

    /// Returns what the coefficients carry besides themselves; `None` if nothing is covered.
    fn carried(&self) -> Option<Carried> {
        self.visibility.covered().next()?;
        let mut carried = Carried::default();
        let [parts @ .., neutral_face] = &mut carried;
        *parts = self.visibility.values().map(quantise::visibility);
        *neutral_face = self.neutral_face as u8;
        Some(carried)
    }
}

/// Replaces the lowest 4 bits of the first coefficients.
fn insert(carried: Carried, coefficients: &mut [u16; BLENDSHAPE_COUNT]) {
    for (coefficient, carried) in coefficients.iter_mut().zip(carried) {
        *coefficient = *coefficient & !0xF | u16::from(carried);
    }
}

/// Returns the visibility and the number of the neutral face that the first coefficients carry. Replaces them by their
/// highest 4 bits, so that 0 and 1 are exact.
fn extract(coefficients: &mut [u16; BLENDSHAPE_COUNT]) -> (Visibility, u8) {
    let mut carried = Carried::default();
    for (carried, coefficient) in carried.iter_mut().zip(coefficients) {
        let [low, _] = coefficient.to_le_bytes();
        *carried = low & 0xF;
        *coefficient = *coefficient & !0xF | *coefficient >> 12;
    }
    let [parts @ .., neutral_face] = carried;
    (Visibility::from_values(parts.map(quantise::visibility_back)), neutral_face)
}

/// Checks length, magic number, version and checksum.
fn verified(bytes: &[u8]) -> Result<&[u8; PACKET_BYTES], DecodeError> {
    let wire = <&[u8; PACKET_BYTES]>::try_from(bytes).map_err(|_| DecodeError::Length(bytes.len()))?;
    if field::MAGIC.get(wire) != MAGIC {
        return Err(DecodeError::Magic);
    }
    let [version] = field::VERSION.get(wire);
    if version != VERSION {
        return Err(DecodeError::Version(version));
    }
    if u16::from_le_bytes(field::CHECKSUM.get(wire)) != checksum(wire) {
        return Err(DecodeError::Checksum);
    }
    Ok(wire)
}

/// Computes the CRC-16/MCRF4XX of all bytes before the checksum.
fn checksum(wire: &[u8; PACKET_BYTES]) -> u16 {
    let covered = field::COEFFICIENTS.end();
    CRC.checksum(wire.get(..covered).unwrap_or_default())
}

fn i16s_to_bytes<const N: usize, const BYTES: usize>(values: [i16; N]) -> [u8; BYTES] {
    const { assert!(BYTES == 2 * N) };
    let mut bytes = [0; BYTES];
    for (pair, value) in bytes.as_chunks_mut().0.iter_mut().zip(values) {
        *pair = value.to_le_bytes();
    }
    bytes
}

fn i16s_from_bytes<const N: usize, const BYTES: usize>(bytes: &[u8; BYTES]) -> [i16; N] {
    const { assert!(BYTES == 2 * N) };
    let mut values = [0; N];
    for (value, pair) in values.iter_mut().zip(bytes.as_chunks().0) {
        *value = i16::from_le_bytes(*pair);
    }
    values
}

fn coefficients_to_bytes(coefficients: [u16; BLENDSHAPE_COUNT]) -> [u8; 2 * BLENDSHAPE_COUNT] {
    let mut bytes = [0; 2 * BLENDSHAPE_COUNT];
    for (pair, value) in bytes.as_chunks_mut().0.iter_mut().zip(coefficients) {
        *pair = value.to_le_bytes();
    }
    bytes
}

fn coefficients_from_bytes(bytes: &[u8; 2 * BLENDSHAPE_COUNT]) -> [u16; BLENDSHAPE_COUNT] {
    let mut coefficients = [0; BLENDSHAPE_COUNT];
    for (value, pair) in coefficients.iter_mut().zip(bytes.as_chunks().0) {
        *value = u16::from_le_bytes(*pair);
    }
    coefficients
}
