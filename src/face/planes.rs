//! Shows a picture of any pixel format as one luma plane and two chroma planes.

use crate::capture::{Picture, Pixels};

use super::colour::Colour;

/// Chroma of a picture without chroma planes.
const GREY: u8 = 128;

/// Where the samples of a plane are in memory.
struct Layout {
    /// Bytes from one row of samples to the next.
    stride: usize,
    /// Bytes from one sample of a row to the next.
    step: usize,
    /// Binary logarithm of the columns and rows of pixels that share a sample.
    shift: [u8; 2],
}

/// A picture as planes of samples.
pub(super) struct Planes<'a> {
    luma: &'a [u8],
    luma_layout: Layout,
    /// Cb and Cr, which have the same layout. Empty for a grey picture.
    chroma: [&'a [u8]; 2],
    chroma_layout: Layout,
    colour: &'static Colour,
    /// The last column and the last row of the picture.
    last: [i32; 2],
}

impl Layout {
    #[inline]
    fn index(&self, x: usize, y: usize) -> usize {
        (y >> self.shift[1]) * self.stride + (x >> self.shift[0]) * self.step
    }
}

impl Planes<'_> {
    /// The pixels at columns `x` and `x + 1` of rows `y` and `y + 1`. The nearest pixel replaces each one outside the
    /// picture.
    pub(super) fn nearest_square(&self, x: i32, y: i32) -> [[u64; 2]; 2] {
        let nearest = |at: i32, last: i32| at.clamp(0, last).unsigned_abs() as usize;
        let columns = [x, x.saturating_add(1)].map(|x| nearest(x, self.last[0]));
        let rows = [y, y.saturating_add(1)].map(|y| nearest(y, self.last[1]));
        self.square(columns, rows)
    }

    /// The pixels of two columns in two rows, all of which must be inside the picture.
    #[inline]
    pub(super) fn square(&self, [left, right]: [usize; 2], [top, bottom]: [usize; 2]) -> [[u64; 2]; 2] {
        [[self.pixel(left, top), self.pixel(right, top)], [self.pixel(left, bottom), self.pixel(right, bottom)]]
    }

    #[inline]
    fn pixel(&self, x: usize, y: usize) -> u64 {
        let get = |data: &[u8], at: usize| data.get(at).copied().unwrap_or(GREY);
        let ([cb, cr], chroma) = (self.chroma, self.chroma_layout.index(x, y));
        self.colour.pixel(get(self.luma, self.luma_layout.index(x, y)), get(cb, chroma), get(cr, chroma))
    }

    /// Whether columns `x` and `x + 1` of rows `y` and `y + 1` are inside the picture.
    pub(super) fn contain_square(&self, x: i32, y: i32) -> bool {
        (0..self.last[0]).contains(&x) && (0..self.last[1]).contains(&y)
    }

    /// Whether a column and a row are inside the picture.
    pub(super) fn contain(&self, x: i32, y: i32) -> bool {
        (0..=self.last[0]).contains(&x) && (0..=self.last[1]).contains(&y)
    }
}

impl<'a> Planes<'a> {
    /// The planes of a picture.
    pub(super) fn new(picture: &Picture<'a>) -> Self {
        let layout = |stride, step, shift| Layout { stride, step, shift };
        let from = |data: &'a [u8], first: usize| data.get(first..).unwrap_or(&[]);
        let (luma, luma_layout, chroma, chroma_layout) = match picture.pixels {
            Pixels::Grey { data, stride } => (data, layout(stride, 1, [0, 0]), [&[] as &[u8]; 2], layout(0, 0, [0, 0])),
            Pixels::Yuyv { data, stride } => {
                (data, layout(stride, 2, [0, 0]), [from(data, 1), from(data, 3)], layout(stride, 4, [1, 0]))
            }
            Pixels::Nv12 { luma, chroma, stride } => {
                (luma, layout(stride, 1, [0, 0]), [chroma, from(chroma, 1)], layout(stride, 2, [1, 1]))
            }
            Pixels::Planar { planes: [luma, cb, cr], strides, chroma_shift } => {
                (luma, layout(strides[0], 1, [0, 0]), [cb, cr], layout(strides[1], 1, chroma_shift))
            }
        };
        let last =
            [picture.width, picture.height].map(|size| i32::try_from(size).unwrap_or(0).saturating_sub(1).max(0));
        Self { luma, luma_layout, chroma, chroma_layout, colour: Colour::for_range(picture.full_range), last }
    }
}
