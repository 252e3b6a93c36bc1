//! What each eye looks like: a grey picture of it, and what a small network of facewire's own makes of that picture.
//!
//! The cells of the mesh's feature map are a sixth of an eye wide. The direction of the gaze shows in less than that, so this
//! network reads the pixels of the camera. `models/eyes/train.py` makes it.

use super::Block;
use super::grey::{GreyCamera, read};
use super::landmarks::{FaceBox, Landmarks};
use crate::infer::{InferError, Network, built_in};
use crate::model::EYE_VALUES;
use crate::picture::Picture;

/// Rows and columns of the picture of an eye.
pub const EYE_SIDE: usize = 32;

/// Brightness of each pixel, 0 to 255, row by row. The left eye is mirrored, so that both look like a right one.
pub type EyePicture = [f32; EYE_SIDE * EYE_SIDE];
/// The network's values for the right eye and for the left one.
pub type EyeValues = [[f32; EYE_VALUES]; 2];

const FILE: &[u8] = include_bytes!("../../models/eyes.fwnet");

/// Corners of the right eye, and of the left.
const CORNERS: [[usize; 2]; 2] = [[33, 133], [362, 263]];
/// Side of an eye's picture, divided by that of the region of the face.
const SHARE: f32 = 0.16;

/// The network, and the pictures that it saw last.
pub struct Eyes {
    network: Box<dyn Network>,
    camera: GreyCamera,
    /// The right eye and the left one.
    pub pictures: [EyePicture; 2],
}

impl Eyes {
    /// Loads the network.
    pub fn load() -> Result<Self, InferError> {
        let pictures = [[0.0; EYE_SIDE * EYE_SIDE]; 2];
        Ok(Self { network: built_in(FILE)?, camera: GreyCamera::new(EYE_SIDE), pictures })
    }

    /// Takes the pictures of both eyes of the face with these landmarks, which was found in `region`.
    pub(super) fn look(&mut self, picture: &Picture, region: &FaceBox, landmarks: &Landmarks, block: &mut Block) {
        for (index, (corners, eye)) in CORNERS.into_iter().zip(&mut self.pictures).enumerate() {
            let [[x, y, _], [other_x, other_y, _]] =
                corners.map(|corner| landmarks.0.get(corner).copied().unwrap_or_default());
            let centre = [f32::midpoint(x, other_x), f32::midpoint(y, other_y)];
            let place = FaceBox { centre, size: SHARE * region.size, angle_rad: region.angle_rad };
            self.camera.take(picture, &place, block, eye);
            if index == 1 {
                eye.as_chunks_mut::<EYE_SIDE>().0.iter_mut().for_each(|row| row.reverse());
            }
        }
    }

    /// Returns what the network makes of both pictures.
    pub fn read(&mut self) -> Result<EyeValues, InferError> {
        let mut values = EyeValues::default();
        for (picture, values) in self.pictures.iter().zip(&mut values) {
            let outputs = read(&mut *self.network, picture, EYE_SIDE)?;
            values.iter_mut().zip(outputs).for_each(|(value, output)| *value = *output);
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Pixels;

    /// The middle of the right eye and of the left one.
    const MIDDLES: [f32; 2] = [70.0, 130.0];

    /// Returns what the network makes of two eyes whose irises are `offset` pixels right of and below the middle.
    fn seen(offset: [f32; 2], [dark, bright]: [u8; 2]) -> EyeValues {
        let is_iris = |x: usize, y: usize| {
            let right = MIDDLES.map(|middle| x as f32 - middle - offset[0]);
            right.iter().any(|right| right.hypot(y as f32 - 50.0 - offset[1]) < 5.0)
        };
        let data: Vec<u8> = (0..200 * 100).map(|at| if is_iris(at % 200, at / 200) { dark } else { bright }).collect();
        let picture = Picture::new(200, 100, Pixels::Grey { data: &data, stride: 200 }, true).expect("whole");
        let mut landmarks = Landmarks::zero();
        for (corners, middle) in CORNERS.into_iter().zip(MIDDLES) {
            landmarks.0[corners[0]] = [middle - 13.0, 50.0, 0.0];
            landmarks.0[corners[1]] = [middle + 13.0, 50.0, 0.0];
        }
        let region = FaceBox { centre: [100.0, 50.0], size: 190.0, angle_rad: 0.0 };
        let mut eyes = Eyes::load().expect("the network");
        eyes.look(&picture, &region, &landmarks, &mut Block::default());
        eyes.read().expect("a run")
    }

    fn difference(one: &[f32], other: &[f32]) -> f32 {
        one.iter().zip(other).map(|(one, other)| (one - other).powi(2)).sum::<f32>().sqrt()
    }

    #[test]
    fn eyes_that_look_elsewhere_have_other_values_in_any_light_and_the_left_one_is_read_as_a_mirrored_right_one() {
        let [left, right] = [-4.0, 4.0].map(|offset| seen([offset, 0.0], [40, 200]));
        let turned = difference(&left[0], &right[0]);
        assert!(difference(&left[0], &right[1]) < 0.5 * turned, "{turned}");
        assert!(difference(&left[1], &right[0]) < 0.5 * turned, "{turned}");
        let dark = seen([4.0, 0.0], [30, 110]);
        assert!(difference(&dark[0], &right[0]) < 0.2 * turned, "brightness and contrast make little difference");
    }
}
