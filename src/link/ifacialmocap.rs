//! iFacialMocap, versions 1 and 2: text that the iPhone app of this name streams to whoever asks for it.
//!
//! One datagram has the coefficients as whole percent, then the rotation of the head (degrees) with its position (metres,
//! in the camera's axes: x right in the picture, y up, z towards the camera), and the rotations of the right and of the left
//! eye. The axes are those of ARKit's face: positive are down, to the person's left, and to the right shoulder. The
//! versions differ in the sign between a name and its value: `-` in version 1, `&` in version 2. The format writes
//! version 2; the carrier makes version 1 of it for those who ask for that.

mod subscribers;

use std::io::Write as _;

use facewire_packet::BLENDSHAPES;

pub use self::subscribers::{Subscribers, request};
use super::{
    Format, Output,
    angles::{Angles, Gaze},
};

/// Room for one datagram.
const LONGEST: usize = 2048;

/// Datagrams of version 2.
#[derive(Debug)]
pub struct IFacialMocap {
    names: Vec<String>,
    text: Vec<u8>,
    gaze: Gaze,
}

impl IFacialMocap {
    pub fn new() -> Self {
        let names = BLENDSHAPES.iter().map(|name| short(name)).collect();
        Self { names, text: Vec::with_capacity(LONGEST), gaze: Gaze::default() }
    }

    /// Writes the text. Writing to memory does not fail.
    fn write(&mut self, output: &Output) -> std::io::Result<()> {
        self.gaze.follow(&output.pose.coefficients);
        let text = &mut self.text;
        text.clear();
        for (name, value) in self.names.iter().zip(output.pose.coefficients) {
            write!(text, "{name}&{:.0}|", 100.0 * value)?;
        }
        let [right_mm, down_mm, away_mm] = output.pose.position_mm;
        let [x, y, z] = [right_mm, 0.0 - down_mm, 0.0 - away_mm].map(|mm| 0.001 * mm);
        let [head, right, left] = [Angles::of(output.pose.rotation), self.gaze.right, self.gaze.left].map(degrees);
        write!(text, "=head#{:.3},{:.3},{:.3},{x:.4},{y:.4},{z:.4}|", head[0], head[1], head[2])?;
        write!(text, "rightEye#{:.3},{:.3},{:.3}|", right[0], right[1], right[2])?;
        write!(text, "leftEye#{:.3},{:.3},{:.3}|", left[0], left[1], left[2])
    }
}

impl Format for IFacialMocap {
    fn encode(&mut self, output: &Output, _sequence: u32, send: &mut dyn FnMut(&[u8])) {
        if self.write(output).is_ok() {
            send(&self.text);
        }
    }
}

/// Rotation about the axes x, y and z.
fn degrees(angles: Angles) -> [f32; 3] {
    [0.0 - angles.pitch, angles.yaw, angles.roll].map(f32::to_degrees)
}

/// Returns the app's name of a blendshape: `_L` and `_R` for `Left` and `Right` where a blendshape has two sides.
fn short(name: &str) -> String {
    let is_direction = ["jawLeft", "jawRight", "mouthLeft", "mouthRight"].contains(&name);
    let ending = |ending, short: &str| name.strip_suffix(ending).map(|stem| format!("{stem}{short}"));
    let short = ending("Left", "_L").or_else(|| ending("Right", "_R"));
    short.filter(|_| !is_direction).unwrap_or_else(|| name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::testing::{DOWN, LEFT, TILTED, encoded, face, near, turned};

    fn text(output: &Output) -> String {
        String::from_utf8(encoded(&mut IFacialMocap::new(), output).remove(0)).unwrap()
    }

    /// Returns the numbers after `NAME#`.
    fn numbers(output: &Output, name: &str) -> Vec<f32> {
        let text = text(output);
        let (_, rest) = text.split_once(&format!("{name}#")).unwrap();
        rest.split_once('|').unwrap().0.split(',').map(|number| number.parse().unwrap()).collect()
    }

    #[test]
    fn a_frame_names_every_blendshape_as_the_app_does_and_ends_with_the_eyes() {
        let text = text(&face(&[("mouthSmileRight", 0.126), ("jawLeft", 1.0), ("browInnerUp", 0.5)]));
        for part in ["mouthSmile_R&13|", "jawLeft&100|", "browInnerUp&50|", "eyeBlink_L&0|", "mouthRight&0|"] {
            assert!(text.contains(part), "{part} in {text}");
        }
        assert_eq!(text.matches('&').count(), 52);
        let end = "=head#0.000,0.000,0.000,0.0000,0.0000,0.0000|rightEye#0.000,0.000,0.000|leftEye#0.000,0.000,0.000|";
        assert!(text.ends_with(end), "{text}");
    }

    #[test]
    fn head_and_eyes_turn_about_the_axes_of_arkit() {
        let mut left = turned(LEFT);
        left.pose.position_mm = [100.0, 50.0, 600.0];
        let look = face(&[("eyeLookInRight", 1.0), ("eyeLookDownLeft", 1.0)]);
        for (output, name, want) in [
            (&left, "head", &[0.0, 30.0, 0.0, 0.1, -0.05, -0.6][..]),
            (&turned(DOWN), "head", &[20.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
            (&turned(TILTED), "head", &[0.0, 0.0, 10.0, 0.0, 0.0, 0.0]),
            (&look, "rightEye", &[0.0, 35.0, 0.0]),
            (&look, "leftEye", &[35.0, 0.0, 0.0]),
        ] {
            assert!(near(&numbers(output, name), want), "{:?} {want:?}", numbers(output, name));
        }
    }

    #[test]
    fn the_longest_frame_fits() {
        let mut output = face(&[]);
        (output.pose.coefficients, output.pose.position_mm) = ([1.0; 52], [-30_000.0; 3]);
        assert!(text(&output).len() < 1400, "no network divides it");
    }
}
