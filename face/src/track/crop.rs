//! Samples a region of the picture into a network's input, straight from the camera's pixel format.
//!
//! The arithmetic is that of OpenCV's `warpPerspective`, which MediaPipe uses, so that the landmarks agree to a fraction
//! of a pixel: positions are rounded to 1/32 px, whole numbers are centres of pixels, the first sample of a row lies on
//! the edge of the region, and the four pixels around a position are interpolated linearly.
//! Only the region is converted to red, green and blue (see [`super::planes`]), and not the picture. A side of the picture
//! may have up to 16,384 px.

use std::ops::Range;

use facewire_engine::kernels::sample::{Line, WHITE, sample};

use crate::infer::Network;
use crate::picture::Picture;

use super::block::{Block, Row};
use super::planes::Planes;
use super::region::{FaceBox, Mapping};

/// One pixel in the 16.16 fixed point of positions along a row.
const ONE: f32 = 65536.0;
/// 1/64 px in 16.16, which is added to round to the nearest 1/32 px.
const HALF_32ND: i32 = 1 << 10;
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

/// Sizes of blocks, in columns and rows of samples. [`crop`] takes the first size whose pixels fit the memory. Long rows
/// take the least time, as each row of pixels has a fixed cost. A region with a black border is not rotated, so that few
/// pixels lie around a single row of samples.
const ROTATED_BLOCKS: [[usize; 2]; 10] =
    [[96, 96], [96, 48], [96, 24], [48, 48], [48, 24], [48, 12], [32, 16], [32, 8], [16, 16], [8, 8]];
const UPRIGHT_BLOCKS: [[usize; 2]; 3] = [[MAX_SIDE, 1], [48, 1], [8, 1]];

/// The rows of samples that [`crop`] writes, with three values for each sample.
pub trait Rows {
    /// The values of a row.
    fn row(&mut self, row: usize) -> &mut [f32];
}

impl Rows for dyn Network {
    fn row(&mut self, row: usize) -> &mut [f32] {
        self.input_row(row)
    }
}

impl<const VALUES: usize> Rows for Vec<[f32; VALUES]> {
    fn row(&mut self, row: usize) -> &mut [f32] {
        self.get_mut(row).map_or(&mut [], |row| row)
    }
}

/// Samples `picture` inside `region`. A region larger than 32,000 px is sampled as if its size were 32,000 px.
pub fn crop(
    picture: &Picture,
    region: &FaceBox,
    shape: CropShape,
    block: &mut Block,
    output: &mut (impl Rows + ?Sized),
) {
    let CropShape { side, border, .. } = shape;
    let mut rows = [Row::default(); MAX_SIDE];
    let mapping = region.mapping();
    let step = step(&mapping, side);
    for (number, row) in rows.iter_mut().enumerate().take(side) {
        *row = Row { start: start(&mapping, side, number), step };
    }
    let mut crop = Crop { planes: Planes::new(picture), shape, block };
    let sizes: &[_] = if border == Border::Black { &UPRIGHT_BLOCKS } else { &ROTATED_BLOCKS };
    let fitting = sizes.iter().find(|size| Block::holds(**size, step));
    let [columns, height] = fitting.or(sizes.last()).copied().unwrap_or([1, 1]);
    for (number, rows) in rows.get(..side).unwrap_or(&rows).chunks(height).enumerate() {
        for first in (0..side).step_by(columns) {
            crop.write(number * height, rows, first..side.min(first + columns), output);
        }
    }
}

/// What the blocks of a crop have in common.
struct Crop<'a> {
    planes: Planes<'a>,
    shape: CropShape,
    block: &'a mut Block,
}

impl Crop<'_> {
    /// Writes a block of samples, whose first row has the number `first`.
    fn write(&mut self, first: usize, rows: &[Row], columns: Range<usize>, output: &mut (impl Rows + ?Sized)) {
        let [low, high] = self.shape.range;
        let scale = (high - low) / WHITE as f32;
        let is_filled = self.block.fill(&self.planes, rows, columns.clone()).is_some();
        for (number, row) in (first..).zip(rows) {
            let Some(output) = output.row(number).get_mut(3 * columns.start..3 * columns.end) else { continue };
            if is_filled {
                self.block.sample(row, columns.start, scale, output);
            } else {
                self.sample_each(row, columns.start, scale, output);
            }
            if self.shape.border == Border::Black {
                self.blacken_outside(row, columns.start, output);
            }
            if low != 0.0 {
                for value in output {
                    *value += low;
                }
            }
        }
    }

    /// Computes samples for which [`Block::fill`] fails: converts the four pixels around each sample.
    fn sample_each(&self, row: &Row, first: usize, scale: f32, output: &mut [f32]) {
        for (number, output) in (first..).zip(output.chunks_exact_mut(3)) {
            let [x, y] = row.position(number);
            let [left, top] = [x, y].map(|at| at >> 16);
            let around = [[left, top], [left + 1, top], [left, top + 1], [left + 1, top + 1]];
            let pixels = around.map(|at| self.planes.nearest(at));
            let start = [x, y].map(|at| at & 0xffff);
            sample(&Line { pixels: &pixels, stride: 2, start, step: [0; 2], scale }, output);
        }
    }

    /// Sets samples outside the picture to black.
    fn blacken_outside(&self, row: &Row, first: usize, output: &mut [f32]) {
        for (number, output) in (first..).zip(output.chunks_exact_mut(3)) {
            if !self.planes.contain(row.position(number).map(|at| at >> 16)) {
                output.fill(0.0);
            }
        }
    }
}

/// The position of the first sample of a row, plus 1/64 px. Rounding the sum down rounds the position to the nearest
/// 1/32 px.
#[expect(clippy::cast_possible_truncation, reason = "saturates: a position so far outside is border in any case")]
fn start(mapping: &Mapping, side: usize, row: usize) -> [i32; 2] {
    let pitch = 1.0 / side as f32;
    mapping.to_picture(0.0, row as f32 * pitch).map(|at| ((at * ONE) as i32).saturating_add(HALF_32ND))
}

/// The step from a sample to the next one of its row.
#[expect(clippy::cast_possible_truncation, reason = "saturates")]
fn step(mapping: &Mapping, side: usize) -> [i32; 2] {
    mapping.step(side).map(|along| ((along * ONE) as i32).clamp(-MAX_STEP, MAX_STEP))
}

#[cfg(test)]
#[path = "crop_tests.rs"]
mod tests;
