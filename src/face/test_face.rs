//! A face that scripted networks find, for tests.

use super::landmarks::{Landmarks, MESH};
use super::refinement::{LEFT_EYE, LEFT_EYE_ROTATION, LIPS, LIPS_ROTATION, RIGHT_EYE, RIGHT_EYE_ROTATION};
use super::transform::Transform;
use crate::infer::scripted::Run;

/// Score and face flag of a face, before the sigmoid.
const CERTAIN: f32 = 10.0;
/// An anchor in the middle of the picture: row 8 and column 8 of the 16 x 16 cells, which have two anchors each.
const MIDDLE_ANCHOR: usize = (8 * 16 + 8) * 2;

/// Fills in the outputs of any network so that the detector finds a face in the middle of the picture, and the mesh
/// finds `landmarks`, which are given in samples of its 192 x 192 input. The irises stay where they are.
pub(crate) fn show(run: &mut Run, landmarks: &Landmarks) {
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
        // The networks bear MediaPipe's names: by the side of the picture.
        ("left_eye", [points, _]) => refine(landmarks, &RIGHT_EYE, RIGHT_EYE_ROTATION, points),
        ("right_eye", [points, _]) => refine(landmarks, &LEFT_EYE, LEFT_EYE_ROTATION, points),
        (name, _) => panic!("no network {name}"),
    }
}

/// Writes `points` of the landmarks as a head gives them: in its own crop.
fn refine(landmarks: &Landmarks, points: &[u16], level: [u16; 2], output: &mut [f32]) {
    let transform = Transform::around(&landmarks.0, points, level);
    let origin = transform.apply([0.0, 0.0]);
    for (&index, output) in points.iter().zip(output.as_chunks_mut::<2>().0) {
        let [x, y, _] = landmarks.0[usize::from(index)];
        // A head without extent shows all its points at the same place, whatever its output.
        *output = transform.turn_back([x - origin[0], y - origin[1]]);
    }
}
