//! Samples a region of the picture into a network's input, straight from the camera's pixel format.
//!
//! The arithmetic is that of OpenCV's `warpPerspective`, which MediaPipe uses, so that the landmarks agree to a fraction
//! of a pixel: positions are rounded to 1/32 px, whole numbers are centres of pixels, the first sample of a row lies on
//! the edge of the region, and the four pixels around a position are interpolated linearly.
//! Only the samples are converted to red, green and blue (see [`super::colour`]), so the cost depends on the size of the
//! crop and not on that of the picture. A side of the picture may have up to 16,384 px.

use crate::capture::Picture;

use super::colour::{WHITE, channels};
use super::planes::Planes;
use super::region::{FaceBox, Mapping};

/// One pixel in the 16.16 fixed point of positions along a row.
const ONE: f32 = 65536.0;
/// Shift from 16.16 to 1/32 px.
const TO_32NDS: u32 = 11;
/// 1/64 px in 16.16, which is added to round to the nearest 1/32 px.
const HALF_32ND: i32 = 1 << (TO_32NDS - 1);
/// Largest number of samples in a row.
const MAX_SIDE: usize = 192;
/// Longest step from one sample to the next, about 170 px. With a longer step the positions of a row would overflow:
/// they would leave the picture on one side and enter it again on the other.
#[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "192 fits")]
const MAX_STEP: i32 = i32::MAX / MAX_SIDE as i32;

/// The input that a network expects: `side` rows of `side` samples, each of which is red, green and blue.
#[derive(Debug, Clone, Copy)]
pub struct CropShape {
    /// Samples per row and column, 1 to 192.
    pub side: usize,
    /// The values of black and of full brightness.
    pub range: [f32; 2],
    /// The colour of samples outside the picture.
    pub border: Border,
}

/// The colour of samples outside the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Border {
    /// That of the nearest pixel.
    Replicate,
    /// Black.
    Black,
}

/// The samples of a picture inside a region.
pub struct Crop<'a> {
    planes: Planes<'a>,
    mapping: Mapping,
    shape: CropShape,
    levels: Levels,
}

impl<'a> Crop<'a> {
    /// The pixels of `picture` inside `region`. A region larger than 32,000 px is sampled as if its size were 32,000 px.
    #[must_use]
    pub fn new(picture: &'a Picture, region: &FaceBox, shape: CropShape) -> Self {
        Self { planes: Planes::new(picture), mapping: region.mapping(), shape, levels: Levels::default() }
    }

    /// Writes one row of samples, of three values each.
    pub fn row(&mut self, row: usize, output: &mut [f32]) {
        let positions = positions(&self.mapping, self.shape.side, row);
        let positions = positions.get(..self.shape.side).unwrap_or(&positions);
        self.levels.sample(&self.planes, positions);
        if self.shape.border == Border::Black {
            self.levels.blacken_outside(&self.planes, positions);
        }
        to_range(self.levels.0.as_flattened(), self.shape.range, output);
    }
}

/// The positions of one row of samples in 1/32 px. The centre of the first pixel is at 0.
#[expect(clippy::cast_possible_truncation, reason = "saturates: a position that far outside is border either way")]
fn positions(mapping: &Mapping, side: usize, row: usize) -> [[i32; 2]; MAX_SIDE] {
    let pitch = 1.0 / side as f32;
    let start = mapping.to_picture(0.0, row as f32 * pitch).map(|position| (position * ONE) as i32);
    let step = mapping.step(side).map(|along| ((along * ONE) as i32).clamp(-MAX_STEP, MAX_STEP));
    let mut at = start.map(|start| start.saturating_add(HALF_32ND));
    let mut positions = [[0; 2]; MAX_SIDE];
    for position in &mut positions {
        *position = at.map(|at| at >> TO_32NDS);
        at = [at[0].wrapping_add(step[0]), at[1].wrapping_add(step[1])];
    }
    positions
}

/// Red, green and blue of each sample of a row, as [`channels`] returns them.
struct Levels([[i32; 3]; MAX_SIDE]);

impl Default for Levels {
    fn default() -> Self {
        Self([[0; 3]; MAX_SIDE])
    }
}

impl Levels {
    /// Samples the picture at the positions of a row.
    fn sample(&mut self, planes: &Planes, positions: &[[i32; 2]]) {
        let inside = |at: Option<&[i32; 2]>| at.is_some_and(|[x, y]| planes.contain_square(x >> 5, y >> 5));
        // A row is straight, so it is inside the picture if both its ends are.
        if inside(positions.first()) && inside(positions.last()) {
            self.fill(positions, |[x, y]| {
                let [x, y] = [x, y].map(|at| at.unsigned_abs() as usize);
                planes.square([x, x + 1], [y, y + 1])
            });
        } else {
            self.fill(positions, |[x, y]| planes.nearest_square(x, y));
        }
    }

    #[inline]
    fn fill(&mut self, positions: &[[i32; 2]], square: impl Fn([i32; 2]) -> [[u64; 2]; 2]) {
        for (sample, at) in self.0.iter_mut().zip(positions) {
            *sample = channels(mix(square(at.map(|at| at >> 5)), *at));
        }
    }

    /// Sets samples outside the picture to black.
    fn blacken_outside(&mut self, planes: &Planes, positions: &[[i32; 2]]) {
        for (sample, [x, y]) in self.0.iter_mut().zip(positions) {
            if !planes.contain(x >> 5, y >> 5) {
                *sample = [0; 3];
            }
        }
    }
}

/// Clips levels to black and white and maps them to the network's range.
fn to_range(levels: &[i32], [low, high]: [f32; 2], output: &mut [f32]) {
    let scale = (high - low) / WHITE as f32;
    for (output, level) in output.iter_mut().zip(levels) {
        *output = (*level).clamp(0, WHITE) as f32 * scale + low;
    }
}

/// The mean of the four pixels around a position in 1/32 px. The nearer a pixel, the larger its weight; the weights add
/// up to 1024.
#[inline]
fn mix(rows: [[u64; 2]; 2], at: [i32; 2]) -> u64 {
    let [right, down] = at.map(|at| u64::from((at & 31).unsigned_abs()));
    let [top, bottom] = rows.map(|[left_pixel, right_pixel]| left_pixel * (32 - right) + right_pixel * right);
    top * (32 - down) + bottom * down
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::capture::Pixels;

    #[test]
    fn a_region_of_any_size_samples_only_the_picture() {
        // All pixels have the same colour, which is not grey, and the padding of each row has other bytes.
        let data = [[90, 100, 90, 180].repeat(6), vec![0; 24]].concat().repeat(18);
        let picture = Picture::new(12, 18, Pixels::Yuyv { data: &data, stride: 48 }, true).expect("all rows are there");
        let shape = CropShape { side: MAX_SIDE, range: [0.0, 1.0], border: Border::Replicate };
        // Without a limit of the step, the first and last samples of a row would be inside at 65,879 px, and those
        // between them outside.
        for size in [0.0, 20.0, 4000.0, 65_879.125, 1e9, f32::INFINITY, f32::NAN] {
            let region = FaceBox { centre: [5.0 + size / 2.0; 2], size, angle_rad: 0.0 };
            let mut crop = Crop::new(&picture, &region, shape);
            let mut samples = vec![[f32::NAN; 3]; MAX_SIDE * MAX_SIDE];
            for (number, row) in samples.chunks_exact_mut(MAX_SIDE).enumerate() {
                crop.row(number, row.as_flattened_mut());
            }
            assert!(samples.iter().all(|sample| *sample == samples[0]), "{size} px");
        }
    }
}
