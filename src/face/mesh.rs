//! Landmarks of a face from its region of interest: the attention mesh network and its three heads.
//!
//! The backbone gives 468 points and a feature map. Each head looks at a turned crop of that map around the lips or
//! an eye and places the points there anew (`x` and `y`; the mesh keeps its `z`). Both eye heads add five iris points.

use crate::capture::Picture;
use crate::infer::{Engine, InferError, Network, Signature};

use super::crop::{Border, CropShape, crop};
use super::detector::sigmoid;
use super::landmarks::Landmarks;
use super::refinement::{
    CROP_SIZE, FEATURE_CHANNELS, FEATURE_SIZE, LEFT_EYE, LEFT_EYE_ROTATION, LEFT_IRIS, LEFT_IRIS_DEPTH, LIPS,
    LIPS_ROTATION, RIGHT_EYE, RIGHT_EYE_ROTATION, RIGHT_IRIS, RIGHT_IRIS_DEPTH,
};
use super::region::FaceBox;
use super::transform::Transform;

/// Samples per side of the network's picture.
const SIDE: usize = 192;
/// A face flag below this is no face.
const MIN_FLAG: f32 = 0.5;

static BACKBONE: Signature = Signature {
    name: "mesh",
    input: [1, 3, SIDE, SIDE],
    outputs: &[
        ("mesh", &[1, 1404]),
        ("flag", &[1, 1]),
        ("features", &[1, FEATURE_CHANNELS, FEATURE_SIZE, FEATURE_SIZE]),
    ],
};
const SHAPE: CropShape = CropShape { side: SIDE, range: [0.0, 1.0], border: Border::Replicate };
const HEAD_INPUT: [usize; 4] = [1, FEATURE_CHANNELS, CROP_SIZE, CROP_SIZE];

/// A network that places some points anew, and which points these are.
struct Refinement {
    signature: Signature,
    /// Points that the first output places.
    points: &'static [u16],
    /// Iris points that the second output places, and the eye's rim, whose mean depth they take.
    iris: Option<(&'static [u16], &'static [u16])>,
    /// The line through these is level in the head's crop.
    level: [u16; 2],
}

static LIPS_REFINEMENT: Refinement = Refinement {
    signature: Signature { name: "lips", input: HEAD_INPUT, outputs: &[("points", &[1, 160])] },
    points: &LIPS,
    iris: None,
    level: LIPS_ROTATION,
};
static RIGHT_EYE_REFINEMENT: Refinement = Refinement {
    signature: eye_signature("left_eye"),
    points: &RIGHT_EYE,
    iris: Some((&RIGHT_IRIS, &RIGHT_IRIS_DEPTH)),
    level: RIGHT_EYE_ROTATION,
};
static LEFT_EYE_REFINEMENT: Refinement = Refinement {
    signature: eye_signature("right_eye"),
    points: &LEFT_EYE,
    iris: Some((&LEFT_IRIS, &LEFT_IRIS_DEPTH)),
    level: LEFT_EYE_ROTATION,
};

/// The networks bear the names of MediaPipe: by the side of the picture that the eye stands in.
const fn eye_signature(name: &'static str) -> Signature {
    Signature { name, input: HEAD_INPUT, outputs: &[("points", &[1, 142]), ("iris", &[1, 10])] }
}

/// The mesh network and its heads, with their input and output memory.
pub struct Mesh {
    backbone: Box<dyn Network>,
    heads: [Head; 3],
}

struct Head {
    network: Box<dyn Network>,
    refinement: &'static Refinement,
}

impl Mesh {
    /// Loads the four networks.
    ///
    /// # Errors
    /// Those of [`Engine::load`].
    pub fn load(engine: &dyn Engine) -> Result<Self, InferError> {
        let head = |refinement: &'static Refinement| -> Result<Head, InferError> {
            Ok(Head { network: engine.load(&refinement.signature)?, refinement })
        };
        Ok(Self {
            backbone: engine.load(&BACKBONE)?,
            heads: [head(&LIPS_REFINEMENT)?, head(&RIGHT_EYE_REFINEMENT)?, head(&LEFT_EYE_REFINEMENT)?],
        })
    }

    /// Finds the landmarks of the face inside `region` and writes them to `landmarks`, in pixels of the picture.
    /// `false`, and no landmarks, if the network sees no face there.
    ///
    /// # Errors
    /// [`InferError::Run`].
    pub fn find(&mut self, picture: &Picture, region: &FaceBox, landmarks: &mut Landmarks) -> Result<bool, InferError> {
        crop(picture, region, SHAPE, self.backbone.input());
        self.backbone.run()?;
        let flag = self.backbone.output(1).first().copied().unwrap_or(f32::NAN);
        if flag.is_nan() || sigmoid(flag) < MIN_FLAG {
            return Ok(false);
        }
        let mesh = self.backbone.output(0).as_chunks::<3>().0;
        for (point, from) in landmarks.0.iter_mut().zip(mesh) {
            *point = *from;
        }
        for head in &mut self.heads {
            head.refine(mesh, self.backbone.output(2), landmarks)?;
        }
        to_picture(region, landmarks);
        Ok(landmarks.is_finite())
    }
}

impl Head {
    fn refine(&mut self, mesh: &[[f32; 3]], map: &[f32], landmarks: &mut Landmarks) -> Result<(), InferError> {
        let transform = Transform::around(mesh, self.refinement.points, self.refinement.level);
        transform.sample(map, self.network.input());
        self.network.run()?;
        place(landmarks, self.refinement.points, self.network.output(0), &transform);
        if let Some((iris, rim)) = self.refinement.iris {
            place(landmarks, iris, self.network.output(1), &transform);
            landmarks.level_iris(iris, rim);
        }
        Ok(())
    }
}

fn place(landmarks: &mut Landmarks, indices: &[u16], output: &[f32], transform: &Transform) {
    for (&index, &point) in indices.iter().zip(output.as_chunks::<2>().0) {
        if let Some([x, y, _]) = landmarks.0.get_mut(usize::from(index)) {
            [*x, *y] = transform.apply(point);
        }
    }
}

/// From samples of the network's picture to pixels of the whole one; depth is scaled like width.
fn to_picture(region: &FaceBox, landmarks: &mut Landmarks) {
    let (placement, scale) = (region.placement(), region.size / SIDE as f32);
    for [x, y, z] in &mut landmarks.0 {
        [*x, *y] = placement.to_picture(*x / SIDE as f32, *y / SIDE as f32);
        *z *= scale;
    }
}
