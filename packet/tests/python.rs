//! `python/facewire_packet.py`, which was written from the packet's table alone, reads what the crate encodes, and shows
//! what the crate's receiver shows.
#![allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::cast_possible_truncation, clippy::float_cmp)]

mod random;

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use facewire_packet::{BLENDSHAPES, Face, NeutralFace, Packet, Reason, Receiver, State, Visibility};
use random::Random;

/// Prints every field of a packet, which is given as a JSON list of its bytes, one field a line.
const DECODE: &str = "
import json, sys
import facewire_packet as d
p = d.decode(bytes(json.loads(sys.argv[1])))
for key in ('state', 'reason', 'neutral_face', 'sequence', 'age_ms', 'capture_us'):
    print(p[key])
for part, value in p['visibility'].items():
    print(part, round(15 * value))
for value in (*p['rotation'], *p['position_mm'], *p['coefficients'], *d.NAMES):
    print(value)
";

/// Reads lines of a time in seconds, and for a packet its bytes in hexadecimal numbers. Prints what the receiver says to
/// the packet, or the silence, rotation and coefficients of the face.
const RECEIVE: &str = "
import sys
import facewire_packet as f
receiver = f.Receiver(0.3)
for line in open(sys.argv[1]):
    now_s, *packet = line.split()
    if packet:
        print(int(receiver.receive(f.decode(bytes.fromhex(packet[0])), float(now_s))))
    else:
        face = receiver.show(float(now_s))
        print(int(face['silent']), *face['rotation'], *face['coefficients'].values())
";

fn python(script: &str, argument: &str) -> Output {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("python");
    let mut python = Command::new("python3");
    python.env("PYTHONPATH", folder).env("PYTHONDONTWRITEBYTECODE", "1");
    python.args(["-c", script, argument]).output().unwrap()
}

fn decode_with_python(bytes: &[u8]) -> Output {
    python(DECODE, &format!("{bytes:?}"))
}

#[test]
fn python_reads_every_field_that_rust_wrote() {
    let mut packet = Packet {
        state: State::Decay,
        reason: Reason::BadResult,
        neutral_face: NeutralFace::Calibrated,
        sequence: 65535,
        age_us: 123_400,
        capture_us: 0xFEDC_BA98,
        rotation: [0.0, -1.0, 1.0, 0.0],
        position_mm: [-1.0, 2.0, -30000.0],
        ..Packet::NEUTRAL
    };
    packet.coefficients[3] = 1.0;
    let covered = Visibility { left_eye: 0.0, brows: 0.4, ..Visibility::WHOLE };
    for visibility in [Visibility::WHOLE, covered] {
        packet.visibility = visibility;
        let output = decode_with_python(&packet.encode());
        let text = String::from_utf8(output.stdout).unwrap();
        let mut want = "decay\nbad result\ncalibrated\n65535\n123.4\n4275878552\n".to_owned();
        for (part, value) in visibility.parts() {
            writeln!(want, "{part} {}", 15.0 * value).unwrap();
        }
        want.push_str("0.0\n-1.0\n1.0\n0.0\n-1\n2\n-30000\n");
        for index in 0..BLENDSHAPES.len() {
            want.push_str(if index == 3 { "1.0\n" } else { "0.0\n" });
        }
        want.extend(BLENDSHAPES.iter().flat_map(|name| [name, "\n"]));
        assert_eq!(text, want, "{}", String::from_utf8_lossy(&output.stderr));
    }
}

#[test]
fn python_refuses_a_damaged_packet() {
    let mut bytes = Packet::NEUTRAL.encode();
    bytes[60] ^= 4;
    let output = decode_with_python(&bytes);
    assert!(String::from_utf8_lossy(&output.stderr).contains("ValueError: checksum"));
}

/// The packet with the nearest rotation whose length is 1, as senders send it. Python computes w from this.
fn with_unit_rotation(mut packet: Packet) -> Packet {
    let length = packet.rotation.iter().map(|component| component * component).sum::<f32>().sqrt();
    packet.rotation = packet.rotation.map(|component| component / length);
    Packet::decode(&packet.encode()).unwrap()
}

fn numbers(face: &Face) -> Vec<f32> {
    [f32::from(u8::from(face.is_silent))].into_iter().chain(face.rotation).chain(face.coefficients).collect()
}

#[test]
fn python_and_rust_show_the_same_face_in_random_sequences() {
    let mut random = Random(0x1234_5678);
    let mut receiver = Receiver::new(300);
    let (mut lines, mut answers) = (String::new(), Vec::new());
    let (mut now_ms, mut sequence) = (10_000, 65_000_u16);
    for _ in 0..4000 {
        now_ms += random.step(30).min(2000);
        sequence = sequence.wrapping_add(random.step(3) as u16);
        write!(lines, "{} ", f64::from(now_ms) / 1000.0).unwrap();
        if random.below(2) == 0 {
            let packet = with_unit_rotation(random.packet(sequence));
            packet.encode().iter().for_each(|byte| write!(lines, "{byte:02x}").unwrap());
            answers.push(vec![f32::from(u8::from(receiver.receive(&packet, now_ms)))]);
        } else {
            answers.push(numbers(&receiver.show(now_ms)));
        }
        lines.push('\n');
    }
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("python_receiver.txt");
    fs::write(&file, lines).unwrap();
    let output = python(RECEIVE, file.to_str().unwrap());
    let text = String::from_utf8(output.stdout).unwrap();
    assert_eq!(text.lines().count(), answers.len(), "{}", String::from_utf8_lossy(&output.stderr));
    for (index, (line, answer)) in text.lines().zip(&answers).enumerate() {
        let printed: Vec<f32> = line.split(' ').map(|number| number.parse().unwrap()).collect();
        // Near 0, w is the root of a small difference.
        let agree = printed.iter().zip(answer).all(|(one, other)| (one - other).abs() < 0.02);
        assert!(agree && printed.len() == answer.len(), "event {index}: {printed:?} instead of {answer:?}");
    }
    let some = |wanted: f32| answers.iter().any(|answer| answer.len() == 1 && answer[0] == wanted);
    let shown = |wanted: f32| answers.iter().any(|answer| answer.len() > 1 && answer[0] == wanted);
    assert!(some(0.0) && some(1.0) && shown(0.0) && shown(1.0));
}
