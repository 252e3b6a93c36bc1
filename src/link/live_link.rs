//! Live Link Face, packet version 6: what Unreal's plugins "Apple ARKit" and "Apple ARKit Face Support" read.
//!
//! One datagram carries the 52 coefficients in the order of facewire's packet, then the angles of the head and of both
//! eyes in radians: yaw to the person's right, pitch downwards, roll to the left shoulder. All numbers are big-endian.
//! When nobody is in the picture, the datagram ends after the subject's name, which receivers read as "no face".

use facewire_packet::State;

use super::{Format, Output, gaze::Gaze, head::Angles};
use crate::config::LiveLinkSettings;

const VERSION: u8 = 6;
/// The rate in which the time of a frame is counted.
const FRAMES_PER_S: i32 = 60;
/// Coefficients, and the angles of the head and of two eyes.
const VALUES: u8 = 61;
/// Bytes of a datagram without those of the two names.
const FIXED_BYTES: usize = 270;
/// How many neutral faces a receiver gets before it is told that there is no face. It keeps the last values that it got,
/// and a datagram may be lost.
const NEUTRAL_FACES: u8 = 3;

/// Datagrams of one subject.
#[derive(Debug)]
pub struct LiveLink {
    /// The datagram. Its beginning, up to the subject's name, stays the same.
    bytes: Vec<u8>,
    names_end: usize,
    swap_mouth: bool,
    gaze: Gaze,
    /// How many neutral faces are still to be sent.
    neutral_left: u8,
}

impl LiveLink {
    pub fn new(settings: &LiveLinkSettings) -> Self {
        let names = [settings.device_id.as_str(), settings.subject.as_str()];
        let mut bytes = Vec::with_capacity(FIXED_BYTES + names.iter().map(|name| name.len()).sum::<usize>());
        bytes.push(VERSION);
        for name in names {
            bytes.extend_from_slice(&u32::try_from(name.len()).unwrap_or(u32::MAX).to_be_bytes());
            bytes.extend_from_slice(name.as_bytes());
        }
        let (names_end, swap_mouth) = (bytes.len(), settings.swap_mouth);
        Self { bytes, names_end, swap_mouth, gaze: Gaze::default(), neutral_left: NEUTRAL_FACES }
    }

    /// Whether the receiver is to see a face.
    fn shows_face(&mut self, state: State) -> bool {
        let is_neutral = state == State::Neutral;
        let shows = !is_neutral || self.neutral_left > 0;
        self.neutral_left = if is_neutral { self.neutral_left.saturating_sub(1) } else { NEUTRAL_FACES };
        shows
    }

    fn frame(&mut self, output: &Output) {
        let (frame, part) = frame_time(output);
        self.bytes.extend_from_slice(&frame.to_be_bytes());
        self.bytes.extend_from_slice(&part.to_be_bytes());
        self.bytes.extend_from_slice(&FRAMES_PER_S.to_be_bytes());
        self.bytes.extend_from_slice(&1_i32.to_be_bytes());
        self.bytes.push(VALUES);
        let mut coefficients = output.pose.coefficients;
        if self.swap_mouth {
            swap_mouth(&mut coefficients);
        }
        self.gaze.follow(&coefficients);
        let angles = [Angles::of(output.pose.rotation), self.gaze.left, self.gaze.right].map(Angles::reversed);
        for value in coefficients.iter().chain(angles.as_flattened()) {
            self.bytes.extend_from_slice(&value.to_be_bytes());
        }
    }
}

impl Format for LiveLink {
    fn encode(&mut self, output: &Output, _sequence: u32, send: &mut dyn FnMut(&[u8])) {
        self.bytes.truncate(self.names_end);
        if self.shows_face(output.state) {
            self.frame(output);
        }
        send(&self.bytes);
    }
}

/// Returns the moment of the output on the monotonic clock, in frames and parts of a frame.
fn frame_time(output: &Output) -> (i32, f32) {
    let now_us = u128::from(output.capture_us.wrapping_add(output.age_us));
    let frames = now_us * u128::from(FRAMES_PER_S.unsigned_abs());
    // A board that runs for a year counts beyond the range, and begins at 0 again.
    let whole = frames / 1_000_000 % (1 << 31);
    (i32::try_from(whole).unwrap_or(0), (frames % 1_000_000) as f32 / 1e6)
}

/// Exchanges `mouthLeft` and `mouthRight`.
fn swap_mouth(coefficients: &mut [f32]) {
    if let Some([left, right]) = coefficients.get_mut(21..23) {
        std::mem::swap(left, right);
    }
}

#[cfg(test)]
#[allow(clippy::indexing_slicing, clippy::unwrap_used, clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::link::gaze::set;
    use crate::link::head::poses;
    use crate::link::output::test_output;

    /// The documented beginning of a datagram: the version, and the names of device and subject after their lengths.
    const NAMES: &[u8] = b"\x06\0\0\0\x24facewire-0000-0000-0000-000000000000\0\0\0\x04face";
    /// Frame 1002 (16.7 s), sub-frame 0, 60/1 frames a second, 61 values.
    const TIME: &[u8] = b"\0\0\x03\xea\0\0\0\0\0\0\0\x3c\0\0\0\x01\x3d";

    fn settings(swap_mouth: bool) -> LiveLinkSettings {
        let read = |text: &str| crate::config::parse("test", text).unwrap().links[0].kind.clone();
        let text = format!("[[link]]\nkind = \"live-link\"\nsubject = \"face\"\nswap_mouth = {swap_mouth}\n");
        let crate::config::LinkKind::LiveLink(settings) = read(&text) else { unreachable!() };
        settings
    }

    fn encoded(format: &mut LiveLink, output: &Output) -> Vec<u8> {
        let mut bytes = Vec::new();
        format.encode(output, 0, &mut |message| bytes.extend_from_slice(message));
        bytes
    }

    fn values(bytes: &[u8]) -> Vec<f32> {
        bytes[bytes.len() - 244..].as_chunks().0.iter().map(|value| f32::from_be_bytes(*value)).collect()
    }

    #[test]
    fn a_datagram_has_the_documented_bytes() {
        let mut output = test_output(State::Live);
        (output.capture_us, output.age_us) = (16_600_000, 100_000);
        set(&mut output.pose.coefficients, &[("eyeBlinkLeft", 0.5), ("tongueOut", 1.0)]);
        let bytes = encoded(&mut LiveLink::new(&settings(false)), &output);
        assert_eq!((bytes.len(), &bytes[..66]), (310, &[NAMES, TIME].concat()[..]));
        let values = values(&bytes);
        assert_eq!((values[0], values[17], values[51], values[52..].to_vec()), (0.5, 0.0, 1.0, vec![0.0; 9]));
    }

    #[test]
    fn head_and_eyes_turn_positive_to_the_right_down_and_to_the_left_shoulder() {
        let mut format = LiveLink::new(&settings(false));
        let mut angles = |rotation, look: &[(&str, f32)]| {
            let mut output = test_output(State::Live);
            output.pose.rotation = rotation;
            set(&mut output.pose.coefficients, look);
            let values = values(&encoded(&mut format, &output));
            values[52..].iter().map(|angle| angle.to_degrees().round()).collect::<Vec<_>>()
        };
        let left = [("eyeLookOutLeft", 1.0), ("eyeLookInRight", 1.0)];
        assert_eq!(angles(poses::LEFT, &left), [-30.0, 0.0, 0.0, -35.0, 0.0, 0.0, -35.0, 0.0, 0.0]);
        let down = [("eyeLookDownLeft", 1.0), ("eyeLookDownRight", 1.0)];
        assert_eq!(angles(poses::DOWN, &down), [0.0, 20.0, 0.0, 0.0, 35.0, 0.0, 0.0, 35.0, 0.0]);
        assert_eq!(angles(poses::TILTED, &[])[..3], [0.0, 0.0, -10.0]);
    }

    #[test]
    fn without_a_face_the_datagram_ends_after_the_name_once_neutral_faces_were_sent() {
        let mut format = LiveLink::new(&settings(false));
        let states = [State::Live, State::Decay].into_iter().chain([State::Neutral; 5]).chain([State::Live]);
        let lengths: Vec<_> = states.map(|state| encoded(&mut format, &test_output(state)).len()).collect();
        assert_eq!(lengths, [310, 310, 310, 310, 310, 49, 49, 310]);
    }

    #[test]
    fn the_sides_of_the_mouth_can_be_exchanged() {
        let mut output = test_output(State::Live);
        set(&mut output.pose.coefficients, &[("mouthLeft", 0.25), ("mouthRight", 0.5)]);
        let mouth = |swap| values(&encoded(&mut LiveLink::new(&settings(swap)), &output))[21..23].to_vec();
        assert_eq!((mouth(false), mouth(true)), (vec![0.25, 0.5], vec![0.5, 0.25]));
    }
}
