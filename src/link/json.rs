//! JSON lines: one object a line, for programs that need no more than a parser of JSON.

use facewire_packet::BLENDSHAPES;
use serde::{Serialize, Serializer};

use super::{Format, Output, gaze::Gaze, head::Angles};
use crate::solve::HeadPose;

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
        let HeadPose { rotation_xyzw, yaw_deg, pitch_deg, roll_deg, position_mm } =
            HeadPose::from_rotation(pose.rotation, pose.position_mm);
        let [yaw_deg, pitch_deg, roll_deg] = [yaw_deg, pitch_deg, roll_deg].map(|angle| rounded(angle, 1e2));
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
#[allow(clippy::unwrap_used, clippy::indexing_slicing)]
mod tests {
    use facewire_packet::State;
    use serde_json::{Value, json};

    use super::*;
    use crate::link::gaze::set;
    use crate::link::head::poses;
    use crate::link::output::test_output;

    fn line(output: &Output) -> String {
        let mut text = String::new();
        JsonLines::new().encode(output, 7, &mut |bytes| text.push_str(std::str::from_utf8(bytes).unwrap()));
        assert!(text.ends_with("}\n") && text.matches('\n').count() == 1, "{text}");
        text
    }

    #[test]
    fn a_line_names_everything() {
        let mut output = test_output(State::Hold);
        (output.age_us, output.capture_us) = (23_400, 5_000_000);
        (output.pose.rotation, output.pose.position_mm) = (poses::LEFT, [10.04, -20.0, 600.0]);
        set(&mut output.pose.coefficients, &[("jawOpen", 0.123_456), ("eyeLookUpLeft", 1.0)]);
        let value: Value = serde_json::from_str(&line(&output)).unwrap();
        assert_eq!(
            (&value["sequence"], &value["state"], &value["reason"]),
            (&json!(7), &json!("hold"), &json!("no face"))
        );
        assert_eq!((&value["age_ms"], &value["capture_us"]), (&json!(23.4), &json!(5_000_000)));
        assert_eq!(value["neutral_face"], "mean");
        let head = json!({
            "yaw_deg": 30.0, "pitch_deg": 0.0, "roll_deg": 0.0,
            "rotation_xyzw": [0.0, 0.25882, 0.0, 0.96593], "position_mm": [10.0, -20.0, 600.0],
        });
        assert_eq!(value["head"], head);
        let gaze = json!({
            "left": { "yaw_deg": 0.0, "pitch_deg": 35.0 }, "right": { "yaw_deg": 0.0, "pitch_deg": 0.0 },
        });
        assert_eq!(value["gaze"], gaze);
        assert_eq!(value["coefficients"].as_object().unwrap().len(), 52);
        assert_eq!(value["coefficients"]["jawOpen"], json!(0.1235));
    }

    #[test]
    fn the_age_is_null_before_the_first_pose() {
        let output = Output { age_us: u64::MAX, ..test_output(State::Neutral) };
        assert!(line(&output).contains("\"age_ms\":null,"));
    }

    #[test]
    fn the_longest_line_fits() {
        let mut output = test_output(State::Neutral);
        (output.age_us, output.capture_us) = (u64::MAX - 1, u64::MAX);
        output.pose.coefficients = [0.123_456; 52];
        (output.pose.rotation, output.pose.position_mm) = ([-0.5, -0.5, -0.5, 0.5], [-30_000.12; 3]);
        assert!(line(&output).len() < LONGEST, "{}", line(&output).len());
    }
}
