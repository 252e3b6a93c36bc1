//! Reads pixels of a picture of any format as red, green and blue.
//!
//! The conversion is BT.601 in the 13-bit fixed point of libswscale, which rounds each product down by itself. Half a level
//! of brightness visibly moves the landmarks, so agreement with MediaPipe needs the same rounding.

use facewire_engine::kernels::convert::{Factors, GROUP, NO_COLOUR, Samples, convert};
use facewire_engine::kernels::sample::Pixel;

use super::block::signed;
use crate::picture::{Picture, Pixels};

static FULL_RANGE: Factors = Factors { luma: 8192, black: 0, red: 11485, green: [-2819, -5850], blue: 14516 };
static VIDEO_RANGE: Factors = Factors { luma: 9539, black: 16, red: 13075, green: [-3209, -6660], blue: 16525 };

/// The pixels of a picture.
pub(super) struct Planes<'a> {
    pixels: Pixels<'a>,
    factors: &'static Factors,
    /// The last column and the last row of the picture.
    last: [i32; 2],
}

impl<'a> Planes<'a> {
    /// The pixels of `picture`.
    pub(super) fn new(picture: &Picture<'a>) -> Self {
        let last = [picture.width, picture.height].map(|size| i32::try_from(size).unwrap_or(0).max(1) - 1);
        Self { pixels: picture.pixels, factors: if picture.full_range { &FULL_RANGE } else { &VIDEO_RANGE }, last }
    }

    /// Whether a column and a row are inside the picture.
    pub(super) fn contain(&self, [x, y]: [i32; 2]) -> bool {
        (0..=self.last[0]).contains(&x) && (0..=self.last[1]).contains(&y)
    }

    /// Converts the pixel at a column and a row. Outside the picture, converts the nearest pixel of the picture.
    #[inline]
    pub(super) fn nearest(&self, [x, y]: [i32; 2]) -> Pixel {
        let [x, y] = [(x, self.last[0]), (y, self.last[1])].map(|(at, last)| at.clamp(0, last).unsigned_abs() as usize);
        let get = |plane: &[u8], at: usize| plane.get(at).copied().unwrap_or(NO_COLOUR);
        let samples = match self.pixels {
            Pixels::Yuyv { data, stride } => [2 * x, x / 2 * 4 + 1, x / 2 * 4 + 3].map(|at| get(data, y * stride + at)),
            Pixels::Nv12 { luma, chroma, stride } => {
                let at = y / 2 * stride + x / 2 * 2;
                [get(luma, y * stride + x), get(chroma, at), get(chroma, at + 1)]
            }
            Pixels::Planar { planes: [luma, cb, cr], strides, chroma_shift } => {
                let at = (y >> chroma_shift[1]) * strides[1] + (x >> chroma_shift[0]);
                [get(luma, y * strides[0] + x), get(cb, at), get(cr, at)]
            }
            Pixels::Grey { data, stride } => [get(data, y * stride + x), NO_COLOUR, NO_COLOUR],
        };
        self.factors.pixel(samples)
    }

    /// Converts groups of pixels of a row, the first of which is at an even column. A pixel outside the picture
    /// becomes the nearest pixel of the picture.
    pub(super) fn convert(&self, [x, y]: [i32; 2], groups: &mut [[Pixel; GROUP]]) {
        let y = y.clamp(0, self.last[1]);
        let left = (x.min(0).unsigned_abs() as usize).div_ceil(GROUP).min(groups.len());
        let (before, rest) = groups.split_at_mut(left);
        let inside_x = x.saturating_add(signed(left * GROUP));
        let inside = usize::try_from((self.last[0] + 1).saturating_sub(inside_x)).unwrap_or(0) / GROUP;
        let (within, after) = rest.split_at_mut(inside.min(rest.len()));
        self.convert_each([x, y], before);
        self.convert_each([inside_x.saturating_add(signed(within.len() * GROUP)), y], after);
        match self.row([inside_x, y]) {
            Some(samples) => convert(self.factors, &samples, within),
            None => self.convert_each([inside_x, y], within),
        }
    }

    /// Does the same as [`Planes::convert`], pixel by pixel, for any columns and any format.
    fn convert_each(&self, [x, y]: [i32; 2], groups: &mut [[Pixel; GROUP]]) {
        if groups.is_empty() {
            return;
        }
        let pixels = groups.as_flattened_mut();
        let until = |column: i32| usize::try_from(column.saturating_sub(x)).unwrap_or(0);
        let (before, rest) = pixels.split_at_mut(until(0).min(pixels.len()));
        let first_inside = x.max(0);
        let (inside, after) = rest.split_at_mut(until(self.last[0] + 1).saturating_sub(before.len()).min(rest.len()));
        before.fill(self.nearest([0, y]));
        for (x, pixel) in (first_inside..).zip(inside) {
            *pixel = self.nearest([x, y]);
        }
        after.fill(self.nearest([self.last[0], y]));
    }

    /// The samples of a row from an even column on. Returns `None` for a format that is not converted in groups.
    fn row(&self, [x, y]: [i32; 2]) -> Option<Samples<'a>> {
        let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
        match self.pixels {
            Pixels::Yuyv { data, stride } => data.get(y * stride + 2 * x..).map(Samples::Yuyv),
            Pixels::Nv12 { luma, chroma, stride } => {
                Some(Samples::SemiPlanar(luma.get(y * stride + x..)?, chroma.get(y / 2 * stride + x..)?))
            }
            Pixels::Planar { planes: [luma, cb, cr], strides, chroma_shift: [1, down] } => {
                let at = (y >> down) * strides[1] + x / 2;
                Some(Samples::Planar([luma.get(y * strides[0] + x..)?, cb.get(at..)?, cr.get(at..)?]))
            }
            Pixels::Planar { .. } => None,
            Pixels::Grey { data, stride } => data.get(y * stride + x..).map(Samples::Grey),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// BT.601 in floating point, full range.
    fn exact([luma, cb, cr]: [u8; 3]) -> [f32; 3] {
        let [luma, cb, cr] = [f32::from(luma), f32::from(cb) - 128.0, f32::from(cr) - 128.0];
        [luma + 1.402 * cr, luma - 0.344_136 * cb - 0.714_136 * cr, luma + 1.772 * cb]
    }

    #[test]
    fn every_colour_is_within_two_levels_of_bt601() {
        let steps = || (0..=255).step_by(5);
        for (luma, cb) in steps().flat_map(|luma| steps().map(move |cb| (luma, cb))) {
            for cr in steps() {
                let ours = FULL_RANGE.pixel([luma, cb, cr]);
                for (ours, exact) in ours.into_iter().zip(exact([luma, cb, cr])) {
                    assert!((f32::from(ours) - exact).abs() <= 2.01, "{luma} {cb} {cr}: {ours} {exact}");
                }
            }
        }
    }

    #[test]
    fn luma_16_and_235_of_a_video_are_black_and_white() {
        assert_eq!(VIDEO_RANGE.pixel([16, 128, 128]), [0, 0, 0, 0]);
        assert_eq!(VIDEO_RANGE.pixel([235, 128, 128]), [255, 255, 255, 0]);
    }

    #[test]
    fn every_channel_lies_within_the_range_of_a_pixel() {
        let ends = [0, 16, 128, 240, 255];
        for factors in [&FULL_RANGE, &VIDEO_RANGE] {
            for (cb, cr) in ends.iter().flat_map(|cb| ends.map(|cr| (*cb, cr))) {
                for luma in ends {
                    let pixel = factors.pixel([luma, cb, cr]);
                    assert!(pixel.iter().all(|channel| (-511..=1023).contains(channel)), "{pixel:?}");
                }
            }
        }
    }
}
