//! Finding a face in the whole picture: short-range BlazeFace.
//!
//! Anchors, decoding and weighted non-maximum suppression follow MediaPipe's short-range face detection graph: 896
//! anchors of size 1, two per cell at stride 8 and six per cell at stride 16.

use heapless::Vec;

use crate::capture::Picture;
use crate::infer::{Engine, InferError, Network, Signature};

use super::crop::{Border, CropShape, crop};
use super::region::{FaceBox, Placement};

/// Samples per side of the network's picture.
const SIDE: usize = 128;
const ANCHORS: usize = 896;
/// Numbers per anchor: box centre and size, then six keypoints.
const VALUES: usize = 16;
/// Detections below this score do not count.
const MIN_SCORE: f32 = 0.5;
/// Scores before the sigmoid are clipped to this.
const SCORE_CLIP: f32 = 100.0;
/// Boxes that overlap by more than this are one face.
const SAME_FACE_IOU: f32 = 0.3;
/// More candidates than one frame of faces gives; the rest is left out.
const MAX_CANDIDATES: usize = 64;

static SIGNATURE: Signature = Signature {
    name: "detector",
    input: [1, 3, SIDE, SIDE],
    outputs: &[("boxes", &[1, ANCHORS, VALUES]), ("scores", &[1, ANCHORS, 1])],
};
const SHAPE: CropShape = CropShape { side: SIDE, range: [-1.0, 1.0], border: Border::Black };

/// One face found, in pixels of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    /// 0 to 1.
    pub score: f32,
    /// Left and top.
    pub min: [f32; 2],
    /// Right and bottom.
    pub max: [f32; 2],
    /// The eyes, in the order in which they stand in an unmirrored picture: the person's right eye first.
    pub eyes: [[f32; 2]; 2],
}

impl Detection {
    /// The region of interest around the face.
    #[must_use]
    pub fn region(&self) -> Option<FaceBox> {
        FaceBox::around(self.min, self.max, self.eyes)
    }
}

/// The detector network with its input and output memory.
pub struct Detector {
    network: Box<dyn Network>,
}

impl Detector {
    /// Loads the network.
    ///
    /// # Errors
    /// Those of [`Engine::load`].
    pub fn load(engine: &dyn Engine) -> Result<Self, InferError> {
        Ok(Self { network: engine.load(&SIGNATURE)? })
    }

    /// The face with the highest score, if there is one.
    ///
    /// # Errors
    /// [`InferError::Run`].
    pub fn find(&mut self, picture: &Picture) -> Result<Option<Detection>, InferError> {
        let view = letterbox(picture);
        crop(picture, &view, SHAPE, self.network.input());
        self.network.run()?;
        let candidates = decode(self.network.output(0), self.network.output(1));
        Ok(strongest(&candidates).map(|candidate| candidate.detection(&view.placement())))
    }
}

/// The whole picture, centred in a square.
fn letterbox(picture: &Picture) -> FaceBox {
    let [width, height] = [picture.width as f32, picture.height as f32];
    FaceBox { centre: [width / 2.0, height / 2.0], size: width.max(height), angle_rad: 0.0 }
}

/// A box with two eyes, 0 to 1 across the network's picture.
#[derive(Debug, Clone, Copy, Default)]
struct Candidate {
    score: f32,
    /// Left, top, right, bottom, then both eyes: x, y, x, y.
    values: [f32; 8],
}

impl Candidate {
    fn overlap(&self, other: &Self) -> f32 {
        let [left, top, right, bottom, ..] = self.values;
        let [other_left, other_top, other_right, other_bottom, ..] = other.values;
        let width = (right.min(other_right) - left.max(other_left)).max(0.0);
        let height = (bottom.min(other_bottom) - top.max(other_top)).max(0.0);
        let area = (right - left) * (bottom - top);
        let other_area = (other_right - other_left) * (other_bottom - other_top);
        let shared = width * height;
        shared / (area + other_area - shared).max(f32::EPSILON)
    }

    fn detection(&self, view: &Placement) -> Detection {
        let [left, top, right, bottom, x0, y0, x1, y1] = self.values;
        Detection {
            score: self.score,
            min: view.to_picture(left, top),
            max: view.to_picture(right, bottom),
            eyes: [view.to_picture(x0, y0), view.to_picture(x1, y1)],
        }
    }
}

fn decode(boxes: &[f32], scores: &[f32]) -> Vec<Candidate, MAX_CANDIDATES> {
    let scale = 1.0 / SIDE as f32;
    let mut candidates = Vec::new();
    for ((values, &score), anchor) in boxes.as_chunks::<VALUES>().0.iter().zip(scores).zip(anchors()) {
        let score = sigmoid(score.clamp(-SCORE_CLIP, SCORE_CLIP));
        if score.is_nan() || score < MIN_SCORE {
            continue;
        }
        let [x, y, width, height, x0, y0, x1, y1, ..] = values.map(|value| value * scale);
        let (x, y) = (x + anchor[0], y + anchor[1]);
        let corners = [x - width / 2.0, y - height / 2.0, x + width / 2.0, y + height / 2.0];
        let eyes = [x0 + anchor[0], y0 + anchor[1], x1 + anchor[0], y1 + anchor[1]];
        let [left, top, right, bottom] = corners;
        let [x0, y0, x1, y1] = eyes;
        let full = candidates.push(Candidate { score, values: [left, top, right, bottom, x0, y0, x1, y1] });
        if full.is_err() {
            break;
        }
    }
    candidates
}

/// Weighted non-maximum suppression for the best face: the mean of all boxes that overlap the best one, by score.
fn strongest(candidates: &[Candidate]) -> Option<Candidate> {
    let best = candidates.iter().max_by(|a, b| a.score.total_cmp(&b.score))?;
    let (mut sum, mut weight) = ([0.0; 8], 0.0);
    for candidate in candidates.iter().filter(|candidate| candidate.overlap(best) > SAME_FACE_IOU) {
        weight += candidate.score;
        for (sum, value) in sum.iter_mut().zip(candidate.values) {
            *sum += value * candidate.score;
        }
    }
    (weight > 0.0).then(|| Candidate { score: best.score, values: sum.map(|value| value / weight) })
}

/// Centres of the anchors, 0 to 1.
fn anchors() -> impl Iterator<Item = [f32; 2]> {
    grid(16, 2).chain(grid(8, 6))
}

fn grid(cells: usize, per_cell: usize) -> impl Iterator<Item = [f32; 2]> {
    let centre = move |cell: usize| (cell as f32 + 0.5) / cells as f32;
    (0..cells * cells)
        .flat_map(move |index| std::iter::repeat_n([centre(index % cells), centre(index / cells)], per_cell))
}

/// The logistic function.
pub(super) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anchors_are_as_many_as_the_network_gives() {
        assert_eq!(anchors().count(), ANCHORS);
        assert!(anchors().all(|centre| centre.iter().all(|value| (0.0..1.0).contains(value))));
    }

    #[test]
    fn boxes_of_one_face_are_merged_and_other_faces_left_out() {
        let candidate =
            |score, left: f32| Candidate { score, values: [left, 0.0, left + 0.4, 0.4, 0.0, 0.0, 0.0, 0.0] };
        let merged = strongest(&[candidate(0.9, 0.0), candidate(0.6, 0.05), candidate(0.8, 0.5)]).expect("a face");
        assert!((merged.values[0] - 0.6 * 0.05 / 1.5).abs() < 1e-6);
        assert!((merged.score - 0.9).abs() < f32::EPSILON);
    }

    #[test]
    fn nothing_but_nonsense_is_no_face() {
        let boxes = vec![f32::NAN; ANCHORS * VALUES];
        assert!(strongest(&decode(&boxes, &[f32::NAN; ANCHORS])).is_none());
        assert!(strongest(&decode(&boxes, &[-9.0; ANCHORS])).is_none());
    }
}
