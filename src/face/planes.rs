//! One view of all pixel formats: a luma plane and two chroma planes.

use crate::capture::{Picture, Pixels};

use super::colour::Colour;

/// Chroma of grey: what a picture without chroma planes has everywhere.
const GREY: u8 = 128;

/// Samples `step` bytes apart in rows `stride` bytes apart, each for `1 << shift` pixels of the picture.
struct Plane<'a> {
    data: &'a [u8],
    stride: usize,
    step: usize,
    shift: [u8; 2],
}

/// A picture as planes of samples.
pub(super) struct Planes<'a> {
    luma: Plane<'a>,
    chroma: [Plane<'a>; 2],
    colour: &'static Colour,
    /// Last column and row.
    last: [i32; 2],
}

impl Plane<'_> {
    fn get(&self, x: usize, y: usize) -> u8 {
        let at = (y >> self.shift[1]) * self.stride + (x >> self.shift[0]) * self.step;
        self.data.get(at).copied().unwrap_or(GREY)
    }
}

impl Planes<'_> {
    /// The pixel at a column and row, or the nearest one to a place outside the picture.
    pub(super) fn pixel(&self, x: i32, y: i32) -> u64 {
        let x = x.clamp(0, self.last[0]).unsigned_abs() as usize;
        let y = y.clamp(0, self.last[1]).unsigned_abs() as usize;
        let [blue, red] = &self.chroma;
        self.colour.pixel(self.luma.get(x, y), blue.get(x, y), red.get(x, y))
    }

    /// Whether there is a pixel at a column and row.
    pub(super) fn hold(&self, x: i32, y: i32) -> bool {
        (0..=self.last[0]).contains(&x) && (0..=self.last[1]).contains(&y)
    }
}

impl<'a> Planes<'a> {
    pub(super) fn of(picture: &Picture<'a>) -> Self {
        let plane = |data, stride, step, shift| Plane { data, stride, step, shift };
        let from = |data: &'a [u8], first: usize| data.get(first..).unwrap_or(&[]);
        let (luma, chroma) = match picture.pixels {
            Pixels::Grey { data, stride } => {
                (plane(data, stride, 1, [0, 0]), [(); 2].map(|()| plane(&[], 0, 0, [0, 0])))
            }
            Pixels::Yuyv { data, stride } => {
                (plane(data, stride, 2, [0, 0]), [1, 3].map(|first| plane(from(data, first), stride, 4, [1, 0])))
            }
            Pixels::Nv12 { luma, chroma, stride } => {
                (plane(luma, stride, 1, [0, 0]), [0, 1].map(|first| plane(from(chroma, first), stride, 2, [1, 1])))
            }
            Pixels::Planar { planes: [luma, blue, red], strides, chroma_shift } => {
                (plane(luma, strides[0], 1, [0, 0]), [blue, red].map(|data| plane(data, strides[1], 1, chroma_shift)))
            }
        };
        let last =
            [picture.width, picture.height].map(|size| i32::try_from(size).unwrap_or(0).saturating_sub(1).max(0));
        Self { luma, chroma, colour: Colour::of(picture.full_range), last }
    }
}
