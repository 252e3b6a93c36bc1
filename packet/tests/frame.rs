//! Packets survive a serial line with lost bytes, flipped bits and garbage.
#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use facewire_packet::{DecodeError, FRAME_BYTES, FrameReader, Packet, State};

/// Returns a packet whose share of non-zero coefficients depends on `sequence`: from all of them to one in five.
fn packet(sequence: u16) -> Packet {
    let mut packet = Packet { state: State::Live, sequence, ..Packet::NEUTRAL };
    let every = usize::from(sequence % 5) + 1;
    for coefficient in packet.coefficients.iter_mut().step_by(every) {
        *coefficient = f32::from(sequence.wrapping_mul(31) % 1000) / 1000.0;
    }
    Packet::decode(&packet.encode()).unwrap()
}

/// Reads a line and returns the packets and errors.
fn read(line: &[u8]) -> Vec<Result<Packet, DecodeError>> {
    let mut reader = FrameReader::default();
    line.iter().filter_map(|byte| reader.push(*byte)).collect()
}

/// Reads a line and returns the packets.
fn packets(line: &[u8]) -> Vec<Packet> {
    read(line).into_iter().filter_map(Result::ok).collect()
}

/// Pseudo-random bytes without a repeating pattern that could be mistaken for frames (Marsaglia's xorshift).
fn noise(seed: u32) -> impl Iterator<Item = u8> {
    std::iter::successors(Some(seed), |state| {
        let state = state ^ (state << 13);
        let state = state ^ (state >> 17);
        Some(state ^ (state << 5))
    })
    .map(|state| state.to_le_bytes()[1])
}

#[test]
fn every_frame_has_134_bytes_and_its_only_zero_at_the_end() {
    for sequence in 0..2000 {
        let frame = packet(sequence).encode_frame();
        assert_eq!((frame.len(), FRAME_BYTES), (134, 134));
        assert_eq!(frame.iter().position(|byte| *byte == 0), Some(133));
    }
}

#[test]
fn encoding_agrees_with_the_definition_of_cobs() {
    let packet = packet(3);
    let mut want = Vec::new();
    for run in packet.encode().split(|byte| *byte == 0) {
        want.push(u8::try_from(run.len()).unwrap() + 1);
        want.extend_from_slice(run);
    }
    want.push(0);
    assert_eq!(packet.encode_frame().to_vec(), want);
}

#[test]
fn frames_without_pauses_between_them_are_decoded_in_order() {
    let sent: Vec<Packet> = (0..500).map(packet).collect();
    let line: Vec<u8> = sent.iter().flat_map(Packet::encode_frame).collect();
    assert_eq!(packets(&line), sent);
}

#[test]
fn a_reader_that_starts_mid_frame_loses_only_that_frame() {
    let sent = [packet(1), packet(2), packet(3)];
    let line: Vec<u8> = sent.iter().flat_map(Packet::encode_frame).collect();
    for start in 0..=FRAME_BYTES {
        let whole = if start == 0 { &sent[..] } else { &sent[1..] };
        assert_eq!(packets(&line[start..]), whole, "from byte {start}");
    }
}

#[test]
fn a_frame_cut_off_at_any_byte_costs_at_most_one_further_packet() {
    for end in 0..FRAME_BYTES {
        let mut line = packet(1).encode_frame()[..end].to_vec();
        line.extend(packet(2).encode_frame());
        line.extend(packet(3).encode_frame());
        assert_eq!(packets(&line).last(), Some(&packet(3)), "cut at byte {end}");
    }
}

#[test]
fn a_lost_byte_costs_one_packet_and_a_lost_end_marker_two() {
    for lost in 0..FRAME_BYTES {
        let mut line: Vec<u8> = [1, 2, 3].into_iter().flat_map(|number| packet(number).encode_frame()).collect();
        line.remove(lost);
        let left = if lost == FRAME_BYTES - 1 { &[packet(3)][..] } else { &[packet(2), packet(3)] };
        assert_eq!(packets(&line), left, "without byte {lost}");
    }
}

#[test]
fn a_flipped_bit_costs_at_most_one_further_packet() {
    for bit in 0..FRAME_BYTES * 8 {
        let mut line: Vec<u8> = [1, 2, 3].into_iter().flat_map(|number| packet(number).encode_frame()).collect();
        line[bit / 8] ^= 1 << (bit % 8);
        let read = packets(&line);
        assert!(!read.contains(&packet(1)), "bit {bit}");
        assert_eq!(read.last(), Some(&packet(3)), "bit {bit}");
    }
}

#[test]
fn garbage_before_a_zero_yields_no_packet_and_hides_none() {
    for seed in 1..200 {
        let mut line: Vec<u8> = noise(seed).take(usize::try_from(seed).unwrap() * 7).collect();
        line.push(0);
        line.extend(packet(9).encode_frame());
        assert_eq!(packets(&line), [packet(9)], "seed {seed}");
    }
}

#[test]
fn a_stream_without_zeros_is_refused_by_its_length() {
    let mut line = vec![1; 100_000];
    line.push(0);
    assert_eq!(read(&line), [Err(DecodeError::Length(99_999))]);
}

#[test]
fn frames_without_a_valid_packet_are_refused_with_the_reason() {
    let frame = packet(1).encode_frame();
    let damaged = |index: usize, byte: u8| {
        let mut frame = frame;
        frame[index] = byte;
        read(&frame)
    };
    assert_eq!(read(&[2, b'x', 1, 0]), [Err(DecodeError::Length(2))]);
    assert_eq!(read(&[5, b'x', 0]), [Err(DecodeError::Cut)]);
    assert_eq!(damaged(1, b'X'), [Err(DecodeError::Magic)]);
    assert_eq!(damaged(132, frame[132] ^ 0x80), [Err(DecodeError::Checksum)]);
}

#[test]
fn empty_frames_are_skipped() {
    let line = [&[0; 7][..], &packet(4).encode_frame(), &[0; 3]].concat();
    assert_eq!(read(&line), [Ok(packet(4))]);
}
