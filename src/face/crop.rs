//! Sampling a region of the picture into a network's input, straight from the camera's pixel format.
//!
//! The arithmetic is that of the pictures MediaPipe is used with, so that landmarks agree with it to a fraction of a
//! pixel: bilinear to 1/32 px from the corners of the samples, as OpenCV's `warpPerspective`. Colour conversion happens
//! per sample (see [`super::colour`]), so its cost is that of the crop and not of the frame.
//! Pictures may be up to 16,384 px a side.

use crate::capture::Picture;

use super::colour::{BLACK, unpack};
use super::planes::Planes;
use super::region::FaceBox;

/// One pixel in the 16.16 fixed point of positions along a row.
const ONE: f32 = 65536.0;
/// From 16.16 to 1/32 px.
const TO_32NDS: u32 = 11;
/// 1/64 px, to round.
const HALF_32ND: i32 = 1 << (TO_32NDS - 1);
/// More samples per row than any network takes.
const MAX_SIDE: usize = 192;

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
    let area = shape.side * shape.side;
    let (red, rest) = input.split_at_mut(area.min(input.len()));
    let (green, blue) = rest.split_at_mut(area.min(rest.len()));
    let mut pixels = [0; MAX_SIDE];
    let rows = red.chunks_exact_mut(shape.side).zip(green.chunks_exact_mut(shape.side));
    for (row, ((red, green), blue)) in rows.zip(blue.chunks_exact_mut(shape.side)).enumerate() {
        let positions = positions(region, shape.side, row);
        for (pixel, at) in pixels.iter_mut().zip(&positions).take(shape.side) {
            *pixel = sample(&planes, *at);
        }
        if shape.border == Border::Black {
            blacken(&planes, &positions, &mut pixels);
        }
        for (channel, output) in [red, green, blue].into_iter().enumerate() {
            unpack(&pixels, channel, shape.range, output);
        }
    }
}

/// Positions of one row of samples in 1/32 px, pixel centres being whole numbers.
#[expect(clippy::cast_possible_truncation, reason = "saturates: what lies that far outside is border")]
fn positions(region: &FaceBox, side: usize, row: usize) -> [[i32; 2]; MAX_SIDE] {
    let pitch = 1.0 / side as f32;
    let start = region.to_picture(0.0, row as f32 * pitch).map(|position| (position * ONE) as i32);
    let (sin, cos) = region.angle_rad.sin_cos();
    let step = [cos, sin].map(|along| (along * region.size * pitch * ONE) as i32);
    let mut at = start.map(|start| start.saturating_add(HALF_32ND));
    let mut positions = [[0; 2]; MAX_SIDE];
    for position in &mut positions {
        *position = at.map(|at| at >> TO_32NDS);
        at = [at[0].wrapping_add(step[0]), at[1].wrapping_add(step[1])];
    }
    positions
}

/// The pixel at a position, its channels weighted by 1024.
fn sample(planes: &Planes, at: [i32; 2]) -> u64 {
    let [x, y] = at.map(|at| at >> 5);
    let [right, down] = at.map(|at| u64::from((at & 31).unsigned_abs()));
    let rows = planes.square(x, y);
    let [top, bottom] = rows.map(|[left_pixel, right_pixel]| left_pixel * (32 - right) + right_pixel * right);
    top * (32 - down) + bottom * down
}

fn blacken(planes: &Planes, positions: &[[i32; 2]], pixels: &mut [u64]) {
    for (pixel, [x, y]) in pixels.iter_mut().zip(positions) {
        if !planes.hold(x >> 5, y >> 5) {
            *pixel = BLACK;
        }
    }
}
