//! Compares the packet decoder with a second implementation of the wire format.

use facewire_packet::{DecodeError, PACKET_BYTES, Packet, State, Visibility};

use super::wire::{Wire, checksum, seal, sealed, stated_checksum};

/// The bits of the flags that name the neutral face. If all are set, a part of the face is covered.
const NEUTRAL_FACE: u8 = 0b1100;
/// The coefficients whose lowest 4 bits then carry the visibility of the parts and the neutral face: the lower bytes.
const CARRIERS: [usize; 7] = [26, 28, 30, 32, 34, 36, 38];
/// The highest number of a reason that version 1 defines.
const LAST_REASON: u8 = 5;

/// Checks that a refused packet is refused for the right reason, that a decoded packet encodes to the same bytes (see
/// [`canonical`]), that a packet with one wrong bit is refused, and that any values encode to a packet that decodes.
pub fn packet(data: &[u8]) {
    judge(data);
    let wire = sealed(data);
    judge(&wire);
    refuses_a_wrong_bit(&wire, data);
    any_values_decode(data);
}

/// Decodes the bytes and compares the result with that of the second implementation.
fn judge(data: &[u8]) {
    let decoded = Packet::decode(data);
    let Ok(wire) = <&Wire>::try_from(data) else {
        assert_eq!(decoded, Err(DecodeError::Length(data.len())));
        return;
    };
    let reason = wire[3] >> 4;
    let fault = match wire {
        [magic @ .., _] if !magic.starts_with(b"FW") => Some(DecodeError::Magic),
        [_, _, version, ..] if *version != 1 => Some(DecodeError::Version(*version)),
        _ if stated_checksum(wire) != checksum(wire) => Some(DecodeError::Checksum),
        _ if reason > LAST_REASON => Some(DecodeError::Reason(reason)),
        _ => None,
    };
    assert_eq!(decoded.as_ref().err(), fault.as_ref());
    if let Ok(packet) = decoded {
        assert_eq!(packet.encode(), canonical(*wire));
        assert!(packet.coefficients.iter().all(|value| (0.0..=1.0).contains(value)));
        assert!(packet.rotation.iter().all(|value| (-1.0..=1.0).contains(value)));
    }
}

/// Returns the bytes that facewire itself writes for a packet: a neutral face that does not exist is the first one, a face of
/// which all is in view says so by its flags, and -32768 in the rotation becomes -32767.
fn canonical(mut wire: Wire) -> Wire {
    if wire[3] & NEUTRAL_FACE == NEUTRAL_FACE {
        let [parts @ .., last] = CARRIERS;
        let neutral_face = if wire[last] & 3 == 3 { 0 } else { wire[last] & 3 };
        if parts.iter().all(|at| wire[*at] & 0xF == 0xF) {
            wire[3] = wire[3] & !NEUTRAL_FACE | neutral_face << 2;
            CARRIERS.iter().for_each(|at| wire[*at] = wire[*at] & 0xF0 | wire[at + 1] >> 4);
        } else {
            wire[last] = wire[last] & 0xF0 | neutral_face;
        }
    }
    for component in wire[12..20].chunks_exact_mut(2).filter(|bytes| **bytes == i16::MIN.to_le_bytes()) {
        component.copy_from_slice(&(-i16::MAX).to_le_bytes());
    }
    seal(wire)
}

fn refuses_a_wrong_bit(wire: &Wire, data: &[u8]) {
    let bit = data.iter().fold(0, |sum, byte| (31 * sum + usize::from(*byte)) & 0xffff) % (8 * PACKET_BYTES);
    let mut wrong = *wire;
    wrong[bit / 8] ^= 1 << (bit % 8);
    assert!(Packet::decode(&wrong).is_err(), "bit {bit}");
}

fn any_values_decode(data: &[u8]) {
    let mut packet = Packet { state: State::Decay, ..Packet::NEUTRAL };
    let mut words = data.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word));
    let seen = Visibility::NAMES.map(|_| words.next_back().map_or(1.0, f32::from_bits));
    packet.visibility = Visibility::from_values(seen);
    let Packet { rotation, position_mm, coefficients, age_us, .. } = &mut packet;
    let values = rotation.iter_mut().chain(position_mm).chain(coefficients);
    for (value, word) in values.zip(words.clone()) {
        *value = f32::from_bits(word);
    }
    *age_us = words.next_back().unwrap_or_default();
    let sent = packet.encode();
    assert_eq!(Packet::decode(&sent).unwrap().encode(), sent);
}
