//! Finds the landmarks of a face in its region of interest, with the attention mesh network and its three heads.
//!
//! Each head receives a rotated crop of the backbone's feature map around the lips or an eye, and computes better `x` and
//! `y` for the points there. The heads of the eyes also compute five points of the iris. On a board that is too slow the
//! heads take turns: the others repeat their last corrections in the coordinates of their crops, which follow the face.

use crate::infer::{Engine, InferError, Network, Signature};
use crate::picture::Picture;

use super::block::Block;
use super::crop::{Border, CropShape, crop};
use super::eyes::Eyes;
use super::feature_map::{FeatureMap, Transform};
use super::landmarks::{Appearance, Face, FaceBox, Landmarks};
use super::mouth::Mouth;
use super::refinement::{
    CROP_SIZE, FEATURE_CHANNELS, FEATURE_SIZE, LEFT_EYE, LEFT_EYE_ROTATION, LEFT_IRIS, LEFT_IRIS_DEPTH, LIPS,
    LIPS_ROTATION, RIGHT_EYE, RIGHT_EYE_ROTATION, RIGHT_IRIS, RIGHT_IRIS_DEPTH,
};
use super::visible::{InView, Visible, likely_in_view, upper_half};
use crate::solve::Wears;

const SIDE: usize = 192;
/// Probability that the upper half of the face is in view, below which the mouth is read from its picture, and for how many
/// pictures more. It is larger than that below which the reading counts (`solve/view.rs`).
const MOUTH_LIKELY: f32 = 0.3;
const MOUTH_PICTURES: u8 = 30;
/// Smallest face flag of a face. The network's flag is the logit of a probability, so that 0 means one half.
const MIN_FLAG: f32 = 0.0;

static BACKBONE: Signature = Signature {
    name: "mesh",
    input: [SIDE, SIDE, 3],
    outputs: &[("mesh", &[1404]), ("flag", &[1]), ("features", &[FEATURE_SIZE, FEATURE_SIZE, FEATURE_CHANNELS])],
};
const SHAPE: CropShape = CropShape { side: SIDE, range: [0.0, 1.0], border: Border::Replicate };
const HEAD_INPUT: [usize; 3] = [CROP_SIZE, CROP_SIZE, FEATURE_CHANNELS];
const EYE_OUTPUTS: &[(&str, &[usize])] = &[("points", &[142]), ("iris", &[10])];

struct Refinement {
    signature: Signature,
    points: &'static [u16],
    level: [u16; 2],
    iris: Option<Iris>,
}

/// The iris points of the second output, and the contour of the eye, whose mean depth they take.
type Iris = (&'static [u16], &'static [u16]);

const fn refinement(
    name: &'static str,
    outputs: &'static [(&'static str, &'static [usize])],
    (points, level): (&'static [u16], [u16; 2]),
    iris: Option<Iris>,
) -> Refinement {
    Refinement { signature: Signature { name, input: HEAD_INPUT, outputs }, points, level, iris }
}

/// The network of the person's right eye is called `left_eye`: MediaPipe names it by the side of the picture.
static REFINEMENTS: [Refinement; 3] = [
    refinement("lips", &[("points", &[160])], (&LIPS, LIPS_ROTATION), None),
    refinement("left_eye", EYE_OUTPUTS, (&RIGHT_EYE, RIGHT_EYE_ROTATION), Some((&RIGHT_IRIS, &RIGHT_IRIS_DEPTH))),
    refinement("right_eye", EYE_OUTPUTS, (&LEFT_EYE, LEFT_EYE_ROTATION), Some((&LEFT_IRIS, &LEFT_IRIS_DEPTH))),
];

/// The backbone, its heads, and what they found last.
pub struct Mesh {
    backbone: Box<dyn Network>,
    heads: Vec<Head>,
    block: Block,
    /// What the eyes of the last face look like.
    pub eyes: Eyes,
    /// What the mouth of the last face looked like while the upper half of the face was covered.
    pub mouth: Mouth,
    /// Number of pictures in which the network of the mouth still runs, although the upper half is in view.
    mouth_pictures: u8,
    /// What the wearer has on the face.
    pub(super) wears: Wears,
    visible: Visible,
    landmarks: Landmarks,
    appearance: Appearance,
    /// Whether the heads take turns.
    pub(super) by_turns: bool,
    /// The head whose turn it is; `None` if all heads run on the next picture, as on another face.
    pub(super) turn: Option<usize>,
}

struct Head {
    network: Box<dyn Network>,
    refinement: &'static Refinement,
    corrections: Vec<[f32; 2]>,
}

impl Mesh {
    /// Loads the four networks.
    pub fn load(engine: &dyn Engine) -> Result<Self, InferError> {
        let head = |refinement: &'static Refinement| -> Result<Head, InferError> {
            let corrections = vec![[0.0; 2]; refinement.points.len()];
            Ok(Head { network: engine.load(&refinement.signature)?, refinement, corrections })
        };
        Ok(Self {
            backbone: engine.load(&BACKBONE)?,
            heads: REFINEMENTS.iter().map(head).collect::<Result<_, _>>()?,
            block: Block::default(),
            eyes: Eyes::load()?,
            mouth: Mouth::load()?,
            mouth_pictures: 0,
            wears: Wears::default(),
            visible: Visible::load()?,
            landmarks: Landmarks::zero(),
            appearance: Appearance::zero(),
            by_turns: false,
            turn: None,
        })
    }

    /// Returns the landmarks of the face inside `region`, in pixels of the picture, if the network sees one there.
    pub fn find(&mut self, picture: &Picture, region: &FaceBox) -> Result<Option<&Landmarks>, InferError> {
        let Some(score) = self.run_backbone(picture, region)? else { return Ok(None) };
        self.appearance.score = score;
        copy_points(&*self.backbone, &mut self.landmarks);
        let mesh = self.backbone.output(0).as_chunks::<3>().0;
        let map = FeatureMap::new(self.backbone.output(2));
        let turn = self.turn.filter(|_| self.by_turns);
        for (index, head) in self.heads.iter_mut().enumerate() {
            if turn.is_none_or(|turn| turn == index) {
                head.refine(mesh, map, &mut self.landmarks)?;
            } else {
                head.repeat(mesh, &mut self.landmarks);
            }
        }
        self.turn = Some(self.turn.map_or(0, |turn| (turn + 1) % self.heads.len()));
        self.appearance.sample(map, &self.landmarks);
        to_picture(region, &mut self.landmarks);
        self.eyes.look(picture, region, &self.landmarks, &mut self.block);
        self.appearance.looks.eyes = self.eyes.read()?;
        self.appearance.looks.in_view = self.visible.read(&self.appearance.skin)?;
        self.look_at_mouth(picture, region)?;
        Ok(self.landmarks.is_finite().then_some(&self.landmarks))
    }

    /// Reads the mouth from its picture while the upper half of the face may be covered, and for some pictures more, in which
    /// the coefficients lead back to those of the landmarks.
    fn look_at_mouth(&mut self, picture: &Picture, region: &FaceBox) -> Result<(), InferError> {
        self.mouth_pictures = mouth_pictures(self.mouth_pictures, &self.appearance.looks.in_view, self.wears);
        if self.mouth_pictures > 0 {
            self.mouth.look(picture, region, &self.landmarks, &mut self.block);
            self.appearance.looks.mouth = self.mouth.read()?;
        }
        Ok(())
    }

    /// Returns the score of the face inside `region`, if the network sees one there, and the region for the next picture.
    pub fn look(&mut self, picture: &Picture, region: &FaceBox) -> Result<Option<(f32, FaceBox)>, InferError> {
        let Some(score) = self.run_backbone(picture, region)? else { return Ok(None) };
        let mut landmarks = Landmarks::zero();
        copy_points(&*self.backbone, &mut landmarks);
        to_picture(region, &mut landmarks);
        Ok(FaceBox::following(&landmarks).map(|region| (score, region)))
    }

    /// Returns the network's log-odds that `region` shows a face, if one is more likely than none.
    fn run_backbone(&mut self, picture: &Picture, region: &FaceBox) -> Result<Option<f32>, InferError> {
        crop(picture, region, SHAPE, &mut self.block, &mut *self.backbone);
        self.backbone.run()?;
        Ok(self.backbone.output(1).first().copied().filter(|flag| *flag >= MIN_FLAG))
    }

    /// The face that was found last.
    pub fn face(&self) -> Face<'_> {
        Face { landmarks: &self.landmarks, appearance: Some(&self.appearance) }
    }
}

/// The number of pictures in which the network of the mouth still runs.
fn mouth_pictures(before: u8, in_view: &InView, wears: Wears) -> u8 {
    let may_be_covered = upper_half(&likely_in_view(in_view)) < MOUTH_LIKELY;
    let is_wanted = may_be_covered || wears == Wears::Headset;
    if is_wanted { MOUTH_PICTURES } else { before.saturating_sub(1) }
}

impl Head {
    /// Replaces the points of this head in `landmarks`, which are in samples of the backbone's input, like those of `mesh`.
    fn refine(&mut self, mesh: &[[f32; 3]], map: FeatureMap, landmarks: &mut Landmarks) -> Result<(), InferError> {
        let transform = self.transform(mesh);
        for row in 0..CROP_SIZE {
            transform.sample(map, row, self.network.input_row(row));
        }
        self.network.run()?;
        replace(landmarks, self.refinement.points, self.network.output(0), &transform);
        for (correction, &index) in self.corrections.iter_mut().zip(self.refinement.points) {
            let points = landmarks.0.get(usize::from(index)).zip(mesh.get(usize::from(index)));
            let moved = points.map_or([0.0; 2], |(to, from)| [to[0] - from[0], to[1] - from[1]]);
            *correction = transform.turn_back(moved);
        }
        self.place_iris(&transform, landmarks);
        Ok(())
    }

    /// Corrects the points of this head in `landmarks`, which are those of the backbone, as the last run did.
    fn repeat(&self, mesh: &[[f32; 3]], landmarks: &mut Landmarks) {
        let transform = self.transform(mesh);
        for (&correction, &index) in self.corrections.iter().zip(self.refinement.points) {
            if let Some([x, y, _]) = landmarks.0.get_mut(usize::from(index)) {
                let [right, down] = transform.turn(correction);
                *x += right;
                *y += down;
            }
        }
        self.place_iris(&transform, landmarks);
    }

    fn transform(&self, mesh: &[[f32; 3]]) -> Transform {
        Transform::around(mesh, self.refinement.points, self.refinement.level)
    }

    fn place_iris(&self, transform: &Transform, landmarks: &mut Landmarks) {
        if let Some((iris, contour)) = self.refinement.iris {
            replace(landmarks, iris, self.network.output(1), transform);
            landmarks.level_iris(iris, contour);
        }
    }
}

/// Copies the points that the backbone found, in samples of its input.
fn copy_points(backbone: &dyn Network, landmarks: &mut Landmarks) {
    let found = backbone.output(0).as_chunks().0;
    landmarks.0.iter_mut().zip(found).for_each(|(point, found)| *point = *found);
}

/// Replaces x and y of some points by a head's output, which is in the coordinates of its crop.
fn replace(landmarks: &mut Landmarks, indices: &[u16], output: &[f32], transform: &Transform) {
    for (&index, &point) in indices.iter().zip(output.as_chunks::<2>().0) {
        if let Some([x, y, _]) = landmarks.0.get_mut(usize::from(index)) {
            [*x, *y] = transform.apply(point);
        }
    }
}

/// Converts samples of the backbone's input to pixels of the picture. Depth has the scale of the width.
fn to_picture(region: &FaceBox, landmarks: &mut Landmarks) {
    let mapping = region.mapping();
    let scale = region.size / SIDE as f32;
    for [x, y, z] in &mut landmarks.0 {
        [*x, *y] = mapping.to_picture(*x / SIDE as f32, *y / SIDE as f32);
        *z *= scale;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mouth_is_read_while_eyes_and_brows_are_covered_or_a_headset_is_on_and_for_some_pictures_more() {
        let in_view = [8.0; 5];
        let covered = [-8.0, -8.0, -8.0, 8.0, 8.0];
        let sunglasses = [-8.0, -8.0, 8.0, 8.0, 8.0];
        assert_eq!(mouth_pictures(0, &in_view, Wears::Nothing), 0);
        assert_eq!(mouth_pictures(0, &sunglasses, Wears::Nothing), 0);
        assert_eq!(mouth_pictures(0, &in_view, Wears::Headset), MOUTH_PICTURES);
        let mut left = mouth_pictures(0, &covered, Wears::Nothing);
        for wanted in (0..MOUTH_PICTURES).rev() {
            left = mouth_pictures(left, &in_view, Wears::Nothing);
            assert_eq!(left, wanted);
        }
    }
}
