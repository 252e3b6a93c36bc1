//! What frames on a serial line promise.
#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use facewire_packet::{DecodeError, FRAME_BYTES, FrameReader, Packet, State};

/// A packet with few zeros, many of them, or some, as `sequence` has it.
fn packet(sequence: u16) -> Packet {
    let mut packet = Packet { state: State::Live, sequence, ..Packet::NEUTRAL };
    let every = usize::from(sequence % 5) + 1;
    for coefficient in packet.coefficients.iter_mut().step_by(every) {
        *coefficient = f32::from(sequence.wrapping_mul(31) % 1000) / 1000.0;
    }
    Packet::decode(&packet.encode()).unwrap()
}

/// What a reader makes of a line.
fn read(line: &[u8]) -> Vec<Result<Packet, DecodeError>> {
    let mut reader = FrameReader::default();
    line.iter().filter_map(|byte| reader.push(*byte)).collect()
}

/// The packets among it.
fn packets(line: &[u8]) -> Vec<Packet> {
    read(line).into_iter().filter_map(Result::ok).collect()
}

/// Numbers without a pattern that frames could share (Marsaglia's xorshift).
fn noise(seed: u32) -> impl Iterator<Item = u8> {
    std::iter::successors(Some(seed), |state| {
        let state = state ^ (state << 13);
        let state = state ^ (state >> 17);
        Some(state ^ (state << 5))
    })
    .map(|state| state.to_le_bytes()[1])
}

#[test]
fn every_frame_has_134_bytes_and_one_zero_at_its_end() {
    for sequence in 0..2000 {
        let frame = packet(sequence).encode_frame();
        assert_eq!((frame.len(), FRAME_BYTES), (134, 134));
        assert_eq!(frame.iter().position(|byte| *byte == 0), Some(133));
    }
}

#[test]
fn stuffing_is_that_of_the_definition() {
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
fn packets_come_back_in_order_from_a_line_without_pauses() {
    let sent: Vec<Packet> = (0..500).map(packet).collect();
    let line: Vec<u8> = sent.iter().flat_map(Packet::encode_frame).collect();
    assert_eq!(packets(&line), sent);
}

#[test]
fn a_line_that_is_joined_at_any_byte_gives_every_packet_but_the_one_that_was_cut() {
    let sent = [packet(1), packet(2), packet(3)];
    let line: Vec<u8> = sent.iter().flat_map(Packet::encode_frame).collect();
    for start in 0..=FRAME_BYTES {
        let whole = if start == 0 { &sent[..] } else { &sent[1..] };
        assert_eq!(packets(&line[start..]), whole, "from byte {start}");
    }
}

#[test]
fn after_a_line_that_stops_at_any_byte_the_next_frame_but_one_is_read() {
    for end in 0..FRAME_BYTES {
        let mut line = packet(1).encode_frame()[..end].to_vec();
        line.extend(packet(2).encode_frame());
        line.extend(packet(3).encode_frame());
        assert_eq!(packets(&line).last(), Some(&packet(3)), "cut at byte {end}");
    }
}

#[test]
fn a_lost_byte_costs_one_packet_and_a_lost_end_two() {
    for lost in 0..FRAME_BYTES {
        let mut line: Vec<u8> = [1, 2, 3].into_iter().flat_map(|number| packet(number).encode_frame()).collect();
        line.remove(lost);
        let left = if lost == FRAME_BYTES - 1 { &[packet(3)][..] } else { &[packet(2), packet(3)] };
        assert_eq!(packets(&line), left, "without byte {lost}");
    }
}

#[test]
fn every_flipped_bit_of_a_frame_costs_no_packet_after_the_next() {
    for bit in 0..FRAME_BYTES * 8 {
        let mut line: Vec<u8> = [1, 2, 3].into_iter().flat_map(|number| packet(number).encode_frame()).collect();
        line[bit / 8] ^= 1 << (bit % 8);
        let read = packets(&line);
        assert!(!read.contains(&packet(1)), "bit {bit}");
        assert_eq!(read.last(), Some(&packet(3)), "bit {bit}");
    }
}

#[test]
fn garbage_between_frames_makes_no_packet_and_hides_none_behind_a_zero() {
    for seed in 1..200 {
        let mut line: Vec<u8> = noise(seed).take(usize::try_from(seed).unwrap() * 7).collect();
        line.push(0);
        line.extend(packet(9).encode_frame());
        assert_eq!(packets(&line), [packet(9)], "seed {seed}");
    }
}

#[test]
fn a_line_without_any_zero_takes_no_memory_and_is_refused_by_its_length() {
    let mut line = vec![1; 100_000];
    line.push(0);
    assert_eq!(read(&line), [Err(DecodeError::Length(99_999))]);
}

#[test]
fn frames_that_hold_no_packet_are_refused_with_the_reason() {
    let frame = packet(1).encode_frame();
    let damaged = |place: usize, byte: u8| {
        let mut frame = frame;
        frame[place] = byte;
        read(&frame)
    };
    assert_eq!(read(&[2, b'x', 1, 0]), [Err(DecodeError::Length(2))]);
    assert_eq!(read(&[5, b'x', 0]), [Err(DecodeError::Cut)]);
    assert_eq!(damaged(1, b'X'), [Err(DecodeError::Magic)]);
    assert_eq!(damaged(132, frame[132] ^ 0x80), [Err(DecodeError::Checksum)]);
}

#[test]
fn empty_frames_are_passed_over() {
    let line = [&[0; 7][..], &packet(4).encode_frame(), &[0; 3]].concat();
    assert_eq!(read(&line), [Ok(packet(4))]);
}
