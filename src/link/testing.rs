//! Help for the tests of links.
#![allow(clippy::unwrap_used)]

use std::thread;
use std::time::{Duration, Instant};

use facewire_packet::{BLENDSHAPES, State};

use super::{Format, Output, output::test_output};

/// Longer than any step takes on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(10);

/// Rotations of a head that does one thing, unit quaternions x, y, z, w: 30 degrees to the person's left,
pub const LEFT: [f32; 4] = [0.0, 0.258_819, 0.0, 0.965_926];
/// 20 degrees down,
pub const DOWN: [f32; 4] = [0.173_648, 0.0, 0.0, 0.984_808];
/// and 10 degrees to the right shoulder.
pub const TILTED: [f32; 4] = [0.0, 0.0, 0.087_156, 0.996_195];

/// Returns a live output that faces the camera with these coefficients.
pub fn face(look: &[(&str, f32)]) -> Output {
    let mut output = test_output(State::Live);
    for (name, value) in look {
        let index = BLENDSHAPES.iter().position(|known| known == name).unwrap();
        output.pose.coefficients[index] = *value;
    }
    output
}

/// Returns a live output that turns the head in this way.
pub fn turned(rotation: [f32; 4]) -> Output {
    let mut output = face(&[]);
    output.pose.rotation = rotation;
    output
}

/// Returns the messages that the format makes of an output.
pub fn encoded(format: &mut dyn Format, output: &Output) -> Vec<Vec<u8>> {
    let mut messages = Vec::new();
    format.encode(output, 7, &mut |bytes| messages.push(bytes.to_vec()));
    messages
}

/// Waits until it happens, and fails if it does not.
pub fn eventually(what: &str, mut happens: impl FnMut() -> bool) {
    let end = Instant::now() + PATIENCE;
    while !happens() {
        assert!(Instant::now() < end, "{what}");
        thread::sleep(Duration::from_millis(1));
    }
}

pub fn near(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3)
}
