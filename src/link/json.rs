//! JSON lines: one object a line, for programs that need no more than a parser of JSON.

use facewire_packet::BLENDSHAPES;
use serde::{Serialize, Serializer};

use super::{
    Format, Output,
    angles::{Angles, Gaze},
};
use facewire_face::HeadPose;

/// Room for one line.
const LONGEST: usize = 2048;

/// Lines of JSON.
#[derive(Debug)]
pub struct JsonLines {
    line: Vec<u8>,
    gaze: Gaze,
}

impl JsonLines {
    pub fn new() -> Self {
        Self { line: Vec::with_capacity(LONGEST), gaze: Gaze::default() }
    }
}

impl Format for JsonLines {
    fn encode(&mut self, output: &Output, sequence: u32, send: &mut dyn FnMut(&[u8])) {
        self.gaze.follow(&output.pose.coefficients);
        self.line.clear();
        if serde_json::to_writer(&mut self.line, &Line::new(output, &self.gaze, sequence)).is_ok() {
            self.line.push(b'\n');
            send(&self.line);
        }
    }
}

/// What a line says. `docs/receivers.md` describes the fields.
#[derive(Serialize)]
struct Line<'a> {
    sequence: u32,
    state: &'static str,
    reason: &'static str,
    neutral_face: &'static str,
    /// `None` before the first pose.
    age_ms: Option<f64>,
    capture_us: u64,
    head: Head,
    gaze: Eyes,
    coefficients: Coefficients<'a>,
}

#[derive(Serialize)]
struct Head {
    yaw_deg: f64,
    pitch_deg: f64,
    roll_deg: f64,
    rotation_xyzw: [f64; 4],
    position_mm: [f64; 3],
}

#[derive(Serialize)]
struct Eyes {
    left: Eye,
    right: Eye,
}

#[derive(Serialize)]
struct Eye {
    yaw_deg: f64,
    pitch_deg: f64,
}

impl<'a> Line<'a> {
    fn new(output: &'a Output, gaze: &Gaze, sequence: u32) -> Self {
        let Output { state, reason, pose, age_us, capture_us, .. } = output;
        let head = HeadPose::from_rotation(pose.rotation, pose.position_mm);
        let [yaw_deg, pitch_deg, roll_deg] = head.yaw_pitch_roll_deg().map(|angle| rounded(angle, 1e2));
        let HeadPose { rotation_xyzw, position_mm } = head;
        let rotation_xyzw = rotation_xyzw.map(|part| rounded(part, 1e5));
        let position_mm = position_mm.map(|mm| rounded(mm, 1e1));
        Self {
            sequence,
            state: state.name(),
            reason: reason.name(),
            neutral_face: pose.neutral_face.name(),
            age_ms: (*age_us != u64::MAX).then(|| *age_us as f64 / 1000.0),
            capture_us: *capture_us,
            head: Head { yaw_deg, pitch_deg, roll_deg, rotation_xyzw, position_mm },
            gaze: Eyes { left: Eye::new(gaze.left), right: Eye::new(gaze.right) },
            coefficients: Coefficients(&pose.coefficients),
        }
    }
}

impl Eye {
    fn new(angles: Angles) -> Self {
        let [yaw_deg, pitch_deg] = [angles.yaw, angles.pitch].map(|angle| rounded(angle.to_degrees(), 1e2));
        Self { yaw_deg, pitch_deg }
    }
}

/// Coefficients with their names.
struct Coefficients<'a>(&'a [f32]);

impl Serialize for Coefficients<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(BLENDSHAPES.iter().zip(self.0.iter().map(|value| rounded(*value, 1e4))))
    }
}

/// Returns the number with as many digits as `parts` has zeros, so that a line stays short.
fn rounded(number: f32, parts: f64) -> f64 {
    // Adding 0 turns -0 into 0.
    (f64::from(number) * parts).round() / parts + 0.0
}

#[cfg(test)]
mod tests {
    use facewire_packet::State;
    use serde_json::{Value, json};

    use super::*;
    use crate::link::output::test_output;
    use crate::link::testing::{LEFT, encoded, face};

    fn line(output: &Output) -> Vec<u8> {
        let line = encoded(&mut JsonLines::new(), output).remove(0);
        assert!(line.ends_with(b"}\n") && line.iter().filter(|byte| **byte == b'\n').count() == 1);
        line
    }

    #[test]
    fn a_line_names_everything() {
        let look = face(&[("jawOpen", 0.123_456), ("eyeLookUpLeft", 1.0)]);
        let mut output = Output { pose: look.pose, age_us: 23_400, capture_us: 5_000_000, ..test_output(State::Hold) };
        (output.pose.rotation, output.pose.position_mm) = (LEFT, [10.04, -20.0, 600.0]);
        let mut value: Value = serde_json::from_slice(&line(&output)).unwrap();
        let coefficients = value["coefficients"].take();
        assert_eq!((coefficients.as_object().unwrap().len(), &coefficients["jawOpen"]), (52, &json!(0.1235)));
        let head = json!({
            "yaw_deg": 30.0, "pitch_deg": 0.0, "roll_deg": 0.0,
            "rotation_xyzw": [0.0, 0.25882, 0.0, 0.96593], "position_mm": [10.0, -20.0, 600.0],
        });
        let gaze = json!({
            "left": { "yaw_deg": 0.0, "pitch_deg": 35.0 }, "right": { "yaw_deg": 0.0, "pitch_deg": 0.0 },
        });
        let want = json!({
            "sequence": 7, "state": "hold", "reason": "no face", "neutral_face": "mean", "age_ms": 23.4,
            "capture_us": 5_000_000, "head": head, "gaze": gaze, "coefficients": null,
        });
        assert_eq!(value, want);
    }

    #[test]
    fn the_age_is_null_before_the_first_pose() {
        let line = line(&Output { age_us: u64::MAX, ..test_output(State::Neutral) });
        assert_eq!(serde_json::from_slice::<Value>(&line).unwrap()["age_ms"], Value::Null);
    }

    #[test]
    fn the_longest_line_fits() {
        let mut output = test_output(State::Neutral);
        (output.age_us, output.capture_us) = (u64::MAX - 1, u64::MAX);
        output.pose.coefficients = [0.123_456; 52];
        (output.pose.rotation, output.pose.position_mm) = ([-0.5, -0.5, -0.5, 0.5], [-30_000.12; 3]);
        assert!(line(&output).len() < LONGEST);
    }
}
