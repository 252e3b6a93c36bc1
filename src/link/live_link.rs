//! Live Link Face, packet version 6: what Unreal's plugins "Apple ARKit" and "Apple ARKit Face Support" read.
//!
//! One datagram carries the 52 coefficients in the order of facewire's packet, then the angles of the head and of both
//! eyes in radians: yaw to the person's right, pitch downwards, roll to the left shoulder. All numbers are big-endian.
//! When nobody is in the picture, the datagram ends after the subject's name, which receivers read as "no face".

use facewire_packet::State;

use super::angles::Angles;
use super::{Encoder, Output};
use crate::config::LiveLinkSettings;

const VERSION: u8 = 6;
const FRAMES_PER_S: i32 = 60;
const VALUES: u8 = 61;
const FIXED_BYTES: usize = 270;
/// Bytes of a datagram that every receiver reads: some accept no other length.
const USUAL_BYTES: usize = 312;
/// The place of `mouthLeft` among the coefficients; `mouthRight` follows it.
const MOUTH_LEFT: usize = 21;
/// How many neutral faces a receiver gets before it is told that there is no face. It keeps the last values that it got,
/// and a datagram may be lost.
const NEUTRAL_FACES: u8 = 3;

/// Returns what `facewire check` says about names with which some receivers do not read the datagrams.
pub fn note(settings: &LiveLinkSettings) -> Option<String> {
    let bytes = FIXED_BYTES + settings.device_id.len() + settings.subject.len();
    let sentence = format!(
        "the datagrams have {bytes} bytes; a receiver that reads only {USUAL_BYTES}, as a module of VRCFaceTracking may, \
         needs a subject of 6 characters"
    );
    (bytes != USUAL_BYTES).then_some(sentence)
}

pub fn encoder(settings: &LiveLinkSettings) -> Encoder {
    let mut bytes = vec![VERSION];
    for name in [&settings.device_id, &settings.subject] {
        bytes.extend_from_slice(&u32::try_from(name.len()).unwrap_or(u32::MAX).to_be_bytes());
        bytes.extend_from_slice(name.as_bytes());
    }
    bytes.reserve(FIXED_BYTES);
    let (names_end, swap_mouth, mut neutral_left) = (bytes.len(), settings.swap_mouth, NEUTRAL_FACES);
    Box::new(move |output, gaze, _sequence, send| {
        bytes.truncate(names_end);
        let is_neutral = output.state == State::Neutral;
        if !is_neutral || neutral_left > 0 {
            let (frame, part) = frame_time(output);
            let time = [frame.to_be_bytes(), part.to_be_bytes(), FRAMES_PER_S.to_be_bytes(), 1_i32.to_be_bytes()];
            bytes.extend_from_slice(time.as_flattened());
            bytes.push(VALUES);
            let mut coefficients = output.pose.coefficients;
            if swap_mouth {
                coefficients.swap(MOUTH_LEFT, MOUTH_LEFT + 1);
            }
            let angles = [Angles::of(output.pose.rotation), gaze.left, gaze.right].map(Angles::reversed);
            let values = coefficients.iter().chain(angles.as_flattened());
            bytes.extend(values.flat_map(|value| value.to_be_bytes()));
        }
        neutral_left = if is_neutral { neutral_left.saturating_sub(1) } else { NEUTRAL_FACES };
        send(&bytes);
    })
}

/// Returns the moment of the output on the monotonic clock, in frames and parts of a frame.
fn frame_time(output: &Output) -> (i32, f32) {
    let now_us = u128::from(output.capture_us.wrapping_add(output.age_us));
    let frames = now_us * u128::from(FRAMES_PER_S.unsigned_abs());
    // A board that runs for a year counts beyond the range, and begins at 0 again.
    let whole = frames / 1_000_000 % (1 << 31);
    (i32::try_from(whole).unwrap_or(0), (frames % 1_000_000) as f32 / 1e6)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{LinkKind, parse};
    use crate::link::test_output;
    use crate::link::testing::{encoded, face, kind};

    /// The documented beginning of a datagram: the version, and the names of device and subject after their lengths.
    const NAMES: &[u8] = b"\x06\0\0\0\x24facewire-0000-0000-0000-000000000000\0\0\0\x04face";
    /// Frame 1002 (16.7 s), sub-frame 0, 60/1 frames a second, 61 values.
    const TIME: &[u8] = b"\0\0\x03\xea\0\0\0\0\0\0\0\x3c\0\0\0\x01\x3d";

    fn open(keys: &str) -> Encoder {
        let keys = format!("subject = \"face\"\n{keys}");
        let LinkKind::LiveLink(settings) = kind("live-link", &keys) else { unreachable!() };
        encoder(&settings)
    }

    #[test]
    fn a_datagram_has_the_documented_bytes_and_the_sides_of_the_mouth_can_be_exchanged() {
        let mut output = face(&[("eyeBlinkLeft", 0.5), ("tongueOut", 1.0), ("mouthLeft", 0.25)]);
        (output.capture_us, output.age_us) = (16_600_000, 100_000);
        for (keys, [left, right]) in [("", [0.25, 0.0]), ("swap_mouth = true\n", [0.0, 0.25])] {
            let mut want = [0.0; 61];
            (want[0], want[21], want[22], want[51]) = (0.5, left, right, 1.0);
            let bytes = encoded(&mut open(keys), &output).concat();
            let (begin, values) = bytes.split_at(NAMES.len() + TIME.len());
            assert_eq!(begin, [NAMES, TIME].concat());
            assert_eq!(values, want.map(f32::to_be_bytes).as_flattened());
        }
    }

    #[test]
    fn the_default_names_make_datagrams_of_312_bytes_and_check_tells_of_others() {
        let bytes = encoded(&mut encoder(&LiveLinkSettings::default()), &face(&[])).concat();
        assert_eq!((bytes.len(), note(&LiveLinkSettings::default())), (312, None));
        let settings = parse("test", "[[link]]\nkind = \"live-link\"\nsubject = \"facewire\"\n").unwrap();
        let notes = crate::link::notes(&settings).concat();
        assert!(notes.contains("the datagrams have 314 bytes") && notes.contains("6 characters"), "{notes}");
    }

    #[test]
    fn without_a_face_the_datagram_ends_after_the_name_once_neutral_faces_were_sent() {
        let mut format = open("");
        let states = [State::Live, State::Decay].into_iter().chain([State::Neutral; 5]).chain([State::Live]);
        let lengths = states.map(|state| encoded(&mut format, &test_output(state)).concat().len());
        assert_eq!(lengths.collect::<Vec<_>>(), [310, 310, 310, 310, 310, NAMES.len(), NAMES.len(), 310]);
    }
}
