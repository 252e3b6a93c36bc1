//! What tests of this crate and of others need: an engine whose networks run a closure, and a face that they can find.

use std::sync::Arc;

use nalgebra::{Rotation3, Vector3};

use crate::infer::{Engine, InferError, Network, Signature};
use crate::solve::affine::RIGID;
use crate::track::feature_map::Transform;
use crate::track::refinement::{LEFT_EYE, LEFT_EYE_ROTATION, LIPS, LIPS_ROTATION, RIGHT_EYE, RIGHT_EYE_ROTATION};
use crate::track::{LANDMARKS, Landmarks, MESH};

pub struct Run<'a> {
    pub network: &'static str,
    /// The outputs in the order of the signature, with the values of the run before, for the closure to fill in.
    pub outputs: &'a mut [Vec<f32>],
}

type Script = dyn Fn(Run) -> Result<(), &'static str> + Send + Sync;

/// An engine that runs a closure in place of every network.
pub struct Scripted(Arc<Script>);

impl Scripted {
    /// An engine whose networks run `script`. The text of an error becomes the engine's message.
    pub fn new(script: impl Fn(Run) -> Result<(), &'static str> + Send + Sync + 'static) -> Self {
        Self(Arc::new(script))
    }
}

impl Engine for Scripted {
    fn name(&self) -> String {
        "scripted".to_owned()
    }

    fn load(&self, signature: &'static Signature) -> Result<Box<dyn Network>, InferError> {
        let zeros = |shape: &[usize]| vec![0.0; shape.iter().product()];
        Ok(Box::new(ScriptedNetwork {
            name: signature.name,
            script: Arc::clone(&self.0),
            row: zeros(&signature.input[1..]),
            outputs: signature.outputs.iter().map(|(_, shape)| zeros(shape)).collect(),
        }))
    }
}

struct ScriptedNetwork {
    name: &'static str,
    script: Arc<Script>,
    /// The memory of every row of the input. All rows share it, because nothing reads the input.
    row: Vec<f32>,
    outputs: Vec<Vec<f32>>,
}

impl Network for ScriptedNetwork {
    fn input_row(&mut self, _: usize) -> &mut [f32] {
        &mut self.row
    }

    fn run(&mut self) -> Result<(), InferError> {
        let run = Run { network: self.name, outputs: &mut self.outputs };
        (self.script)(run).map_err(|reason| InferError::run(self.name, reason))
    }

    fn output(&self, index: usize) -> &[f32] {
        self.outputs.get(index).map_or(&[], Vec::as_slice)
    }
}

const CERTAIN: f32 = 10.0;
/// An anchor in the middle of the picture: row 8 and column 8 of the 16 x 16 cells, which have two anchors each.
const MIDDLE_ANCHOR: usize = (8 * 16 + 8) * 2;

/// Fills in the outputs of any network so that the detector finds a face in the middle of the picture, and the mesh
/// finds `landmarks`, which are given in samples of its 192 x 192 input. The irises stay where they are.
pub fn show(run: &mut Run, landmarks: &Landmarks) {
    match (run.network, &mut *run.outputs) {
        ("detector", [boxes, scores]) => {
            scores.fill(-CERTAIN);
            scores[MIDDLE_ANCHOR] = CERTAIN;
            // Width and height of the box, in samples of the 128 x 128 input, then the eyes.
            boxes[MIDDLE_ANCHOR * 16..][2..8].copy_from_slice(&[64.0, 64.0, -16.0, -10.0, 16.0, -10.0]);
        }
        ("mesh", [mesh, flag, _]) => {
            mesh.copy_from_slice(landmarks.0[..MESH].as_flattened());
            flag[0] = CERTAIN;
        }
        ("lips", [points]) => refine(landmarks, &LIPS, LIPS_ROTATION, points),
        // The networks are named by the side of the picture.
        ("left_eye", [points, _]) => refine(landmarks, &RIGHT_EYE, RIGHT_EYE_ROTATION, points),
        ("right_eye", [points, _]) => refine(landmarks, &LEFT_EYE, LEFT_EYE_ROTATION, points),
        (name, _) => panic!("no network {name}"),
    }
}

fn refine(landmarks: &Landmarks, points: &[u16], level: [u16; 2], output: &mut [f32]) {
    let transform = Transform::around(&landmarks.0, points, level);
    let origin = transform.apply([0.0, 0.0]);
    for (&index, output) in points.iter().zip(output.as_chunks_mut::<2>().0) {
        let [x, y, _] = landmarks.0[usize::from(index)];
        // A head without extent shows all its points at the same place, whatever its output.
        *output = transform.turn_back([x - origin[0], y - origin[1]]);
    }
}

/// The canonical face, rotated by yaw (to its left), pitch (up) and roll (to its right shoulder), degrees. Its eyes are
/// `scale_px` apart, and the point between them lies at `origin_px`. All other landmarks coincide with that point.
pub fn face([yaw, pitch, roll]: [f32; 3], scale_px: f32, origin_px: [f32; 2]) -> Landmarks {
    let about = |axis, degrees: f32| Rotation3::from_axis_angle(&axis, degrees.to_radians());
    let rotation = about(Vector3::z_axis(), roll) * about(Vector3::x_axis(), -pitch) * about(Vector3::y_axis(), yaw);
    let to_picture = |point: Vector3<f32>| {
        let turned = rotation * point * scale_px;
        [origin_px[0] + turned.x, origin_px[1] - turned.y, -turned.z]
    };
    let mut landmarks = Landmarks([to_picture(Vector3::zeros()); LANDMARKS]);
    for (index, point) in RIGID {
        landmarks.0[index] = to_picture(Vector3::from(point).cast());
    }
    landmarks
}
