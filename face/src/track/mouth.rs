//! What the mouth looks like: a grey picture of it, and the coefficients that a small network of facewire's own reads from that
//! picture.
//!
//! The network needs no other part of the face. It sees the mouth where a headset makes the landmarks of eyes and nose wander.
//! `models/covered/train.py` makes it.

use super::Block;
use super::grey::{GreyCamera, read};
use super::landmarks::{FaceBox, Landmarks};
use crate::infer::{InferError, Network, built_in};
use crate::picture::Picture;

/// Rows and columns of the picture of a mouth.
pub const MOUTH_SIDE: usize = 64;
/// Number of coefficients that the network gives: those of jaw and mouth, and `cheekPuff`.
pub const MOUTH_VALUES: usize = 28;

/// Brightness of each pixel, 0 to 255, row by row.
pub type MouthPicture = [f32; MOUTH_SIDE * MOUTH_SIDE];
/// What the network gives, in the order of [`BLENDSHAPES`](crate::BLENDSHAPES).
pub type MouthValues = [f32; MOUTH_VALUES];

const FILE: &[u8] = include_bytes!("../../models/mouth.fwnet");

/// The landmarks in whose middle the mouth is: corners and middles of the lips.
const LIPS: [usize; 4] = [61, 291, 0, 17];
/// Lines that are level in the picture: between the corners of the lips, and between both sides of the jaw. All lie in the
/// lower half of the face, so that the place is right if the upper one is covered.
const LEVEL: [[usize; 2]; 3] = [[61, 291], [58, 288], [172, 397]];
/// Side of the picture, and how far its middle lies below that of the lips, divided by the side of the region of the face.
const SHARE: f32 = 0.42;
const BELOW: f32 = 0.02;

/// The network, and the picture that it saw last.
pub struct Mouth {
    network: Box<dyn Network>,
    camera: GreyCamera,
    /// The picture.
    pub picture: Box<MouthPicture>,
}

impl Mouth {
    /// Loads the network.
    pub fn load() -> Result<Self, InferError> {
        let picture = Box::new([0.0; MOUTH_SIDE * MOUTH_SIDE]);
        Ok(Self { network: built_in(FILE)?, camera: GreyCamera::new(MOUTH_SIDE), picture })
    }

    /// Takes the picture of the face with these landmarks, which was found in `region`.
    pub fn look(&mut self, picture: &Picture, region: &FaceBox, landmarks: &Landmarks, block: &mut Block) {
        self.camera.take(picture, &place(region, landmarks), block, &mut *self.picture);
    }

    /// Returns what the network reads from the picture.
    pub fn read(&mut self) -> Result<MouthValues, InferError> {
        let mut values = [0.0; MOUTH_VALUES];
        let outputs = read(&mut *self.network, &*self.picture, MOUTH_SIDE)?;
        values.iter_mut().zip(outputs).for_each(|(value, output)| *value = *output);
        Ok(values)
    }
}

fn place(region: &FaceBox, landmarks: &Landmarks) -> FaceBox {
    let at = |index: usize| landmarks.0.get(index).map_or([0.0; 2], |[x, y, _]| [*x, *y]);
    let [mut x, mut y] = [0.0; 2];
    for [lip_x, lip_y] in LIPS.map(at) {
        x += lip_x / LIPS.len() as f32;
        y += lip_y / LIPS.len() as f32;
    }
    let [mut right, mut down] = [0.0; 2];
    for [from, to] in LEVEL.map(|line| line.map(at)) {
        right += to[0] - from[0];
        down += to[1] - from[1];
    }
    let angle_rad = down.atan2(right);
    let (sin, cos) = angle_rad.sin_cos();
    let below = BELOW * region.size;
    FaceBox { centre: [x - below * sin, y + below * cos], size: SHARE * region.size, angle_rad }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::Pixels;

    const SIZE: usize = 200;

    /// The picture of a dark mouth, in a picture that is turned by `angle_rad` around its middle.
    fn seen(angle_rad: f32) -> MouthPicture {
        let (sin, cos) = angle_rad.sin_cos();
        let turned = |x: f32, y: f32| [100.0 + cos * x - sin * y, 100.0 + sin * x + cos * y];
        let is_lip = |at: usize| {
            let [x, y] = [(at % SIZE) as f32 - 100.0, (at / SIZE) as f32 - 100.0];
            (cos * x + sin * y).abs() < 20.0 && (cos * y - sin * x).abs() < 5.0
        };
        let data: Vec<u8> = (0..SIZE * SIZE).map(|at| if is_lip(at) { 40 } else { 200 }).collect();
        let picture = Picture::new(SIZE, SIZE, Pixels::Grey { data: &data, stride: SIZE }, true).expect("whole");
        let mut landmarks = Landmarks::zero();
        let points = [(61, -20.0, 0.0), (291, 20.0, 0.0), (0, 0.0, -5.0), (17, 0.0, 5.0)];
        let jaw = [(58, -40.0, 10.0), (288, 40.0, 10.0), (172, -30.0, 25.0), (397, 30.0, 25.0)];
        for (index, x, y) in points.into_iter().chain(jaw) {
            let [x, y] = turned(x, y);
            landmarks.0[index] = [x, y, 0.0];
        }
        // What the region says of the turn of the eyes does not matter, because a headset covers them.
        let region = FaceBox { centre: [90.0, 60.0], size: 190.0, angle_rad: 1.0 };
        let mut mouth = Mouth::load().expect("the network");
        mouth.look(&picture, &region, &landmarks, &mut Block::default());
        *mouth.picture
    }

    #[test]
    fn mouth_of_a_tilted_head_is_upright_in_its_picture_whatever_the_eyes_say() {
        let [upright, tilted] = [0.0, 0.4].map(seen);
        let difference = upright.iter().zip(tilted).map(|(one, other)| (one - other).abs()).sum::<f32>();
        assert!(difference / upright.len() as f32 <= 6.0, "{difference}");
        let dark = upright.iter().filter(|pixel| **pixel < 100.0).count() as f32 / upright.len() as f32;
        // The lips are 40 x 10 pixels in a picture of 80 x 80.
        assert!((dark - 400.0 / 6368.0).abs() < 0.01, "{dark}");
    }
}
