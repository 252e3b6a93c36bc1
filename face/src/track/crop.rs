//! Samples a region of the picture into a network's input, straight from the camera's pixel format.
//!
//! The arithmetic is that of OpenCV's `warpPerspective`, which MediaPipe uses, so that the landmarks agree to a fraction
//! of a pixel: positions are rounded to 1/32 px, whole numbers are centres of pixels, the first sample of a row lies on
//! the edge of the region, and the four pixels around a position are interpolated linearly.
//! Only the region is converted to red, green and blue (see [`Planes`]), and not the picture. A side of the picture
//! may have up to 16,384 px.

use std::ops::Range;

use facewire_engine::kernels::sample::{Line, WHITE, sample};

use crate::infer::Network;
use crate::picture::Picture;

use super::block::{Block, Planes, Row};
use super::landmarks::{FaceBox, Mapping};

/// One pixel in the 16.16 fixed point of positions along a row.
const ONE: f32 = 65536.0;
/// 1/64 px in 16.16, which is added to round to the nearest 1/32 px.
const HALF_32ND: i32 = 1 << 10;
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

struct Crop<'a> {
    planes: Planes<'a>,
    shape: CropShape,
    block: &'a mut Block,
}

impl Crop<'_> {
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

#[expect(clippy::cast_possible_truncation, reason = "saturates")]
fn step(mapping: &Mapping, side: usize) -> [i32; 2] {
    mapping.step(side).map(|along| ((along * ONE) as i32).clamp(-MAX_STEP, MAX_STEP))
}

#[cfg(test)]
#[allow(clippy::float_cmp, clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::cast_sign_loss)]
mod tests {
    use super::*;
    use crate::picture::Pixels;

    /// Red, green and blue of a pixel that is inside the picture.
    fn pixel(picture: &Picture, x: usize, y: usize) -> [i64; 3] {
        let (luma, cb, cr) = match picture.pixels {
            Pixels::Yuyv { data, stride } => {
                let row = &data[y * stride..];
                (row[2 * x], row[x / 2 * 4 + 1], row[x / 2 * 4 + 3])
            }
            Pixels::Nv12 { luma, chroma, stride } => {
                let row = &chroma[y / 2 * stride..];
                (luma[y * stride + x], row[x / 2 * 2], row[x / 2 * 2 + 1])
            }
            Pixels::Planar { planes: [luma, cb, cr], strides, chroma_shift: [right, down] } => {
                let at = (y >> down) * strides[1] + (x >> right);
                (luma[y * strides[0] + x], cb[at], cr[at])
            }
            Pixels::Grey { data, stride } => (data[y * stride + x], 128, 128),
        };
        let product = |sample: i64, factor: i64| (sample * factor).div_euclid(8192);
        let (luma, cb, cr) = (i64::from(luma), i64::from(cb) - 128, i64::from(cr) - 128);
        if picture.full_range {
            [luma + product(cr, 11485), luma + product(cb, -2819) + product(cr, -5850), luma + product(cb, 14516)]
        } else {
            let luma = product(luma - 16, 9539);
            [luma + product(cr, 13075), luma + product(cb, -3209) + product(cr, -6660), luma + product(cb, 16525)]
        }
    }

    fn plain_crop(picture: &Picture, region: &FaceBox, shape: CropShape) -> Vec<[f32; 3]> {
        let [width, height] = [picture.width as i32, picture.height as i32];
        let nearest = |x: i32, y: i32| pixel(picture, x.clamp(0, width - 1) as usize, y.clamp(0, height - 1) as usize);
        let sample = |[x, y]: [i32; 2]| {
            let ([left, top], [right, down]) = ([x >> 16, y >> 16], [x, y].map(|at| i64::from(at >> 11 & 31)));
            let corners = [
                (nearest(left, top), (32 - right) * (32 - down)),
                (nearest(left + 1, top), right * (32 - down)),
                (nearest(left, top + 1), (32 - right) * down),
                (nearest(left + 1, top + 1), right * down),
            ];
            let inside = (0..width).contains(&left) && (0..height).contains(&top);
            [0, 1, 2].map(|channel| {
                let sum: i64 = corners.iter().map(|(pixel, weight)| pixel[channel] * weight).sum();
                let level = if inside || shape.border == Border::Replicate { sum.clamp(0, 255 * 1024) } else { 0 };
                level as f32 * ((shape.range[1] - shape.range[0]) / (255.0 * 1024.0)) + shape.range[0]
            })
        };
        let (mapping, side) = (region.mapping(), shape.side);
        let row = |row: usize| Row { start: start(&mapping, side, row), step: step(&mapping, side) };
        (0..side).flat_map(|number| (0..side).map(move |column| row(number).position(column))).map(sample).collect()
    }

    fn samples(picture: &Picture, region: &FaceBox, shape: CropShape, block: &mut Block) -> Vec<[f32; 3]> {
        let mut rows = vec![[f32::NAN; 3 * MAX_SIDE]; shape.side];
        crop(picture, region, shape, block, &mut rows);
        rows.iter().flat_map(|row| row.as_chunks().0.iter().take(shape.side)).copied().collect()
    }

    /// Pixels of a random format whose planes have no byte to spare, in a picture of this size.
    fn pixels<'a>(random: &mut fastrand::Rng, [width, height]: [usize; 2], data: &'a [u8]) -> Pixels<'a> {
        let pad = random.usize(..20);
        let plane = |from: usize, row: usize, rows: usize| &data[from..from + (row + pad) * (rows - 1) + row];
        let ([half_width, half_height], stride) = ([width, height].map(|size| size.div_ceil(2)), width + pad);
        match random.u8(..8) {
            0 | 1 => Pixels::Yuyv { data: plane(0, 4 * half_width, height), stride: 4 * half_width + pad },
            2 | 3 => {
                let (luma, chroma) = (plane(0, 2 * half_width, height), plane(7, 2 * half_width, half_height));
                Pixels::Nv12 { luma, chroma, stride: 2 * half_width + pad }
            }
            4 => Pixels::Grey { data: plane(0, width, height), stride },
            _ => {
                let chroma_shift = [[1, 1], [1, 0], [0, 0], [2, 0], [0, 1]][random.usize(..5)];
                let [row, rows] = [width.div_ceil(1 << chroma_shift[0]), height.div_ceil(1 << chroma_shift[1])];
                let planes = [plane(0, width, height), plane(3, row, rows), plane(9, row, rows)];
                Pixels::Planar { planes, strides: [stride, row + pad], chroma_shift }
            }
        }
    }

    #[test]
    fn crops_of_any_format_size_and_region_are_those_of_the_plain_reading_bit_for_bit() {
        let mut random = fastrand::Rng::with_seed(11);
        let mut block = Block::default();
        for round in 0..400 {
            let size = [random.usize(1..150), random.usize(1..150)];
            let data: Vec<u8> = (0..60_000).map(|_| random.u8(..)).collect();
            let pixels = pixels(&mut random, size, &data);
            let picture = Picture::new(size[0], size[1], pixels, random.bool()).expect("a whole picture");
            let (far, large) = ([40.0, 200.0, 1e5][random.usize(..3)], [100.0, 700.0, 5000.0, 1e6][random.usize(..4)]);
            let mut place = |size: usize| random.f32() * size as f32 + (random.f32() - 0.5) * far;
            let centre = [place(size[0]), place(size[1])];
            let angle_rad = (random.f32() - 0.5) * [0.4, 6.3][random.usize(..2)];
            let region = FaceBox { centre, size: random.f32() * large, angle_rad };
            let shapes = [([0.0, 1.0], Border::Replicate), ([-1.0, 1.0], Border::Black)];
            let (range, border) = shapes[random.usize(..2)];
            let shape = CropShape { side: [192, 128, 1, random.usize(1..=192)][random.usize(..4)], range, border };
            let wanted = plain_crop(&picture, &region, shape);
            let found = samples(&picture, &region, shape, &mut block);
            let wrong = found.iter().zip(&wanted).position(|(found, wanted)| found != wanted);
            assert_eq!((wrong, found.len()), (None, wanted.len()), "round {round}: {size:?} {region:?} {shape:?}");
        }
    }

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
            let samples = samples(&picture, &region, shape, &mut Block::default());
            assert!(samples.iter().all(|sample| *sample == samples[0] && sample[0].is_finite()), "{size} px");
        }
    }
}
