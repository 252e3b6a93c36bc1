//! iFacialMocap, versions 1 and 2: text that the iPhone app of this name streams to whoever asks for it.
//!
//! One datagram has the coefficients as whole percent, then the rotation of the head (degrees) with its position (metres,
//! in the camera's axes: x right in the picture, y up, z towards the camera), and the rotations of the right and of the left
//! eye. The axes are those of `ARKit`'s face: positive are down, to the person's left, and to the right shoulder. The
//! versions differ in the character between a name and its value: `-` in version 1, `&` in version 2.

use std::io::{self, Write as _};

use super::angles::{Angles, Gaze};
use crate::{BLENDSHAPES, Packet};

/// Longest text, bytes.
pub const LONGEST: usize = 2048;
/// What a receiver sends to ask for the stream.
pub const REQUEST: &[u8] = b"iFacialMocap_sahuasouryya9218sauhuiayeta91555dy3719";
/// What follows the request if the receiver wants version 2.
const SECOND: &[u8] = b"|sendDataVersion=v2";

/// Writes the text of one version.
#[derive(Debug)]
pub struct IFacialMocap {
    /// The names of the blendshapes, each with the character that follows it.
    names: [String; BLENDSHAPES.len()],
    text: Vec<u8>,
    gaze: Gaze,
}

impl IFacialMocap {
    /// Makes the format of version 1 or 2.
    #[must_use]
    pub fn new(version: u32) -> Self {
        let separator = char::from(separator(version));
        let names = BLENDSHAPES.map(|name| format!("{}{separator}", short(name)));
        Self { names, text: Vec::with_capacity(LONGEST), gaze: Gaze::default() }
    }

    /// Sends the packet as one datagram.
    pub fn encode(&mut self, packet: &Packet, send: &mut dyn FnMut(&[u8])) {
        self.gaze.follow(&packet.coefficients);
        self.text.clear();
        if self.write(packet).is_ok() {
            send(&self.text);
        }
    }

    fn write(&mut self, packet: &Packet) -> io::Result<()> {
        let Self { names, text, gaze } = self;
        for (name, value) in names.iter().zip(packet.coefficients) {
            write!(text, "{name}{:.0}|", 100.0 * value)?;
        }
        let [right_mm, down_mm, away_mm] = packet.position_mm;
        let [x, y, z] = [right_mm, 0.0 - down_mm, 0.0 - away_mm].map(|mm| 0.001 * mm);
        write_angles(text, "=head", Angles::of(packet.rotation))?;
        write!(text, ",{x:.4},{y:.4},{z:.4}")?;
        write_angles(text, "|rightEye", gaze.right)?;
        write_angles(text, "|leftEye", gaze.left)?;
        text.write_all(b"|")
    }
}

fn write_angles(text: &mut Vec<u8>, name: &str, angles: Angles) -> io::Result<()> {
    let [x, y, z] = [0.0 - angles.pitch, angles.yaw, angles.roll].map(f32::to_degrees);
    write!(text, "{name}#{x:.3},{y:.3},{z:.3}")
}

/// Returns the app's name of a blendshape: `_L` and `_R` for `Left` and `Right` where a blendshape has two sides.
fn short(name: &str) -> String {
    let is_direction = ["jawLeft", "jawRight", "mouthLeft", "mouthRight"].contains(&name);
    let ending = |ending, short: &str| name.strip_suffix(ending).map(|stem| format!("{stem}{short}"));
    let short = ending("Left", "_L").or_else(|| ending("Right", "_R"));
    short.filter(|_| !is_direction).unwrap_or_else(|| name.to_owned())
}

/// Reads a request for version 1 or 2 of the text. Returns `None` for anything else. An unknown ending after `|` means
/// version 1, as for the app.
#[must_use]
pub fn request(datagram: &[u8]) -> Option<u32> {
    let ending = datagram.strip_prefix(REQUEST)?;
    // Some receivers fill a buffer of fixed size with zeros.
    let is_filling = |byte: &u8| *byte == 0 || byte.is_ascii_whitespace();
    let end = ending.iter().rposition(|byte| !is_filling(byte)).map_or(0, |last| last + 1);
    match ending.get(..end)? {
        SECOND => Some(2),
        [] | [b'|', ..] => Some(1),
        _ => None,
    }
}

/// The character between a name and its value.
const fn separator(version: u32) -> u8 {
    if version == 1 { b'-' } else { b'&' }
}

/// Turns a text of either version into this one.
pub fn set_version(text: &mut [u8], version: u32) {
    for entry in text.split_mut(|byte| *byte == b'|').take_while(|entry| !entry.starts_with(b"=")) {
        // A later `-` is the sign of a value.
        if let Some(byte) = entry.iter_mut().find(|byte| matches!(byte, b'-' | b'&')) {
            *byte = separator(version);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::super::testing::{LEFT, face, sent};
    use super::*;

    #[test]
    fn a_frame_names_blendshapes_as_the_app_does_and_then_head_and_eyes_and_no_network_divides_it() {
        let look = [("eyeLookInRight", 1.0), ("eyeLookDownLeft", 1.0), ("mouthSmileRight", 0.126), ("jawLeft", 1.0)];
        let packet = Packet { rotation: LEFT, position_mm: [100.0, 50.0, 600.0], ..face(&look) };
        let mut format = IFacialMocap::new(2);
        let mut text = |packet: &Packet| String::from_utf8(sent(|send| format.encode(packet, send)).concat()).unwrap();
        let frame = text(&packet);
        let end =
            "|=head#0.000,30.000,0.000,0.1000,-0.0500,-0.6000|rightEye#0.000,35.000,0.000|leftEye#35.000,0.000,0.000|";
        for part in ["|mouthSmile_R&13|", "eyeBlink_L&0|", "|jawLeft&100|", "|browInnerUp&0|", "|mouthRight&0|", end] {
            assert!(frame.contains(part), "{part} in {frame}");
        }
        assert_eq!(frame.matches('&').count(), 52);
        assert!(text(&Packet { coefficients: [1.0; 52], position_mm: [-30_000.0; 3], ..packet }).len() < 1400);
    }

    #[test]
    fn only_the_apps_own_request_is_answered() {
        let endings = ["", "\n\0\0\0", "|sendDataVersion=v2", "|sendDataVersion=v2\0\0\0", "|sendDataVersion=v3", "x"];
        let versions = endings.map(|ending| request(&[REQUEST, ending.as_bytes()].concat()));
        assert_eq!(versions, [Some(1), Some(1), Some(2), Some(2), Some(1), None]);
        let other = [b"iFacialMocap_UDPTCP_", REQUEST.get(13..).unwrap()].concat();
        assert_eq!([b"iFacialMocap_", &other[..]].map(request), [None; 2]);
    }
}
