//! The decoder of the device tests, written from the table alone, reads what the crate encodes.
#![allow(clippy::unwrap_used, clippy::float_cmp)]

use std::{
    path::Path,
    process::{Command, Output},
};

use facewire_packet::{BLENDSHAPES, Packet, Reason, State};

/// Prints every field of a packet given in hexadecimal, one a line.
const SCRIPT: &str = "
import sys
import packet_decoder as d
p = d.decode(bytes.fromhex(sys.argv[1]))
for key in ('state', 'reason', 'sequence', 'age_ms', 'capture_us'):
    print(p[key])
for value in (*p['rotation'], *p['position_mm'], *p['coefficients'], *d.NAMES):
    print(value)
";

/// Runs the script, or says that it cannot and gives `None`.
fn decoded_by_python(bytes: &[u8]) -> Option<Output> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests");
    let hex: String = bytes.iter().flat_map(|byte| [byte >> 4, byte & 15]).map(hex_digit).collect();
    if !folder.join("packet_decoder.py").exists() {
        eprintln!("skipped: tests/packet_decoder.py is not beside the package");
        return None;
    }
    let run = Command::new("python3")
        .env("PYTHONPATH", folder)
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .args(["-c", SCRIPT, &hex])
        .output();
    run.inspect_err(|error| eprintln!("skipped: no python3 ({error})")).ok()
}

fn hex_digit(digit: u8) -> char {
    char::from_digit(digit.into(), 16).unwrap()
}

#[test]
fn python_reads_every_field_that_rust_wrote() {
    let mut packet = Packet {
        state: State::Decay,
        reason: Reason::BadResult,
        sequence: 65535,
        age_us: 123_400,
        capture_us: 0xFEDC_BA98,
        rotation: [0.0, -1.0, 1.0, 0.0],
        position_mm: [-1.0, 2.0, -30000.0],
        ..Packet::NEUTRAL
    };
    packet.coefficients[17] = 1.0;
    let Some(output) = decoded_by_python(&packet.encode()) else { return };
    let text = String::from_utf8(output.stdout).unwrap();
    let mut want = "decay\nbad result\n65535\n123.4\n4275878552\n0.0\n-1.0\n1.0\n0.0\n-1\n2\n-30000\n".to_owned();
    for index in 0..BLENDSHAPES.len() {
        want.push_str(if index == 17 { "1.0\n" } else { "0.0\n" });
    }
    want.extend(BLENDSHAPES.iter().flat_map(|name| [name, "\n"]));
    assert_eq!(text, want, "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn python_refuses_what_was_damaged() {
    let mut bytes = Packet::NEUTRAL.encode();
    bytes[60] ^= 4;
    let Some(output) = decoded_by_python(&bytes) else { return };
    assert!(String::from_utf8_lossy(&output.stderr).contains("ValueError: checksum"));
}
