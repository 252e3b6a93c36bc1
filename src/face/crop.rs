//! Sampling a region of the picture into a network's input, straight from the camera's pixel format.
//!
//! The arithmetic is that of the pictures MediaPipe is used with, so that landmarks agree with it to a fraction of a
//! pixel: bilinear to 1/32 px from the corners of the samples, as OpenCV's `warpPerspective`. Colour conversion happens
//! per sample (see [`super::colour`]), so its cost is that of the crop and not of the frame.
//! Pictures may be up to 16,384 px a side.

use crate::capture::Picture;

use super::colour::{WHITE, channels};
use super::planes::Planes;
use super::region::{FaceBox, Placement};

/// One pixel in the 16.16 fixed point of positions along a row.
const ONE: f32 = 65536.0;
/// From 16.16 to 1/32 px.
const TO_32NDS: u32 = 11;
/// 1/64 px, to round.
const HALF_32ND: i32 = 1 << (TO_32NDS - 1);
/// More samples per row than any network takes.
const MAX_SIDE: usize = 192;
/// Longest step from one sample to the next, about 170 px: a row of longer ones would go round the whole range of
/// positions, leave the picture on one side and come back on the other.
#[expect(clippy::cast_possible_truncation, clippy::cast_possible_wrap, reason = "192 fits")]
const MAX_STEP: i32 = i32::MAX / MAX_SIDE as i32;

/// What a network expects of its input: `side` x `side` samples in three planes R, G, B.
#[derive(Debug, Clone, Copy)]
pub struct CropShape {
    /// Samples per row and column, 1 to 192.
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

/// Fills `input` (3 x side x side values) with the pixels of `picture` inside `region`. Regions larger than 32,000 px are
/// sampled as if they were so large.
pub fn crop(picture: &Picture, region: &FaceBox, shape: CropShape, input: &mut [f32]) {
    let (planes, placement) = (Planes::of(picture), region.placement());
    let area = shape.side * shape.side;
    let (red, rest) = input.split_at_mut(area.min(input.len()));
    let (green, blue) = rest.split_at_mut(area.min(rest.len()));
    let rows = red.chunks_exact_mut(shape.side).zip(green.chunks_exact_mut(shape.side));
    let mut levels = Levels::default();
    for (row, ((red, green), blue)) in rows.zip(blue.chunks_exact_mut(shape.side)).enumerate() {
        let positions = positions(&placement, shape.side, row);
        let positions = positions.get(..shape.side).unwrap_or(&positions);
        levels.take(&planes, positions);
        if shape.border == Border::Black {
            levels.blacken(&planes, positions);
        }
        for (output, levels) in [red, green, blue].into_iter().zip(&levels.0) {
            to_range(levels, shape.range, output);
        }
    }
}

/// Positions of one row of samples in 1/32 px, pixel centres being whole numbers.
#[expect(clippy::cast_possible_truncation, reason = "saturates: what lies that far outside is border")]
fn positions(placement: &Placement, side: usize, row: usize) -> [[i32; 2]; MAX_SIDE] {
    let pitch = 1.0 / side as f32;
    let start = placement.to_picture(0.0, row as f32 * pitch).map(|position| (position * ONE) as i32);
    let step = placement.step(side).map(|along| ((along * ONE) as i32).clamp(-MAX_STEP, MAX_STEP));
    let mut at = start.map(|start| start.saturating_add(HALF_32ND));
    let mut positions = [[0; 2]; MAX_SIDE];
    for position in &mut positions {
        *position = at.map(|at| at >> TO_32NDS);
        at = [at[0].wrapping_add(step[0]), at[1].wrapping_add(step[1])];
    }
    positions
}

/// Red, green and blue of one row of samples, 0 to [`WHITE`].
struct Levels([[i32; MAX_SIDE]; 3]);

impl Default for Levels {
    fn default() -> Self {
        Self([[0; MAX_SIDE]; 3])
    }
}

impl Levels {
    /// Samples the picture at the positions of a row.
    fn take(&mut self, planes: &Planes, positions: &[[i32; 2]]) {
        let inside = |at: Option<&[i32; 2]>| at.is_some_and(|[x, y]| planes.hold_square(x >> 5, y >> 5));
        // A row is straight: it lies inside the picture if both its ends do.
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
        let [red, green, blue] = &mut self.0;
        for (((red, green), blue), at) in red.iter_mut().zip(green).zip(blue).zip(positions) {
            [*red, *green, *blue] = channels(mix(square(at.map(|at| at >> 5)), *at));
        }
    }

    /// Makes black what lies outside the picture.
    fn blacken(&mut self, planes: &Planes, positions: &[[i32; 2]]) {
        for channel in &mut self.0 {
            for (level, [x, y]) in channel.iter_mut().zip(positions) {
                *level *= i32::from(planes.hold(x >> 5, y >> 5));
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

/// The mean of four pixels, weighted by how near each is to a position in 1/32 px; all weights add up to 1024.
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
    fn a_region_of_any_size_samples_nothing_but_the_picture() {
        // One colour of no grey, with other bytes behind each row.
        let data = [[90, 100, 90, 180].repeat(6), vec![0; 24]].concat().repeat(18);
        let picture = Picture::new(12, 18, Pixels::Yuyv { data: &data, stride: 48 }, true).expect("all rows are there");
        let shape = CropShape { side: MAX_SIDE, range: [0.0, 1.0], border: Border::Replicate };
        // At 65,879 px the first and the last sample of a row would lie inside, and those between them would not.
        for size in [0.0, 20.0, 4000.0, 65_879.125, 1e9, f32::INFINITY, f32::NAN] {
            let region = FaceBox { centre: [5.0 + size / 2.0; 2], size, angle_rad: 0.0 };
            let mut input = vec![f32::NAN; 3 * MAX_SIDE * MAX_SIDE];
            crop(&picture, &region, shape, &mut input);
            for channel in input.chunks_exact(MAX_SIDE * MAX_SIDE) {
                assert!(channel.iter().all(|value| *value == channel[0]), "{size} px");
            }
        }
    }
}
