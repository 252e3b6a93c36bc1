//! `tests/packet_decoder.py`, which was written from the packet's table alone, reads what the crate encodes.
#![allow(clippy::unwrap_used, clippy::float_cmp)]

use std::path::Path;
use std::process::{Command, Output};

use facewire_packet::{BLENDSHAPES, NeutralFace, Packet, Reason, State};

/// Prints every field of a packet, which is given as a JSON list of its bytes, one field a line.
const SCRIPT: &str = "
import json, sys
import packet_decoder as d
p = d.decode(bytes(json.loads(sys.argv[1])))
for key in ('state', 'reason', 'neutral_face', 'sequence', 'age_ms', 'capture_us'):
    print(p[key])
for value in (*p['rotation'], *p['position_mm'], *p['coefficients'], *d.NAMES):
    print(value)
";

fn decode_with_python(bytes: &[u8]) -> Output {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    let mut python = Command::new("python3");
    python.env("PYTHONPATH", folder).env("PYTHONDONTWRITEBYTECODE", "1");
    python.args(["-c", SCRIPT, &format!("{bytes:?}")]).output().unwrap()
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
    packet.coefficients[17] = 1.0;
    let output = decode_with_python(&packet.encode());
    let text = String::from_utf8(output.stdout).unwrap();
    let mut want =
        "decay\nbad result\ncalibrated\n65535\n123.4\n4275878552\n0.0\n-1.0\n1.0\n0.0\n-1\n2\n-30000\n".to_owned();
    for index in 0..BLENDSHAPES.len() {
        want.push_str(if index == 17 { "1.0\n" } else { "0.0\n" });
    }
    want.extend(BLENDSHAPES.iter().flat_map(|name| [name, "\n"]));
    assert_eq!(text, want, "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn python_refuses_a_damaged_packet() {
    let mut bytes = Packet::NEUTRAL.encode();
    bytes[60] ^= 4;
    let output = decode_with_python(&bytes);
    assert!(String::from_utf8_lossy(&output.stderr).contains("ValueError: checksum"));
}
