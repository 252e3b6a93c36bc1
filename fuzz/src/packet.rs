//! The packet decoder against a second reading of the wire format.

use facewire_packet::{DecodeError, PACKET_BYTES, Packet, State};

use super::wire::{Wire, checksum, seal, sealed, stated_checksum};

/// The flags that version 1 does not use.
const UNUSED_FLAGS: u8 = 0b1100;
/// Highest reason that version 1 defines.
const LAST_REASON: u8 = 5;

/// What is refused is refused for the right reason; what is decoded encodes to the same bytes, but for what the format
/// leaves open; a packet with one wrong bit is refused; any values encode to a packet that is taken.
pub fn packet(data: &[u8]) {
    judge(data);
    let wire = sealed(data);
    judge(&wire);
    refuses_a_wrong_bit(&wire, data);
    takes_any_values(data);
}

/// Decodes and compares with what the bytes themselves say.
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

/// The one way in which facewire itself writes this packet: unused flags are 0, and -32768 in the rotation is -32767.
fn canonical(mut wire: Wire) -> Wire {
    wire[3] &= !UNUSED_FLAGS;
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

fn takes_any_values(data: &[u8]) {
    let mut packet = Packet { state: State::Decay, ..Packet::NEUTRAL };
    let mut words = data.as_chunks().0.iter().map(|word| u32::from_le_bytes(*word));
    let Packet { rotation, position_mm, coefficients, age_us, .. } = &mut packet;
    let values = rotation.iter_mut().chain(position_mm).chain(coefficients);
    for (value, word) in values.zip(words.clone()) {
        *value = f32::from_bits(word);
    }
    *age_us = words.next_back().unwrap_or_default();
    let sent = packet.encode();
    assert_eq!(Packet::decode(&sent).unwrap().encode(), sent);
}
