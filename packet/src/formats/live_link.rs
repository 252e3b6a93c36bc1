//! Live Link Face, packet version 6: what Unreal's plugins "Apple ARKit" and "Apple ARKit Face Support" read.
//!
//! One datagram carries the 52 coefficients in the order of facewire's packet, then the angles of the head and of both
//! eyes in radians: yaw to the person's right, pitch downwards, roll to the left shoulder. All numbers are big-endian. The time of a
//! datagram is the time of day as a timecode of 60 frames a second, as the app's is, so that recorders find what belongs together.
//! When nobody is in the picture, the datagram ends after the subject's name, which receivers read as "no face".

use super::angles::{Angles, Gaze};
use crate::{Packet, State};

const VERSION: u8 = 6;
const FRAMES_PER_S: i32 = 60;
const DAY_US: u64 = 86_400_000_000;
const VALUES: u8 = 61;
const FIXED_BYTES: usize = 270;
/// Bytes of a datagram that every receiver reads: some accept no other length.
const USUAL_BYTES: usize = 312;
/// The place of `mouthLeft` among the coefficients; `mouthRight` follows it.
const MOUTH_LEFT: usize = 21;
/// How many neutral faces a receiver gets before it is told that there is no face. It keeps the last values that it got,
/// and a datagram may be lost.
const NEUTRAL_FACES: u8 = 3;

/// Writes the datagrams of one subject.
#[derive(Debug)]
pub struct LiveLink {
    /// The beginning, which is the same in all datagrams, and what followed it in the last one.
    bytes: Vec<u8>,
    names_end: usize,
    swap_mouth: bool,
    neutral_left: u8,
    gaze: Gaze,
}

impl LiveLink {
    /// Makes the format for this device and subject. `swap_mouth` exchanges `mouthLeft` and `mouthRight`.
    #[must_use]
    pub fn new(device_id: &str, subject: &str, swap_mouth: bool) -> Self {
        let mut bytes = vec![VERSION];
        for name in [device_id, subject] {
            bytes.extend_from_slice(&u32::try_from(name.len()).unwrap_or(u32::MAX).to_be_bytes());
            bytes.extend_from_slice(name.as_bytes());
        }
        bytes.reserve(FIXED_BYTES);
        Self { names_end: bytes.len(), bytes, swap_mouth, neutral_left: NEUTRAL_FACES, gaze: Gaze::default() }
    }

    /// Returns a warning if these names make datagrams of a length that some receivers do not read.
    #[must_use]
    pub fn note_of_names(device_id: &str, subject: &str) -> Option<String> {
        let (bytes, usual) = (datagram_bytes(device_id, subject), USUAL_BYTES);
        let sentence = format!(
            "the datagrams have {bytes} bytes; a receiver that reads only {usual}, as a module of VRCFaceTracking may, \
             needs a subject of 6 characters"
        );
        (bytes != usual).then_some(sentence)
    }

    /// Sends the packet as one datagram. `now_us` is the local time since midnight, of any day, in microseconds.
    pub fn encode(&mut self, packet: &Packet, now_us: u64, send: &mut dyn FnMut(&[u8])) {
        let Self { bytes, gaze, .. } = self;
        gaze.follow(&packet.coefficients);
        bytes.truncate(self.names_end);
        let is_neutral = packet.state == State::Neutral;
        if !is_neutral || self.neutral_left > 0 {
            let (frame, part) = frame_time(now_us);
            let time = [frame.to_be_bytes(), part.to_be_bytes(), FRAMES_PER_S.to_be_bytes(), 1_i32.to_be_bytes()];
            bytes.extend_from_slice(time.as_flattened());
            bytes.push(VALUES);
            let mut coefficients = packet.coefficients;
            if self.swap_mouth {
                coefficients.swap(MOUTH_LEFT, MOUTH_LEFT + 1);
            }
            let angles = [Angles::of(packet.rotation), gaze.left, gaze.right].map(Angles::reversed);
            let values = coefficients.iter().chain(angles.as_flattened());
            bytes.extend(values.flat_map(|value| value.to_be_bytes()));
        }
        self.neutral_left = if is_neutral { self.neutral_left.saturating_sub(1) } else { NEUTRAL_FACES };
        send(bytes);
    }
}

/// Returns the time of day in frames and parts of a frame.
fn frame_time(now_us: u64) -> (i32, f32) {
    let frames = now_us % DAY_US * u64::from(FRAMES_PER_S.unsigned_abs());
    (i32::try_from(frames / 1_000_000).unwrap_or(0), (frames % 1_000_000) as f32 / 1e6)
}

/// Returns the bytes of a datagram with a face.
const fn datagram_bytes(device_id: &str, subject: &str) -> usize {
    FIXED_BYTES + device_id.len() + subject.len()
}

#[cfg(test)]
mod tests {
    use super::super::testing::{face, sent};
    use super::*;

    const DEVICE: &str = "facewire-0000-0000-0000-000000000000";
    /// The documented beginning of a datagram: the version, and the names of device and subject after their lengths.
    const NAMES: &[u8] = b"\x06\0\0\0\x24facewire-0000-0000-0000-000000000000\0\0\0\x04face";
    /// Frame 1002 (16.7 s), sub-frame 0, 60/1 frames a second, 61 values.
    const TIME: &[u8] = b"\0\0\x03\xea\0\0\0\0\0\0\0\x3c\0\0\0\x01\x3d";

    fn datagram(format: &mut LiveLink, packet: &Packet) -> Vec<u8> {
        sent(|send| format.encode(packet, 16_700_000, send)).concat()
    }

    #[test]
    fn a_datagram_has_the_documented_bytes_and_the_sides_of_the_mouth_can_be_exchanged() {
        let packet = face(&[("eyeBlinkLeft", 0.5), ("tongueOut", 1.0), ("mouthLeft", 0.25)]);
        for (swap_mouth, [left, right]) in [(false, [0.25, 0.0]), (true, [0.0, 0.25])] {
            let mut want = [0.0; 61];
            (want[0], want[21], want[22], want[51]) = (0.5, left, right, 1.0);
            let bytes = datagram(&mut LiveLink::new(DEVICE, "face", swap_mouth), &packet);
            assert_eq!(bytes.len(), datagram_bytes(DEVICE, "face"));
            let (begin, values) = bytes.split_at(NAMES.len() + TIME.len());
            assert_eq!(begin, [NAMES, TIME].concat());
            assert_eq!(values, want.map(f32::to_be_bytes).as_flattened());
        }
    }

    #[test]
    fn the_frame_counts_from_midnight_to_midnight() {
        let day = i32::try_from(DAY_US / 1_000_000).unwrap_or(0) * FRAMES_PER_S;
        for (us, want) in [
            (0, (0, 0.0)),
            (12_345, (0, 0.7407)),
            (DAY_US - 1, (day - 1, 0.99994)),
            (DAY_US, (0, 0.0)),
            (20_000 * DAY_US + 16_700_000, (1002, 0.0)),
            (u64::MAX, frame_time(u64::MAX % DAY_US)),
        ] {
            assert_eq!(frame_time(us), want, "{us}");
        }
    }

    #[test]
    fn without_a_face_the_datagram_ends_after_the_name_once_neutral_faces_were_sent() {
        let mut format = LiveLink::new(DEVICE, "face", false);
        let states = [State::Live, State::Decay].into_iter().chain([State::Neutral; 5]).chain([State::Live]);
        let lengths = states.map(|state| datagram(&mut format, &Packet { state, ..Packet::NEUTRAL }).len());
        assert_eq!(lengths.collect::<Vec<_>>(), [310, 310, 310, 310, 310, NAMES.len(), NAMES.len(), 310]);
    }
}
