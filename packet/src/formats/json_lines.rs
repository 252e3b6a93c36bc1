//! JSON lines: one object a line, for programs that need no more than a parser of JSON. `docs/code.md` describes the
//! fields.

use serde::ser::SerializeMap as _;
use serde::{Serialize, Serializer};

use super::angles::{Angles, Gaze};
use crate::{BLENDSHAPES, Packet, yaw_pitch_roll_deg};

const LONGEST: usize = 2048;

/// Writes and counts lines.
#[derive(Debug)]
pub struct JsonLines {
    sequence: u32,
    line: Vec<u8>,
    gaze: Gaze,
}

impl Default for JsonLines {
    fn default() -> Self {
        Self { sequence: 0, line: Vec::with_capacity(LONGEST), gaze: Gaze::default() }
    }
}

#[derive(Serialize)]
struct Head {
    yaw_deg: f64,
    pitch_deg: f64,
    roll_deg: f64,
    rotation_xyzw: [f64; 4],
    position_mm: [f64; 3],
}

impl JsonLines {
    /// Sends the packet as a line. Its sequence, age and capture time do not wrap, unlike those of the packet. The age is
    /// `None` before the first pose.
    pub fn encode(&mut self, packet: &Packet, age_us: Option<u64>, capture_us: u64, send: &mut dyn FnMut(&[u8])) {
        self.gaze.follow(&packet.coefficients);
        self.line.clear();
        if self.write(packet, age_us, capture_us).is_ok() {
            self.line.push(b'\n');
            send(&self.line);
        }
        self.sequence = self.sequence.wrapping_add(1);
    }

    fn write(&mut self, packet: &Packet, age_us: Option<u64>, capture_us: u64) -> serde_json::Result<()> {
        let Self { sequence, line, gaze } = self;
        let [.., w] = packet.rotation;
        let sign = if w < 0.0 { -1.0 } else { 1.0 };
        let rotation_xyzw = packet.rotation.map(|part| rounded(sign * part, 1e5));
        let [yaw_deg, pitch_deg, roll_deg] = yaw_pitch_roll_deg(packet.rotation).map(|angle| rounded(angle, 1e2));
        let position_mm = packet.position_mm.map(|mm| rounded(mm, 1e1));
        let eye = |Angles { yaw, pitch, .. }: Angles| {
            let angles = [("yaw_deg", yaw), ("pitch_deg", pitch)];
            Object(angles.map(|(name, angle)| (name, rounded(angle.to_degrees(), 1e2))).into_iter())
        };
        let mut serializer = serde_json::Serializer::new(line);
        let mut object = serializer.serialize_map(None)?;
        object.serialize_entry("sequence", sequence)?;
        object.serialize_entry("state", packet.state.name())?;
        object.serialize_entry("reason", packet.reason.name())?;
        object.serialize_entry("neutral_face", packet.neutral_face.name())?;
        let visibility = packet.visibility.parts().map(|(part, value)| (part, rounded(value, 1e2)));
        object.serialize_entry("visibility", &Object(visibility))?;
        object.serialize_entry("age_ms", &age_us.map(|age_us| age_us as f64 / 1000.0))?;
        object.serialize_entry("capture_us", &capture_us)?;
        object.serialize_entry("head", &Head { yaw_deg, pitch_deg, roll_deg, rotation_xyzw, position_mm })?;
        let eyes = [("left", eye(gaze.left)), ("right", eye(gaze.right))];
        object.serialize_entry("gaze", &Object(eyes.into_iter()))?;
        let coefficients = packet.coefficients.map(|value| rounded(value, 1e4));
        object.serialize_entry("coefficients", &Object(BLENDSHAPES.iter().zip(coefficients)))?;
        object.end()
    }
}

#[derive(Clone)]
struct Object<I>(I);

impl<K: Serialize, V: Serialize, I: Iterator<Item = (K, V)> + Clone> Serialize for Object<I> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.clone())
    }
}

/// Returns the number with as many digits as `parts` has zeros, so that a line stays short.
fn rounded(number: f32, parts: f64) -> f64 {
    // Adding 0 turns -0 into 0.
    (f64::from(number) * parts).round() / parts + 0.0
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing)]
mod tests {
    use serde_json::{Value, json};

    use super::super::testing::{LEFT, face, sent};
    use super::*;
    use crate::{Reason, State, Visibility};

    #[test]
    fn a_line_names_everything_and_counts_on_and_the_age_is_null_before_the_first_pose() {
        let look = [("jawOpen", 0.123_456), ("eyeLookUpLeft", 1.0)];
        let (state, reason, position_mm) = (State::Hold, Reason::NoFace, [10.04, -20.0, 600.0]);
        let visibility = Visibility { right_eye: 0.333, ..Visibility::WHOLE };
        let packet = Packet { state, reason, visibility, rotation: LEFT, position_mm, ..face(&look) };
        let mut format = JsonLines::default();
        let mut line =
            |packet: &Packet, age_us, capture_us| sent(|send| format.encode(packet, age_us, capture_us, send)).concat();
        let mut found: Value = serde_json::from_slice(&line(&packet, Some(23_400), 5_000_000)).unwrap();
        let coefficients = found["coefficients"].take();
        assert_eq!((coefficients.as_object().unwrap().len(), &coefficients["jawOpen"]), (52, &json!(0.1235)));
        let want = json!({
            "sequence": 0, "state": "hold", "reason": "no face", "neutral_face": "mean", "age_ms": 23.4,
            "visibility": {
                "left_eye": 1.0, "right_eye": 0.33, "brows": 1.0, "mouth": 1.0, "cheeks": 1.0, "face": 1.0,
            },
            "capture_us": 5_000_000, "coefficients": null,
            "head": {
                "yaw_deg": 30.0, "pitch_deg": 0.0, "roll_deg": 0.0,
                "rotation_xyzw": [0.0, 0.25882, 0.0, 0.96593], "position_mm": [10.0, -20.0, 600.0],
            },
            "gaze": { "left": { "yaw_deg": 0.0, "pitch_deg": 35.0 }, "right": { "yaw_deg": 0.0, "pitch_deg": 0.0 } },
        });
        assert_eq!(found, want);
        let (rotation, position_mm, coefficients) = ([-0.5, -0.5, -0.5, 0.5], [-30_000.12; 3], [0.123_456; 52]);
        let long = Packet { rotation, position_mm, coefficients, ..packet };
        let longest = line(&long, Some(u64::MAX - 1), u64::MAX);
        assert!(longest.ends_with(b"}\n") && longest.len() < LONGEST);
        let third: Value = serde_json::from_slice(&line(&long, None, u64::MAX)).unwrap();
        assert_eq!([&third["sequence"], &third["age_ms"]], [&json!(2), &Value::Null]);
    }
}
