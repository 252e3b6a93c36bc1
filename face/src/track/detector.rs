//! Finds a face in the whole picture, with short-range BlazeFace.
//!
//! Anchors, decoding and weighted non-maximum suppression are those of MediaPipe's short-range face detection graph.

use std::iter;

use heapless::Vec as FixedVec;

use crate::infer::{Engine, InferError, Network, Signature};
use crate::picture::Picture;

use super::block::Block;
use super::crop::{Border, CropShape, crop};
use super::landmarks::{FaceBox, Mapping};

const SIDE: usize = 128;
const ANCHORS: usize = 896;
/// Numbers per anchor: centre and size of the box, then six keypoints.
const VALUES: usize = 16;
const MIN_SCORE: f32 = 0.5;
const SCORE_CLIP: f32 = 100.0;
/// Boxes with a larger intersection over union than this belong to the same face.
const SAME_FACE_IOU: f32 = 0.3;
/// Most faces of a picture that are told apart.
pub const MOST_FACES: usize = 16;

static SIGNATURE: Signature = Signature {
    name: "detector",
    input: [SIDE, SIDE, 3],
    outputs: &[("boxes", &[ANCHORS, VALUES]), ("scores", &[ANCHORS, 1])],
};
const SHAPE: CropShape = CropShape { side: SIDE, range: [-1.0, 1.0], border: Border::Black };

/// The detector network.
pub struct Detector {
    network: Box<dyn Network>,
    block: Block,
}

impl Detector {
    /// Loads the network.
    pub fn load(engine: &dyn Engine) -> Result<Self, InferError> {
        Ok(Self { network: engine.load(&SIGNATURE)?, block: Block::default() })
    }

    /// Returns the region of interest around the face with the highest score, or `None` if there is no face.
    pub fn find(&mut self, picture: &Picture) -> Result<Option<FaceBox>, InferError> {
        let view = self.run(picture)?;
        let best = strongest(candidates(self.network.output(0), self.network.output(1)));
        Ok(best.and_then(|face| face.region(&view.mapping())))
    }

    /// Returns the regions of interest around all faces, but the weakest of many, the one with the highest score first.
    pub fn find_all(&mut self, picture: &Picture) -> Result<FixedVec<FaceBox, MOST_FACES>, InferError> {
        let view = self.run(picture)?;
        let mut found: FixedVec<Candidate, MOST_FACES> = FixedVec::new();
        while !found.is_full() {
            let all = candidates(self.network.output(0), self.network.output(1));
            let is_new = |new: &Candidate| found.iter().all(|face| !face.is_same(new));
            let Some(face) = strongest(all.filter(is_new)) else { break };
            let _ = found.push(face);
        }
        Ok(found.iter().filter_map(|face| face.region(&view.mapping())).collect())
    }

    /// Runs the network on the whole picture, and returns the region that it has seen.
    fn run(&mut self, picture: &Picture) -> Result<FaceBox, InferError> {
        let [width, height] = picture.size_px();
        let view = FaceBox { centre: [width / 2.0, height / 2.0], size: width.max(height), angle_rad: 0.0 };
        crop(picture, &view, SHAPE, &mut self.block, &mut *self.network);
        self.network.run()?;
        Ok(view)
    }
}

/// A box with two eyes. Coordinates run from 0 to 1 across the network's input.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    score: f32,
    /// Left, top, right and bottom of the box; x and y of both eyes, the person's right eye first.
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

    /// Whether both boxes are of the same face: weak candidates of one face may hardly overlap its box.
    fn is_same(&self, other: &Self) -> bool {
        let [left, top, right, bottom, ..] = self.values;
        let [other_left, other_top, other_right, other_bottom, ..] = other.values;
        let x = f32::midpoint(other_left, other_right);
        let y = f32::midpoint(other_top, other_bottom);
        self.overlap(other) > SAME_FACE_IOU || ((left..right).contains(&x) && (top..bottom).contains(&y))
    }

    fn region(&self, view: &Mapping) -> Option<FaceBox> {
        let [left, top, right, bottom, x0, y0, x1, y1] = self.values;
        let corners = [view.to_picture(left, top), view.to_picture(right, bottom)];
        FaceBox::around(corners, [view.to_picture(x0, y0), view.to_picture(x1, y1)])
    }
}

/// Decodes the boxes whose scores are those of a face. A score that is not a number is not that of a face.
fn candidates(boxes: &[f32], scores: &[f32]) -> impl Iterator<Item = Candidate> + Clone {
    let all = boxes.as_chunks::<VALUES>().0.iter().zip(scores).zip(anchors());
    all.filter_map(|((values, &score), [anchor_x, anchor_y])| {
        let score = logistic(score.clamp(-SCORE_CLIP, SCORE_CLIP));
        let [x, y, width, height, x0, y0, x1, y1, ..] = values.map(|value| value / SIDE as f32);
        let x = x + anchor_x;
        let y = y + anchor_y;
        let [left, top, right, bottom] = [x - width / 2.0, y - height / 2.0, x + width / 2.0, y + height / 2.0];
        let values = [left, top, right, bottom, x0 + anchor_x, y0 + anchor_y, x1 + anchor_x, y1 + anchor_y];
        (score >= MIN_SCORE).then_some(Candidate { score, values })
    })
}

/// The weighted mean of all candidates that overlap the one with the highest score.
fn strongest(candidates: impl Iterator<Item = Candidate> + Clone) -> Option<Candidate> {
    let best = candidates.clone().max_by(|a, b| a.score.total_cmp(&b.score))?;
    let mut sum = [0.0; 8];
    let mut weight = 0.0;
    for candidate in candidates.filter(|candidate| candidate.overlap(&best) > SAME_FACE_IOU) {
        weight += candidate.score;
        for (sum, value) in sum.iter_mut().zip(candidate.values) {
            *sum += value * candidate.score;
        }
    }
    (weight > 0.0).then(|| Candidate { score: best.score, values: sum.map(|value| value / weight) })
}

/// Centres of the anchors, from 0 to 1 across the network's input.
fn anchors() -> impl Iterator<Item = [f32; 2]> + Clone {
    [(16, 2), (8, 6)].into_iter().flat_map(|(cells, per_cell): (usize, usize)| {
        let centre = move |cell: usize| (cell as f32 + 0.5) / cells as f32;
        let cell = move |index: usize| [centre(index % cells), centre(index / cells)];
        (0..cells * cells).flat_map(move |index| iter::repeat_n(cell(index), per_cell))
    })
}

fn logistic(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_of_one_face_are_merged_and_other_faces_left_out() {
        let candidate =
            |score, left: f32| Candidate { score, values: [left, 0.0, left + 0.4, 0.4, 0.0, 0.0, 0.0, 0.0] };
        let merged = [candidate(0.9, 0.0), candidate(0.6, 0.05), candidate(0.8, 0.5)];
        let merged = strongest(merged.into_iter()).expect("a face");
        assert!((merged.values[0] - 0.6 * 0.05 / 1.5).abs() < 1e-6);
        assert!((merged.score - 0.9).abs() < f32::EPSILON);
    }

    #[test]
    fn the_best_face_is_found_among_any_number_and_scores_that_are_low_or_not_a_number_are_no_face() {
        let boxes: Vec<f32> = [[0.0, 0.0, 16.0, 16.0], [0.0; 4], [0.0; 4], [0.0; 4]].as_flattened().repeat(ANCHORS);
        let best = |others: f32, last: f32| {
            let mut scores = [others; ANCHORS];
            scores[ANCHORS - 1] = last;
            strongest(candidates(&boxes, &scores))
        };
        let found = best(1.0, 5.0).expect("a face");
        assert!((found.score - logistic(5.0)).abs() < f32::EPSILON);
        assert!(found.values[0] > 0.8 && found.values[1] > 0.8, "the last anchor is at the bottom right: {found:?}");
        assert!(best(f32::NAN, f32::NAN).is_none() && best(-9.0, -9.0).is_none());
    }
}
