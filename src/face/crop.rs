//! Sampling a region of the picture into a network's input, straight from the camera's pixel format.
//!
//! The arithmetic is that of the pictures MediaPipe is used with, so that landmarks agree with it to a fraction of a
//! pixel: bilinear to 1/32 px from the corners of the samples, as OpenCV's `warpPerspective`. Colour conversion happens
//! per sample (see [`super::colour`]), so its cost is that of the crop and not of the frame.
//! Pictures may be up to 16,384 px a side.

use crate::capture::Picture;

use super::colour::unpack;
use super::planes::Planes;
use super::region::FaceBox;

/// One pixel in the 16.16 fixed point of positions along a row.
const ONE: f32 = 65536.0;
/// From 16.16 to 1/32 px.
const TO_32NDS: u32 = 11;

/// What a network expects of its input: `side` x `side` samples in three planes R, G, B.
#[derive(Debug, Clone, Copy)]
pub struct CropShape {
    /// Samples per row and column.
    pub side: usize,
    /// The values of black and of full brightness.
    pub range: [f32; 2],
    /// What lies outside the picture.
    pub border: Border,
}

/// What a sample outside the picture is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Border {
    /// The nearest pixel of the picture.
    Replicate,
    /// Black.
    Black,
}

/// Fills `input` (3 x side x side values) with the pixels of `picture` inside `region`.
pub fn crop(picture: &Picture, region: &FaceBox, shape: CropShape, input: &mut [f32]) {
    let planes = Planes::of(picture);
    let [low, high] = shape.range;
    let scale = (high - low) / 255.0;
    let area = shape.side * shape.side;
    let (red, rest) = input.split_at_mut(area.min(input.len()));
    let (green, blue) = rest.split_at_mut(area.min(rest.len()));
    let rows = red.chunks_exact_mut(shape.side).zip(green.chunks_exact_mut(shape.side));
    for (row, ((red, green), blue)) in rows.zip(blue.chunks_exact_mut(shape.side)).enumerate() {
        let samples = red.iter_mut().zip(green).zip(blue);
        for (at, ((r, g), b)) in Walk::new(region, shape.side, row).zip(samples) {
            let rgb = match shape.border {
                Border::Black if !planes.hold(at[0] >> 5, at[1] >> 5) => [0; 3],
                _ => sample(&planes, at),
            };
            [*r, *g, *b] = rgb.map(|value| f32::from(value) * scale + low);
        }
    }
}

/// Positions of one row of samples in 1/32 px, pixel centres being whole numbers.
struct Walk {
    at: [i32; 2],
    step: [i32; 2],
}

impl Walk {
    #[expect(clippy::cast_possible_truncation, reason = "saturates: what lies that far outside is border")]
    fn new(region: &FaceBox, side: usize, row: usize) -> Self {
        let pitch = 1.0 / side as f32;
        let at = region.to_picture(0.0, row as f32 * pitch).map(|position| (position * ONE) as i32);
        let (sin, cos) = region.angle_rad.sin_cos();
        let step = [cos, sin].map(|along| (along * region.size * pitch * ONE) as i32);
        Self { at, step }
    }
}

impl Iterator for Walk {
    type Item = [i32; 2];

    fn next(&mut self) -> Option<[i32; 2]> {
        let at = self.at.map(|at| at.saturating_add(1 << (TO_32NDS - 1)) >> TO_32NDS);
        self.at = [self.at[0].wrapping_add(self.step[0]), self.at[1].wrapping_add(self.step[1])];
        Some(at)
    }
}

/// Red, green and blue at a position in 1/32 px.
fn sample(planes: &Planes, at: [i32; 2]) -> [u8; 3] {
    let [x, y] = at.map(|at| at >> 5);
    let [right, down] = at.map(|at| u64::from((at & 31).unsigned_abs()));
    let [top, bottom] = [y, y + 1].map(|y| planes.pixel(x, y) * (32 - right) + planes.pixel(x + 1, y) * right);
    unpack(top * (32 - down) + bottom * down)
}
