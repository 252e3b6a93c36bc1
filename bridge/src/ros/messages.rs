//! The messages, as ROS 2 defines them: serde writes their fields in this order as CDR.

use std::time::SystemTime;

use facewire_packet::BLENDSHAPE_COUNT;
use serde::{Serialize, Serializer, ser::SerializeTuple as _};

#[derive(Debug, Clone, Copy, Serialize)]
pub struct Time {
    sec: i32,
    nanosec: u32,
}

impl From<SystemTime> for Time {
    fn from(time: SystemTime) -> Self {
        let since = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
        Self { sec: i32::try_from(since.as_secs()).unwrap_or(i32::MAX), nanosec: since.subsec_nanos() }
    }
}

/// `std_msgs/Header`.
#[derive(Debug, Clone, Serialize)]
pub struct Header {
    pub stamp: Time,
    pub frame_id: String,
}

/// `std_msgs/Bool`.
#[derive(Debug, Serialize)]
pub struct Bool {
    pub data: bool,
}

/// `sensor_msgs/JointState`.
#[derive(Debug, Serialize)]
pub struct JointState {
    pub header: Header,
    pub name: &'static [&'static str],
    pub position: Vec<f64>,
    pub velocity: &'static [f64],
    pub effort: &'static [f64],
}

/// `geometry_msgs/Pose` and, with the same bytes, `geometry_msgs/Transform`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Pose {
    pub position: [f64; 3],
    /// x, y, z, w.
    pub orientation: [f64; 4],
}

/// `geometry_msgs/PoseStamped`.
#[derive(Debug, Serialize)]
pub struct PoseStamped {
    pub header: Header,
    pub pose: Pose,
}

/// `geometry_msgs/TransformStamped`.
#[derive(Debug, Serialize)]
pub struct TransformStamped {
    pub header: Header,
    pub child_frame_id: String,
    pub transform: Pose,
}

/// `tf2_msgs/TFMessage`.
#[derive(Debug, Serialize)]
pub struct TFMessage {
    pub transforms: Vec<TransformStamped>,
}

/// `diagnostic_msgs/DiagnosticArray`.
#[derive(Debug, Serialize)]
pub struct DiagnosticArray {
    pub header: Header,
    pub status: Vec<DiagnosticStatus>,
}

/// `diagnostic_msgs/DiagnosticStatus`. The level is 0 OK, 1 warning, 2 error, 3 stale.
#[derive(Debug, Serialize)]
pub struct DiagnosticStatus {
    pub level: u8,
    pub name: String,
    pub message: String,
    pub hardware_id: String,
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/KeyValue`.
#[derive(Debug, Serialize)]
pub struct KeyValue {
    pub key: &'static str,
    pub value: String,
}

/// `hri_msgs/IdsList`.
#[derive(Debug, Serialize)]
pub struct IdsList {
    pub header: Header,
    pub ids: Vec<String>,
}

/// `hri_msgs/FacialActionUnits`: both arrays have the codes of FACS as indices.
#[derive(Debug, Serialize)]
pub struct FacialActionUnits {
    pub header: Header,
    #[serde(serialize_with = "array")]
    pub intensity: [f32; 99],
    #[serde(serialize_with = "array")]
    pub confidence: [f32; 99],
}

/// An array of a fixed length, which serde knows up to 32.
fn array<S: Serializer>(values: &[f32; 99], serializer: S) -> Result<S::Ok, S::Error> {
    let mut tuple = serializer.serialize_tuple(values.len())?;
    values.iter().try_for_each(|value| tuple.serialize_element(value))?;
    tuple.end()
}

/// The pose of a head in the camera's optical frame (z forward, x right, y down), by REP 103: the head's x points out of the
/// face, y to the person's left and z up. The packet's position has these axes already; its rotation has the head's left, up
/// and out of the face, measured from a head that faces the camera.
pub fn pose(rotation: [f32; 4], position_mm: [f32; 3]) -> Pose {
    // The camera sees a head that faces it turned by half a turn about x.
    const FACING: [f64; 4] = [1.0, 0.0, 0.0, 0.0];
    // Left, up and out become y, z and x.
    const AXES: [f64; 4] = [-0.5, -0.5, -0.5, 0.5];
    Pose {
        position: position_mm.map(|mm| f64::from(mm) / 1000.0),
        orientation: product(product(FACING, rotation.map(f64::from)), AXES),
    }
}

fn product([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// Codes of FACS, each with its coefficients by their places in the packet, of which the largest counts. The pairing of
/// ARKit's shapes with codes is a convention of facewire.
const ACTION_UNITS: [(usize, &[usize]); 24] = [
    (1, &[43]),
    (2, &[44, 45]),
    (4, &[41, 42]),
    (5, &[6, 13]),
    (6, &[47, 48]),
    (7, &[5, 12]),
    (9, &[49, 50]),
    (10, &[39, 40]),
    (12, &[23, 24]),
    (14, &[27, 28]),
    (15, &[25, 26]),
    (16, &[37, 38]),
    (17, &[33]),
    (18, &[20]),
    (19, &[51]),
    (20, &[29, 30]),
    (22, &[19]),
    (24, &[35, 36]),
    (26, &[17]),
    (28, &[31, 32]),
    (29, &[14]),
    (30, &[15, 16]),
    (34, &[46]),
    (45, &[0, 7]),
];

/// Returns intensities and confidences of the action units.
pub fn action_units(coefficients: &[f32; BLENDSHAPE_COUNT]) -> [[f32; 99]; 2] {
    let [mut intensity, mut confidence] = [[0.0; 99]; 2];
    for (code, places) in ACTION_UNITS {
        let values = places.iter().filter_map(|at| coefficients.get(*at));
        if let (Some(intensity), Some(confidence)) = (intensity.get_mut(code), confidence.get_mut(code)) {
            (*intensity, *confidence) = (values.fold(0.0, |most: f32, value| most.max(*value)), 1.0);
        }
    }
    [intensity, confidence]
}

#[cfg(test)]
mod tests {
    use facewire_packet::BLENDSHAPES;

    use super::*;

    /// Where a rotation takes an axis: the vector part of q v q*.
    fn turned([x, y, z, w]: [f64; 4], [a, b, c]: [f64; 3]) -> [f64; 3] {
        let [x, y, z, _] = product(product([x, y, z, w], [a, b, c, 0.0]), [-x, -y, -z, w]);
        [x, y, z].map(|part| (part * 1e6).round() / 1e6 + 0.0)
    }

    #[test]
    fn a_head_that_faces_the_camera_has_rep_103s_axes_and_turns_to_its_left_about_its_z() {
        let facing = pose([0.0, 0.0, 0.0, 1.0], [100.0, -50.0, 600.0]);
        assert_eq!(facing.position.map(|metres| (metres * 1e6).round() / 1e6), [0.1, -0.05, 0.6]);
        let axes = |rotation| [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| turned(rotation, axis));
        // Out of the face is back along the camera's z, the person's left is the picture's right, and up is not down.
        assert_eq!(axes(facing.orientation), [[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]);
        let half = 45_f32.to_radians();
        let [forward, left, up] = axes(pose([0.0, half.sin(), 0.0, half.cos()], [0.0; 3]).orientation);
        assert_eq!([forward, left, up], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]);
    }

    #[test]
    fn action_units_take_the_larger_side_of_the_shapes_that_arkit_has_for_them() {
        let at = |name: &str| BLENDSHAPES.iter().position(|known| *known == name).unwrap();
        let mut coefficients = [0.0; BLENDSHAPE_COUNT];
        coefficients[at("mouthSmileLeft")] = 0.4;
        coefficients[at("mouthSmileRight")] = 0.6;
        coefficients[at("jawOpen")] = 0.5;
        coefficients[at("tongueOut")] = 0.2;
        let [intensity, confidence] = action_units(&coefficients);
        let found = intensity.iter().enumerate().filter(|(_, value)| **value > 0.0).map(|(code, value)| (code, *value));
        assert_eq!(found.collect::<Vec<_>>(), [(12, 0.6), (19, 0.2), (26, 0.5)]);
        assert_eq!((confidence[12], confidence[25]), (1.0, 0.0));
        let names = ["browInnerUp", "browDownLeft", "cheekPuff", "noseSneerRight", "mouthRollUpper", "eyeBlinkRight"];
        let codes = [1, 4, 34, 9, 28, 45];
        for (name, code) in names.into_iter().zip(codes) {
            let (_, places) = ACTION_UNITS.iter().find(|(known, _)| *known == code).unwrap();
            assert!(places.contains(&at(name)), "{name}");
        }
    }
}
