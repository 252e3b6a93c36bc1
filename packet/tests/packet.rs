//! Packets survive encoding, and damaged or foreign bytes are refused.
#![allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::float_cmp)]

use std::fmt::Write as _;

use facewire_packet::{BLENDSHAPES, DecodeError, NeutralFace, PACKET_BYTES, Packet, Reason, State, Visibility};

/// The encoding of [`golden_packet`] by an independent implementation: Python's `struct` and `crccheck`.
const GOLDEN: &str = "\
     4657013534127b00efcdab89cd0c67e66626b376f4ff23006402000005050a0a0f0f141419191e1e23232828\
     2d2d323237373c3c414146464b4b505055555a5a5f5f646469696e6e737378787d7d828287878c8c91919696\
     9b9ba0a0a5a5aaaaafafb4b4b9b9bebec3c3c8c8cdcdd2d2d7d7dcdce1e1e6e6ebebf0f0f5f5fafafffffac6";

/// The same of [`covered_packet`].
const COVERED: &str = "\
     4657013d34127b00efcdab89cd0c67e66626b376f4ff230064020c0000050f0a080f1e141919111e23232828\
     2d2d323237373c3c414146464b4b505055555a5a5f5f646469696e6e737378787d7d828287878c8c91919696\
     9b9ba0a0a5a5aaaaafafb4b4b9b9bebec3c3c8c8cdcdd2d2d7d7dcdce1e1e6e6ebebf0f0f5f5fafaffff3164";

#[expect(clippy::cast_precision_loss, reason = "0 to 51")]
fn golden_packet() -> Packet {
    Packet {
        state: State::Hold,
        reason: Reason::Late,
        neutral_face: NeutralFace::Estimated,
        visibility: Visibility::WHOLE,
        sequence: 0x1234,
        age_us: 12_345,
        capture_us: 0x89AB_CDEF,
        rotation: [0.1, -0.2, 0.3, 0.927_361_8],
        position_mm: [-12.4, 34.6, 612.0],
        coefficients: std::array::from_fn(|index| index as f32 / 51.0),
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

/// The golden packet of a face whose right eye is covered, and whose mouth is half in view.
fn covered_packet() -> Packet {
    let visibility = Visibility { left_eye: 0.8, right_eye: 0.0, brows: 1.0, mouth: 0.5, cheeks: 0.9, face: 0.6 };
    Packet { visibility, ..golden_packet() }
}

/// Returns the golden packet with one byte replaced and a matching checksum.
fn with_byte(offset: usize, value: u8) -> [u8; PACKET_BYTES] {
    let mut bytes = golden_packet().encode();
    bytes[offset] = value;
    let checksum = crc16_mcrf4xx(&bytes[..130]);
    bytes[130..].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

/// Returns these bytes with other flags and a matching checksum.
fn with_flags(mut bytes: [u8; PACKET_BYTES], flags: u8) -> [u8; PACKET_BYTES] {
    bytes[3] = flags;
    let checksum = crc16_mcrf4xx(&bytes[..130]);
    bytes[130..].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

/// Computes the checksum bit by bit from its definition.
fn crc16_mcrf4xx(bytes: &[u8]) -> u16 {
    bytes
        .iter()
        .fold(0xFFFF, |crc, byte| (0..8).fold(crc ^ u16::from(*byte), |crc, _| (crc >> 1) ^ (0x8408 * (crc & 1))))
}

#[test]
fn checksum_has_the_published_check_value() {
    assert_eq!(crc16_mcrf4xx(b"123456789"), 0x6F91);
}

#[test]
fn encoding_agrees_with_an_independent_implementation() {
    assert_eq!(hex(&golden_packet().encode()), GOLDEN);
}

#[test]
fn decoded_values_are_within_half_a_quantisation_step() {
    let sent = golden_packet();
    let received = Packet::decode(&sent.encode()).unwrap();
    assert_eq!((received.state, received.reason), (sent.state, sent.reason));
    assert_eq!((received.sequence, received.capture_us), (sent.sequence, sent.capture_us));
    assert!(received.age_us.abs_diff(sent.age_us) <= 50);
    for (got, want) in received.rotation.iter().zip(sent.rotation) {
        assert!((got - want).abs() <= 0.501 / 32767.0, "{got} for {want}");
    }
    for (got, want) in received.position_mm.iter().zip(sent.position_mm) {
        assert!((got - want).abs() <= 0.5, "{got} for {want}");
    }
    for (got, want) in received.coefficients.iter().zip(sent.coefficients) {
        assert!((got - want).abs() <= 0.501 / 65535.0, "{got} for {want}");
    }
}

#[test]
fn decoding_and_encoding_again_gives_the_same_bytes() {
    let bytes = golden_packet().encode();
    assert_eq!(Packet::decode(&bytes).unwrap().encode(), bytes);
}

#[test]
fn any_bytes_that_decode_survive_encoding_and_decoding() {
    let mut random = 1_u32;
    let mut decoded = 0;
    for _ in 0..10_000 {
        let mut bytes: [u8; PACKET_BYTES] = std::array::from_fn(|_| {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (random >> 24) as u8
        });
        bytes[..3].copy_from_slice(b"FW\x01");
        let checksum = crc16_mcrf4xx(&bytes[..130]);
        bytes[130..].copy_from_slice(&checksum.to_le_bytes());
        let Ok(packet) = Packet::decode(&bytes) else { continue };
        // Earlier senders say how much is in view also if no part is covered.
        let visibility =
            if packet.visibility.covered().next().is_some() { packet.visibility } else { Visibility::WHOLE };
        assert_eq!(Packet::decode(&packet.encode()), Ok(Packet { visibility, ..packet }));
        decoded += 1;
    }
    assert!(decoded > 3000, "6 of 16 reasons are known: {decoded}");
}

#[test]
fn every_state_reason_and_neutral_face_survives_the_wire() {
    use Reason::{BadResult, Late, NoCamera, NoFace, None, Stopping};
    for state in [State::Live, State::Hold, State::Decay, State::Neutral] {
        for reason in [None, NoFace, NoCamera, Late, BadResult, Stopping] {
            for neutral_face in [NeutralFace::Mean, NeutralFace::Estimated, NeutralFace::Calibrated] {
                let sent = Packet { state, reason, neutral_face, ..Packet::NEUTRAL };
                let received = Packet::decode(&sent.encode()).unwrap();
                assert_eq!((received.state, received.reason, received.neutral_face), (state, reason, neutral_face));
            }
        }
    }
}

#[test]
fn every_flipped_bit_is_refused() {
    let bytes = golden_packet().encode();
    for bit in 0..PACKET_BYTES * 8 {
        let mut damaged = bytes;
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(Packet::decode(&damaged).is_err(), "bit {bit}");
    }
}

#[test]
fn wrong_lengths_are_refused_with_the_number_of_bytes() {
    let mut long = golden_packet().encode().to_vec();
    long.push(0);
    for length in (0..=133).filter(|length| *length != PACKET_BYTES) {
        assert_eq!(Packet::decode(&long[..length]), Err(DecodeError::Length(length)));
    }
}

#[test]
fn foreign_magic_version_and_reason_are_refused_despite_a_valid_checksum() {
    assert_eq!(Packet::decode(&with_byte(0, b'X')), Err(DecodeError::Magic));
    assert_eq!(Packet::decode(&with_byte(2, 2)), Err(DecodeError::Version(2)));
    assert_eq!(Packet::decode(&with_byte(3, 6 << 4)), Err(DecodeError::Reason(6)));
}

#[test]
fn visibility_agrees_with_an_independent_implementation_and_is_received_within_half_a_fifteenth() {
    let sent = covered_packet();
    assert_eq!(hex(&sent.encode()), COVERED);
    let received = Packet::decode(&sent.encode()).unwrap();
    for ((name, got), want) in received.visibility.parts().zip(sent.visibility.values()) {
        assert!((got - want).abs() <= 0.501 / 15.0, "{name}: {got} for {want}");
    }
    assert_eq!(received.neutral_face, NeutralFace::Estimated);
    assert_eq!(received.encode(), sent.encode());
}

#[test]
fn while_a_part_is_covered_coefficients_0_and_1_stay_exact_and_the_others_lose_less_than_a_4000th() {
    for (value, most) in [(0.0, 0.0), (1.0, 0.0), (0.3, 1.0 / 4000.0), (0.9999, 1.0 / 4000.0)] {
        let sent = Packet { coefficients: [value; 52], ..covered_packet() };
        let received = Packet::decode(&sent.encode()).unwrap();
        assert!(received.coefficients.iter().all(|got| (got - value).abs() <= most), "{value}: {received:?}");
    }
}

/// They know neither visibility nor the value 3 of the neutral face, which they read as the mean.
#[test]
fn earlier_receivers_read_the_coefficients_of_a_covered_face() {
    let bytes = covered_packet().encode();
    let earlier = Packet::decode(&with_flags(bytes, bytes[3] & !0b1100)).unwrap();
    let want = covered_packet();
    assert!(earlier.coefficients.iter().zip(want.coefficients).all(|(got, want)| (got - want).abs() <= 1.0 / 4000.0));
    assert_eq!((earlier.state, earlier.reason), (want.state, want.reason));
}

#[test]
fn a_face_of_which_no_part_is_covered_is_sent_as_before_there_was_visibility() {
    let visibility = Visibility::from_values([0.5; 6]);
    assert_eq!(hex(&Packet { visibility, ..golden_packet() }.encode()), GOLDEN);
}

#[test]
fn visibility_names_each_part_once_and_a_part_counts_as_covered_below_half() {
    let visibility = Visibility { left_eye: 0.49, mouth: 0.0, brows: 0.5, ..Visibility::WHOLE };
    assert_eq!(Visibility::NAMES, ["left_eye", "right_eye", "brows", "mouth", "cheeks", "face"]);
    assert_eq!(visibility.values(), [0.49, 1.0, 0.5, 0.0, 1.0, 1.0]);
    assert!(visibility.covered().eq(["left_eye", "mouth"]));
    assert!(visibility.mirrored().covered().eq(["right_eye", "mouth"]));
}

#[test]
fn values_out_of_range_saturate() {
    let mut packet = Packet {
        age_us: u32::MAX,
        rotation: [2.0, -2.0, 0.0, 0.0],
        position_mm: [1e9, -1e9, f32::INFINITY],
        ..Packet::NEUTRAL
    };
    packet.coefficients[0] = 1.5;
    packet.coefficients[1] = -0.5;
    let received = Packet::decode(&packet.encode()).unwrap();
    assert_eq!(received.age_us, 6_553_500);
    assert_eq!(received.rotation, [1.0, -1.0, 0.0, 0.0]);
    assert_eq!(received.position_mm, [32767.0, -32768.0, 32767.0]);
    assert_eq!(received.coefficients[..2], [1.0, 0.0]);
}

#[test]
fn nan_is_sent_as_neutral() {
    let packet = Packet {
        rotation: [f32::NAN, 0.0, 0.0, 1.0],
        position_mm: [f32::NAN; 3],
        coefficients: [f32::NAN; 52],
        ..Packet::NEUTRAL
    };
    assert_eq!(packet.encode(), Packet::NEUTRAL.encode());
}

#[test]
fn names_are_distinct_and_end_with_the_tongue() {
    let mut names = BLENDSHAPES;
    names.sort_unstable();
    assert!(names.windows(2).all(|pair| pair[0] < pair[1]));
    assert_eq!((BLENDSHAPES[17], BLENDSHAPES[51]), ("jawOpen", "tongueOut"));
}

/// Counts what was lost between packets with these sequence numbers.
fn lost(sequences: &[u16]) -> u16 {
    let packets: Vec<Packet> =
        sequences.iter().map(|sequence| Packet { sequence: *sequence, ..Packet::NEUTRAL }).collect();
    packets.windows(2).map(|pair| pair[1].lost_since(&pair[0])).sum()
}

#[test]
fn gaps_are_losses_also_across_the_wrap() {
    assert_eq!(lost(&[1, 2, 5, 6]), 2);
    assert_eq!(lost(&[65534, 65535, 0, 2]), 1);
}

#[test]
fn repeated_and_late_packets_and_restarted_senders_are_not_losses() {
    assert_eq!(lost(&[7, 7]), 0);
    assert_eq!(lost(&[7, 6]), 0);
    assert_eq!(lost(&[40_000, 0]), 0);
}
