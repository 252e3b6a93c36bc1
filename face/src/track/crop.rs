//! Samples a region of the picture into a network's input, straight from the camera's pixel format.
//!
//! The arithmetic is that of OpenCV's `warpPerspective`, which MediaPipe uses, so that the landmarks agree to a fraction
//! of a pixel: positions are rounded to 1/32 px, whole numbers are centres of pixels, the first sample of a row lies on
//! the edge of the region, and the four pixels around a position are interpolated linearly.

use std::ops::Range;

use facewire_engine::kernels::sample::{Line, WHITE, sample};

use crate::infer::Network;
use crate::picture::Picture;

use super::block::{Block, Planes, Row};
use super::landmarks::FaceBox;

/// One pixel in the 16.16 fixed point of positions along a row.
const ONE: f32 = 65536.0;
/// 1/64 px in 16.16, which is added to round to the nearest 1/32 px.
const HALF_32ND: i32 = 1 << 10;
const MAX_SIDE: usize = 192;
/// Longest step from one sample to the next, about 170 px. With a longer one the positions of a row would overflow.
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

/// Sizes of blocks, in columns and rows of samples. [`crop`] takes the first size whose pixels fit the memory. A region
/// with a black border is not tilted, so that few pixels lie around a single row of samples.
const TILTED_BLOCKS: [[usize; 2]; 10] =
    [[96, 96], [96, 48], [96, 24], [48, 48], [48, 24], [48, 12], [32, 16], [32, 8], [16, 16], [8, 8]];
const LEVEL_BLOCKS: [[usize; 2]; 3] = [[MAX_SIDE, 1], [48, 1], [8, 1]];

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

/// Samples the upright `picture` inside `region`. A region larger than 32,000 px is sampled as if its size were 32,000 px.
#[expect(clippy::cast_possible_truncation, reason = "saturates: a position so far outside is border in any case")]
pub fn crop(
    picture: &Picture,
    region: &FaceBox,
    shape: CropShape,
    block: &mut Block,
    output: &mut (impl Rows + ?Sized),
) {
    let CropShape { side, border, .. } = shape;
    let mapping = region.mapping();
    let pitch = 1.0 / side as f32;
    let across = picture.rotation().in_rows(mapping.across, [0.0; 2]);
    let step = across.map(|along| ((along * region.size * pitch * ONE) as i32).clamp(-MAX_STEP, MAX_STEP));
    let mut rows = [Row { start: [0; 2], step }; MAX_SIDE];
    for (number, row) in rows.iter_mut().enumerate().take(side) {
        let start = picture.in_rows(mapping.to_picture(0.0, number as f32 * pitch));
        // With 1/64 px added, rounding down gives the nearest 1/32 px.
        row.start = start.map(|at| ((at * ONE) as i32).saturating_add(HALF_32ND));
    }
    let mut crop = Crop { planes: Planes::new(picture), shape, block };
    let is_level = border == Border::Black && !picture.rotation().is_sideways();
    let sizes: &[_] = if is_level { &LEVEL_BLOCKS } else { &TILTED_BLOCKS };
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

#[cfg(test)]
#[allow(clippy::float_cmp, clippy::cast_possible_truncation, clippy::cast_possible_wrap, clippy::cast_sign_loss)]
mod tests {
    use super::*;
    use crate::picture::{Pixels, Rotation};

    fn samples(picture: &Picture, region: &FaceBox, shape: CropShape, block: &mut Block) -> Vec<[f32; 3]> {
        let mut rows = vec![[f32::NAN; 3 * MAX_SIDE]; shape.side];
        crop(picture, region, shape, block, &mut rows);
        rows.iter().flat_map(|row| row.as_chunks().0.iter().take(shape.side)).copied().collect()
    }

    /// Pixels of a random format whose planes have no byte to spare, in a picture of this size.
    fn pixels<'a>(random: &mut fastrand::Rng, [width, height]: [usize; 2], data: &'a [u8]) -> Pixels<'a> {
        let pad = random.usize(..20);
        let plane = |from: usize, row: usize, rows: usize| &data[from..from + (row + pad) * (rows - 1) + row];
        let [half_width, half_height] = [width, height].map(|size| size.div_ceil(2));
        let stride = width + pad;
        match random.u8(..10) {
            8 | 9 => {
                let (step, rgb) = [(3, [0, 1, 2]), (3, [2, 1, 0]), (4, [2, 1, 0]), (5, [1, 4, 2])][random.usize(..4)];
                Pixels::Packed { data: plane(5, step * width, height), stride: step * width + pad, step, rgb }
            }
            0 | 1 => Pixels::Yuyv { data: plane(0, 4 * half_width, height), stride: 4 * half_width + pad },
            2 | 3 => {
                let luma = plane(0, 2 * half_width, height);
                let chroma = plane(7, 2 * half_width, half_height);
                Pixels::Nv12 { luma, chroma, stride: 2 * half_width + pad }
            }
            4 => Pixels::Grey { data: plane(0, width, height), stride },
            _ => {
                let chroma_shift = [[1, 1], [1, 0], [0, 0], [2, 0], [0, 1]][random.usize(..5)];
                let row = width.div_ceil(1 << chroma_shift[0]);
                let rows = height.div_ceil(1 << chroma_shift[1]);
                let planes = [plane(0, width, height), plane(3, row, rows), plane(9, row, rows)];
                Pixels::Planar { planes, strides: [stride, row + pad], chroma_shift }
            }
        }
    }

    #[test]
    fn blocks_of_any_format_size_and_region_give_the_samples_of_single_pixels_bit_for_bit() {
        let mut random = fastrand::Rng::with_seed(11);
        // Without memory for a block, each sample is computed from the four pixels around it.
        let mut block = Block::default();
        let mut plain = Block::default();
        plain.groups = Box::default();
        for round in 0..200 {
            let size = [random.usize(1..150), random.usize(1..150)];
            let data: Vec<u8> = (0..120_000).map(|_| random.u8(..)).collect();
            let pixels = pixels(&mut random, size, &data);
            let picture = Picture::new(size[0], size[1], pixels, random.bool()).expect("a whole picture");
            let far = [40.0, 200.0, 1e5][random.usize(..3)];
            let large = [100.0, 700.0, 5000.0, 1e6][random.usize(..4)];
            let mut place = |size: usize| random.f32() * size as f32 + (random.f32() - 0.5) * far;
            let centre = [place(size[0]), place(size[1])];
            let angle_rad = (random.f32() - 0.5) * [0.4, 6.3][random.usize(..2)];
            let region = FaceBox { centre, size: random.f32() * large, angle_rad };
            let shapes = [([0.0, 1.0], Border::Replicate), ([-1.0, 1.0], Border::Black)];
            let (range, border) = shapes[random.usize(..2)];
            let shape = CropShape { side: [192, 128, 1, random.usize(1..=192)][random.usize(..4)], range, border };
            let [found, wanted] = [&mut block, &mut plain].map(|block| samples(&picture, &region, shape, block));
            let wrong = found.iter().zip(&wanted).position(|(found, wanted)| found != wanted);
            assert_eq!(wrong, None, "round {round}: {size:?} {region:?} {shape:?}");
        }
    }

    #[test]
    fn samples_are_interpolated_between_the_centres_of_pixels_and_black_outside() {
        let data: Vec<u8> = (0..16_u8).flat_map(|y| (0..16).map(move |x| 3 * x + 10 * y)).collect();
        let picture = Picture::new(16, 16, Pixels::Grey { data: &data, stride: 16 }, true).expect("a whole picture");
        let region = FaceBox { centre: [8.0; 2], size: 32.0, angle_rad: 0.0 };
        let shape = CropShape { side: 64, range: [-1.0, 1.0], border: Border::Black };
        for (number, sample) in samples(&picture, &region, shape, &mut Block::default()).iter().enumerate() {
            let [x, y] = [number % 64, number / 64].map(|at| at as f32 / 2.0 - 8.0);
            let is_inside = [x, y].iter().all(|at| (0.0..16.0).contains(at));
            let level = if is_inside { 3.0 * x.min(15.0) + 10.0 * y.min(15.0) } else { 0.0 };
            let wanted = 2.0 * level / 255.0 - 1.0;
            assert!(sample.iter().all(|value| (value - wanted).abs() < 1e-4), "{x} {y}: {sample:?}");
        }
    }

    #[test]
    fn a_picture_that_is_turned_gives_the_samples_of_the_upright_one() {
        const SIZE: [usize; 2] = [60, 40];
        let level = |[x, y]: [usize; 2]| (3 * x + 2 * y) as u8;
        let region = FaceBox { centre: [31.0, 19.5], size: 28.0, angle_rad: 0.3 };
        let mut block = Block::default();
        for (shape, region) in [
            (CropShape { side: 64, range: [0.0, 255.0], border: Border::Replicate }, region),
            (CropShape { side: 64, range: [0.0, 255.0], border: Border::Black }, FaceBox { angle_rad: 0.0, ..region }),
        ] {
            let mut seen = Rotation::ALL.map(|rotation| {
                let [width, height] = if rotation.is_sideways() { [SIZE[1], SIZE[0]] } else { SIZE };
                let empty = vec![0; width * height];
                let pixels = |data| Pixels::Grey { data, stride: width };
                let picture = |data| Picture::new(width, height, pixels(data), true).expect("whole").rotated(rotation);
                let turned = picture(&empty);
                assert_eq!(turned.size_px(), SIZE.map(|side| side as f32));
                let mut data = empty.clone();
                for at in (0..SIZE[1]).flat_map(|y| (0..SIZE[0]).map(move |x| [x, y])) {
                    let [x, y] = turned.in_rows(at.map(|place| place as f32)).map(|place| place as usize);
                    data[y * width + x] = level(at);
                }
                samples(&picture(&data), &region, shape, &mut block)
            });
            let [upright, turned @ ..] = &mut seen;
            for turned in turned {
                let errors = turned.iter().zip(&*upright).map(|(one, other)| (one[0] - other[0]).abs());
                // A position is rounded to 1/32 px, in the direction of the rows.
                assert!(errors.fold(0.0, f32::max) < 5.5 / 32.0);
            }
        }
    }

    #[test]
    fn a_region_of_any_size_samples_only_the_picture() {
        // All pixels have the same colour, which is not grey, and the padding of each row has other bytes.
        let data = [[90, 100, 90, 180].repeat(6), vec![0; 24]].concat().repeat(18);
        let picture = Picture::new(12, 18, Pixels::Yuyv { data: &data, stride: 48 }, true).expect("all rows are there");
        let shape = CropShape { side: MAX_SIDE, range: [0.0, 1.0], border: Border::Replicate };
        // Without a limit of the step, the first and last samples of a row alone would be inside at 65,879 px.
        for size in [0.0, 20.0, 4000.0, 65_879.125, 1e9, f32::INFINITY, f32::NAN] {
            let region = FaceBox { centre: [5.0 + size / 2.0; 2], size, angle_rad: 0.0 };
            let samples = samples(&picture, &region, shape, &mut Block::default());
            assert!(samples.iter().all(|sample| *sample == samples[0] && sample[0].is_finite()), "{size} px");
        }
    }
}
