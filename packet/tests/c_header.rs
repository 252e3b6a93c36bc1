//! The C header decodes what the crate encodes.
#![allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::float_cmp, clippy::cast_precision_loss)]

mod compiler;

use std::{fs, path::PathBuf, sync::LazyLock};

use compiler::{compiled_c, package, printed};
use facewire_packet::{BLENDSHAPES, DecodeError, FrameReader, NeutralFace, Packet, Reason, State, Visibility};

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
    let covered = Visibility { right_eye: 0.2, mouth: 0.0, ..Visibility::WHOLE };
    for (visibility, fifteenths) in [(Visibility::WHOLE, [15; 6]), (covered, [15, 3, 15, 0, 15, 15])] {
        let mut want = vec![2, 2, 2, 65535, 1234, 0xFEDC_BA98];
        want.extend(fifteenths);
        want.extend([0, -32767, 32767, 16384, -1, 2, -30000, 65535]);
        want.extend([0; 50]);
        want.push(32768);
        assert_eq!(decoded_by_c(&Packet { visibility, ..packet() }.encode()), want);
    }
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
fn c_and_rust_read_any_coefficients_of_a_covered_face_alike() {
    let mut packet = Packet { visibility: Visibility::from_values([0.1, 0.3, 0.5, 0.6, 0.8, 1.0]), ..packet() };
    for (value, coefficient) in (0_u8..).zip(&mut packet.coefficients) {
        *coefficient = f32::from(value) / 51.3;
    }
    let bytes = packet.encode();
    let read = Packet::decode(&bytes).unwrap();
    let by_c = decoded_by_c(&bytes);
    let (found, coefficients) = by_c.split_at(by_c.len() - 52);
    assert_eq!(found[2], 2, "calibrated");
    for (value, part) in found[6..12].iter().zip(read.visibility.values()) {
        assert_eq!(*value as f32 / 15.0, part);
    }
    for (value, coefficient) in coefficients.iter().zip(read.coefficients) {
        assert_eq!(*value as f32 / 65535.0, coefficient);
    }
}

#[test]
fn c_names_the_parts_of_the_face_in_the_order_of_the_crate() {
    let text = fs::read_to_string(package().join("include/facewire_packet.h")).unwrap();
    let list = text.split("enum facewire_part {").nth(1).unwrap();
    let names = list.lines().skip(1).map(str::trim).take(Visibility::NAMES.len());
    for (c_name, name) in names.zip(Visibility::NAMES) {
        assert_eq!(c_name.split([',', ' ']).next().unwrap(), format!("FACEWIRE_{}", name.to_uppercase()));
    }
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
