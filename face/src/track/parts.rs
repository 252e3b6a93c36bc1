//! What the mouth and the brows look like: a grey picture of each, and the coefficients that a small network of facewire's own
//! reads from it.
//!
//! The networks know neither the wearer nor the rest of the face. They see folds and lips that no landmark marks, and they see
//! the mouth where a headset makes the landmarks of eyes and nose wander. `models/parts/train.py` makes them.

use super::Block;
use super::grey::{GreyCamera, read};
use super::landmarks::{FaceBox, Landmarks};
use crate::infer::{InferError, Network, built_in};
use crate::picture::Picture;
use crate::{BLENDSHAPES, COEFFS};

/// Rows and columns of the picture of a part.
pub const PART_SIDE: usize = 64;

/// Brightness of each pixel, 0 to 255, row by row.
pub type PartPicture = [f32; PART_SIDE * PART_SIDE];

/// A coefficient for each blendshape that a network reads, and 0 for the others.
pub type PartValues = [f32; COEFFS];

/// The networks of the parts, and how the names of the blendshapes begin that each reads, in the order of [`BLENDSHAPES`].
const NETWORKS: [(&[u8], &[&str]); 2] = [
    (include_bytes!("../../models/mouth.fwnet"), &["jaw", "mouth", "cheekPuff"]),
    (include_bytes!("../../models/brows.fwnet"), &["brow", "eyeWide", "eyeSquint"]),
];

/// Where a part is: the middle of some landmarks, and a line that is level in its picture.
struct Place {
    around: &'static [usize],
    level: &'static [[usize; 2]],
    /// How far above the middle of the landmarks that of the picture is, and its side, divided by that of the region of
    /// the face.
    above: f32,
    side: f32,
}

/// The mouth with the chin, and the brows with the eyes and the forehead.
const PLACES: [Place; 2] = [
    // Corners and middles of the lips, and the jaw on both sides: all lie in the lower half of the face, so that the place is
    // right if the upper one is covered.
    Place { around: &[61, 291, 0, 17], level: &[[61, 291], [58, 288], [172, 397]], above: -0.02, side: 0.42 },
    Place { around: &[33, 133, 362, 263], level: &[[33, 263]], above: 0.08, side: 0.5 },
];

/// The networks, and the pictures that they saw last.
pub struct Parts {
    networks: Vec<(Box<dyn Network>, Vec<usize>)>,
    camera: GreyCamera,
    /// The mouth, and the brows.
    pub pictures: Box<[PartPicture; 2]>,
}

impl Parts {
    /// Loads the networks.
    pub fn load() -> Result<Self, InferError> {
        let network = |(file, prefixes): (&[u8], &[&str])| -> Result<(Box<dyn Network>, Vec<usize>), InferError> {
            let is_read = |name: &str| prefixes.iter().any(|prefix| name.starts_with(prefix));
            let places = (0..COEFFS).filter(|place| BLENDSHAPES.get(*place).is_some_and(|name| is_read(name)));
            Ok((built_in(file)?, places.collect()))
        };
        Ok(Self {
            networks: NETWORKS.into_iter().map(network).collect::<Result<_, _>>()?,
            camera: GreyCamera::new(PART_SIDE),
            pictures: Box::new([[0.0; PART_SIDE * PART_SIDE]; 2]),
        })
    }

    /// Takes the pictures of the face with these landmarks, which was found in `region`.
    pub(super) fn look(&mut self, picture: &Picture, region: &FaceBox, landmarks: &Landmarks, block: &mut Block) {
        for (place, part) in PLACES.iter().zip(self.pictures.iter_mut()) {
            self.camera.take(picture, &place.find(region, landmarks), block, part);
        }
    }

    /// Returns what the networks read from the pictures.
    pub fn read(&mut self) -> Result<PartValues, InferError> {
        let mut values = [0.0; COEFFS];
        for ((network, places), picture) in self.networks.iter_mut().zip(self.pictures.iter()) {
            for (place, output) in places.iter().zip(read(&mut **network, picture, PART_SIDE)?) {
                if let Some(value) = values.get_mut(*place) {
                    *value = *output;
                }
            }
        }
        Ok(values)
    }
}

impl Place {
    fn find(&self, region: &FaceBox, landmarks: &Landmarks) -> FaceBox {
        let at = |index: usize| landmarks.0.get(index).map_or([0.0; 2], |[x, y, _]| [*x, *y]);
        let [mut x, mut y] = [0.0; 2];
        for point in self.around.iter().map(|index| at(*index)) {
            x += point[0] / self.around.len() as f32;
            y += point[1] / self.around.len() as f32;
        }
        let [mut right, mut down] = [0.0; 2];
        for [from, to] in self.level.iter().map(|line| line.map(at)) {
            right += to[0] - from[0];
            down += to[1] - from[1];
        }
        let angle_rad = down.atan2(right);
        let (sin, cos) = angle_rad.sin_cos();
        let above = self.above * region.size;
        FaceBox { centre: [x + above * sin, y - above * cos], size: self.side * region.size, angle_rad }
    }
}
