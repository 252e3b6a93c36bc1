//! The C header decodes what the crate encodes.
#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

mod compiler;

use std::{fs, path::PathBuf, sync::LazyLock};

use compiler::{compiled_c, package, printed};
use facewire_packet::{BLENDSHAPES, DecodeError, FrameReader, NeutralFace, Packet, Reason, State};

static DECODER: LazyLock<PathBuf> = LazyLock::new(|| compiled_c("decode.c"));
static FEEDER: LazyLock<PathBuf> = LazyLock::new(|| compiled_c("feed.c"));

fn decoded_by_c(bytes: &[u8]) -> Vec<i64> {
    printed(&DECODER, bytes)
}

fn packet() -> Packet {
    let mut packet = Packet {
        state: State::Decay,
        reason: Reason::NoCamera,
        neutral_face: NeutralFace::Calibrated,
        sequence: 65535,
        age_us: 123_400,
        capture_us: 0xFEDC_BA98,
        rotation: [0.0, -1.0, 1.0, 0.5],
        position_mm: [-1.0, 2.0, -30000.0],
        ..Packet::NEUTRAL
    };
    packet.coefficients[0] = 1.0;
    packet.coefficients[51] = 0.5;
    packet
}

#[test]
fn c_reads_every_field_that_rust_wrote() {
    let mut want = vec![2, 2, 2, 65535, 1234, 0xFEDC_BA98, 0, -32767, 32767, 16384, -1, 2, -30000];
    want.push(65535);
    want.extend([0; 50]);
    want.push(32768);
    assert_eq!(decoded_by_c(&packet().encode()), want);
}

#[test]
fn c_refuses_damaged_packets_and_wrong_lengths_with_the_error_number() {
    let bytes = packet().encode();
    let flipped = |offset: usize| {
        let mut damaged = bytes;
        damaged[offset] ^= 1;
        decoded_by_c(&damaged)
    };
    assert_eq!(decoded_by_c(&bytes[..131]), [-1]);
    assert_eq!(flipped(0), [-2]);
    assert_eq!(flipped(2), [-3]);
    assert_eq!(flipped(77), [-4]);
}

/// Reads a line with the crate and returns the results as the C program prints them.
fn read_by_rust(line: &[u8]) -> Vec<i64> {
    let mut reader = FrameReader::default();
    let results = line.iter().filter_map(|byte| reader.push(*byte));
    results
        .flat_map(|result| match result {
            Ok(packet) => vec![packet.sequence.into(), i64::from(packet.coefficients[51] > 0.0) * 32768],
            Err(DecodeError::Length(_)) => vec![-1],
            Err(DecodeError::Magic) => vec![-2],
            Err(DecodeError::Version(_)) => vec![-3],
            Err(DecodeError::Checksum) => vec![-4],
            Err(DecodeError::Reason(_)) => vec![-5],
            Err(DecodeError::Cut) => vec![-6],
        })
        .collect()
}

#[test]
fn c_and_rust_find_the_same_packets_and_errors_on_a_line() {
    let frame = packet().encode_frame();
    assert_eq!(printed(&FEEDER, &frame), [65535, 32768]);
    let mut line = vec![0, 0];
    for cut in 0..frame.len() {
        line.extend_from_slice(&frame[cut..]);
        line.extend_from_slice(&frame[..cut]);
        line.extend_from_slice(&[7; 300][..2 * cut]);
        line.extend_from_slice(&[0, 0][cut % 2..]);
    }
    let found = read_by_rust(&line);
    assert!([-1, -6, 65535].iter().all(|number| found.contains(number)));
    assert_eq!(printed(&FEEDER, &line), found);
}

#[test]
fn c_names_the_blendshapes_in_the_order_of_the_crate() {
    let text = fs::read_to_string(package().join("include/facewire_packet.h")).unwrap();
    let list = text.split("enum facewire_blendshape {").nth(1).unwrap();
    let names = list.lines().skip(1).map(str::trim).take(BLENDSHAPES.len());
    for (c_name, name) in names.zip(BLENDSHAPES) {
        let in_capitals = c_name.trim_end_matches(',').trim_end_matches(" = 0");
        let without_bars = in_capitals.trim_start_matches("FACEWIRE_").replace('_', "");
        assert_eq!(without_bars, name.to_uppercase());
    }
}
