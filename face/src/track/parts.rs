//! What the mouth and the brows look like: a grey picture of each.

use super::Block;
use super::grey::GreyCamera;
use super::landmarks::{FaceBox, Landmarks};
use crate::picture::Picture;

/// Rows and columns of the picture of a part.
pub const PART_SIDE: usize = 64;

/// Brightness of each pixel, 0 to 255, row by row.
pub type PartPicture = [f32; PART_SIDE * PART_SIDE];

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

/// The pictures of the parts.
pub struct Parts {
    camera: GreyCamera,
    /// The mouth, and the brows.
    pub pictures: Box<[PartPicture; 2]>,
}

impl Default for Parts {
    fn default() -> Self {
        Self { camera: GreyCamera::new(PART_SIDE), pictures: Box::new([[0.0; PART_SIDE * PART_SIDE]; 2]) }
    }
}

impl Parts {
    /// Takes the pictures of the face with these landmarks, which was found in `region`.
    pub(super) fn look(&mut self, picture: &Picture, region: &FaceBox, landmarks: &Landmarks, block: &mut Block) {
        for (place, part) in PLACES.iter().zip(self.pictures.iter_mut()) {
            self.camera.take(picture, &place.find(region, landmarks), block, part);
        }
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
