//! Converts the pixels around a block of samples to red, green and blue at once, which is several times faster than
//! converting the four pixels around each sample.

use std::ops::Range;

use facewire_engine::kernels::convert::{Factors, GROUP, NO_COLOUR, Packing, Samples, convert, unpack};
use facewire_engine::kernels::sample::{Line, Pixel, sample};

use crate::picture::{Picture, Pixels};

static FULL_RANGE: Factors = Factors { luma: 8192, black: 0, red: 11485, green: [-2819, -5850], blue: 14516 };
static VIDEO_RANGE: Factors = Factors { luma: 9539, black: 16, red: 13075, green: [-3209, -6660], blue: 16525 };

/// The pixels of a picture of any format, read as red, green and blue. The conversion is BT.601 in the 13-bit fixed
/// point of libswscale, which rounds each product down by itself. Half a level of brightness visibly moves the
/// landmarks, so agreement with MediaPipe needs the same rounding.
pub(super) struct Planes<'a> {
    pixels: Pixels<'a>,
    factors: &'static Factors,
    last: [i32; 2],
}

impl<'a> Planes<'a> {
    pub(super) fn new(picture: &Picture<'a>) -> Self {
        let last = [picture.width(), picture.height()].map(|size| i32::try_from(size).unwrap_or(0).max(1) - 1);
        Self { pixels: picture.pixels(), factors: if picture.full_range() { &FULL_RANGE } else { &VIDEO_RANGE }, last }
    }

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
            Pixels::Packed { data, stride, step, rgb } => {
                let [red, green, blue] = rgb.map(|at| i16::from(get(data, y * stride + x * step + at)));
                return [red, green, blue, 0];
            }
        };
        self.factors.pixel(samples)
    }

    /// Converts groups of pixels of a row like [`Planes::nearest`]. The first is at an even column.
    fn convert(&self, [x, y]: [i32; 2], groups: &mut [[Pixel; GROUP]]) {
        let y = y.clamp(0, self.last[1]);
        let left = (x.min(0).unsigned_abs() as usize).div_ceil(GROUP).min(groups.len());
        let (before, rest) = groups.split_at_mut(left);
        let inside_x = x.saturating_add(signed(left * GROUP));
        let inside = usize::try_from((self.last[0] + 1).saturating_sub(inside_x)).unwrap_or(0) / GROUP;
        let (within, after) = rest.split_at_mut(inside.min(rest.len()));
        self.convert_each([x, y], before);
        self.convert_each([inside_x.saturating_add(signed(within.len() * GROUP)), y], after);
        match (self.row([inside_x, y]), self.pixels) {
            (Some(samples), _) => convert(self.factors, &samples, within),
            (None, Pixels::Packed { data, stride, step, rgb }) if !within.is_empty() => {
                let at = y.unsigned_abs() as usize * stride + inside_x.unsigned_abs() as usize * step;
                unpack(data.get(at..).unwrap_or_default(), Packing { step, rgb }, within);
            }
            (None, _) => self.convert_each([inside_x, y], within),
        }
    }

    /// Like [`Planes::convert`], for any columns and any format.
    fn convert_each(&self, [x, y]: [i32; 2], groups: &mut [[Pixel; GROUP]]) {
        for (x, pixel) in (x..).zip(groups.as_flattened_mut()) {
            *pixel = self.nearest([x, y]);
        }
    }

    /// The samples of a row from an even column on. Returns `None` for a format that is not converted in groups.
    fn row(&self, [x, y]: [i32; 2]) -> Option<Samples<'a>> {
        let x = usize::try_from(x).ok()?;
        let y = usize::try_from(y).ok()?;
        match self.pixels {
            Pixels::Yuyv { data, stride } => data.get(y * stride + 2 * x..).map(Samples::Yuyv),
            Pixels::Nv12 { luma, chroma, stride } => {
                Some(Samples::SemiPlanar(luma.get(y * stride + x..)?, chroma.get(y / 2 * stride + x..)?))
            }
            Pixels::Planar { planes: [luma, cb, cr], strides, chroma_shift: [1, down] } => {
                let at = (y >> down) * strides[1] + x / 2;
                Some(Samples::Planar([luma.get(y * strides[0] + x..)?, cb.get(at..)?, cr.get(at..)?]))
            }
            Pixels::Planar { .. } | Pixels::Packed { .. } => None,
            Pixels::Grey { data, stride } => data.get(y * stride + x..).map(Samples::Grey),
        }
    }
}

/// Groups of pixels that fit the memory, which takes 128 KiB.
const CAPACITY: usize = 1024;

/// Rows of pixels for which one range of columns around the samples is computed.
const BAND: usize = 8;

/// An upper bound of the distance, in pixels, between a sample and its position without rounding.
const ROUNDING: f32 = 0.5;

/// A row of samples in 16.16 fixed point: the position of the first sample, and the step to the next one.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row {
    pub(super) start: [i32; 2],
    pub(super) step: [i32; 2],
}

impl Row {
    /// The position of a sample. A position that does not fit 16.16 fixed point wraps around.
    pub(super) fn position(&self, number: usize) -> [i32; 2] {
        let Self { start: [x, y], step: [right, down] } = self;
        let number = signed(number);
        [x.wrapping_add(right.wrapping_mul(number)), y.wrapping_add(down.wrapping_mul(number))]
    }

    /// Whether the positions of all samples up to number `last` fit 16.16 fixed point.
    fn fits(&self, last: usize) -> bool {
        let fits = |(start, step): (i32, i32)| step.checked_mul(signed(last)).and_then(|way| start.checked_add(way));
        self.start.into_iter().zip(self.step).all(|axis| fits(axis).is_some())
    }
}

pub(super) fn signed(number: usize) -> i32 {
    i32::try_from(number).unwrap_or(i32::MAX)
}

/// Memory for the pixels around a block of samples.
pub struct Block {
    pub(super) groups: Box<[[Pixel; GROUP]]>,
    width: usize,
    height: usize,
    origin: [i32; 2],
}

impl Default for Block {
    fn default() -> Self {
        // Not zero: the system provides zeroed memory only when it is first written, which would be during the first frame.
        Self { groups: vec![[[1; 4]; GROUP]; CAPACITY].into(), width: 0, height: 0, origin: [0; 2] }
    }
}

impl Block {
    /// Whether the pixels around blocks of `columns` x `rows` samples, which are a `step` apart, fit the memory.
    pub(super) fn holds([columns, rows]: [usize; 2], step: [i32; 2]) -> bool {
        let [along, across] = step.map(|step| step.unsigned_abs() as usize);
        let pixels = |along: usize, across: usize| ((columns - 1) * along + (rows - 1) * across) / 65536 + 3;
        (pixels(along, across) + 1).div_ceil(GROUP) * pixels(across, along) <= CAPACITY
    }

    /// Converts the pixels around a block of samples, or returns `None` if they or the positions do not fit.
    pub(super) fn fill(&mut self, planes: &Planes, rows: &[Row], columns: Range<usize>) -> Option<()> {
        let ends = |row: &Row| [columns.start, columns.end - 1].map(|column| row.position(column));
        if !rows.iter().all(|row| row.fits(columns.end - 1)) {
            return None;
        }
        let bounds = rows.iter().flat_map(ends).fold([[i32::MAX; 2], [i32::MIN; 2]], |[min, max], [x, y]| {
            [[min[0].min(x), min[1].min(y)], [max[0].max(x), max[1].max(y)]]
        });
        let [[left, top], [right, bottom]] = bounds.map(|corner| corner.map(|at| at >> 16));
        // A group begins with a pixel that shares its chroma with the next one.
        self.origin = [left & !1, top];
        let pixels = |first: i32, last: i32| (last - first).unsigned_abs() as usize + 2;
        self.width = pixels(left & !1, right).div_ceil(GROUP);
        self.height = pixels(top, bottom);
        let groups = self.groups.get_mut(..self.width * self.height)?;
        let [first, second] = ends(rows.first()?);
        let [fourth, third] = ends(rows.last()?);
        let relative = |at: i32, origin: i32| at.wrapping_sub(origin << 16) as f32 / 65536.0;
        let corners =
            [first, second, third, fourth].map(|[x, y]| [relative(x, self.origin[0]), relative(y, self.origin[1])]);
        for (band_number, band) in groups.chunks_mut(BAND * self.width).enumerate() {
            let columns = groups_around(corners, band_number * BAND);
            let x = self.origin[0].saturating_add(signed(columns.start * GROUP));
            for (number, row) in (band_number * BAND..).zip(band.chunks_exact_mut(self.width)) {
                let groups = row.get_mut(columns.start..columns.end.min(self.width))?;
                planes.convert([x, self.origin[1].saturating_add(signed(number))], groups);
            }
        }
        Some(())
    }

    /// Computes the samples of a row from number `first` on. [`fill`](Self::fill) has converted their pixels.
    pub(super) fn sample(&self, row: &Row, first: usize, scale: f32, output: &mut [f32]) {
        let pixels = self.groups.get(..self.width * self.height).unwrap_or(&[]).as_flattened();
        let [x, y] = row.position(first);
        let [left, top] = self.origin;
        let start = [x.wrapping_sub(left << 16), y.wrapping_sub(top << 16)];
        sample(&Line { pixels, stride: self.width * GROUP, start, step: row.step, scale }, output);
    }
}

/// The groups around the samples in the rows of the band that begins with row `top`. The corners of the block of samples
/// count columns and rows of the memory, in the order in which its outline connects them.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
fn groups_around([first, second, third, fourth]: [[f32; 2]; 4], top: usize) -> Range<usize> {
    // A sample also takes pixels from the next row and the next column.
    let ends = [top as f32 - 1.0 - ROUNDING, (top + BAND) as f32 + ROUNDING];
    let mut left = f32::MAX;
    let mut right = f32::MIN;
    for [from, to] in [[first, second], [second, third], [third, fourth], [fourth, first]] {
        let highest = from[1].min(to[1]);
        let lowest = from[1].max(to[1]);
        if highest > ends[1] || lowest < ends[0] {
            continue;
        }
        let slope = if highest < lowest { (to[0] - from[0]) / (to[1] - from[1]) } else { 0.0 };
        for end in ends {
            let x = from[0] + (end.max(highest).min(lowest) - from[1]) * slope;
            left = left.min(x);
            right = right.max(x);
        }
    }
    (left - ROUNDING) as usize / GROUP..(right + 1.0 + ROUNDING) as usize / GROUP + 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_colour_is_within_two_levels_of_bt601_and_fits_a_pixel() {
        let steps = || (0..=255).step_by(5);
        for (luma, cb) in steps().flat_map(|luma| steps().map(move |cb| (luma, cb))) {
            for cr in steps() {
                let [ours, video] = [&FULL_RANGE, &VIDEO_RANGE].map(|factors| factors.pixel([luma, cb, cr]));
                assert!(ours.iter().chain(&video).all(|channel| (-511..=1023).contains(channel)), "{ours:?} {video:?}");
                let y = f32::from(luma);
                let cb = f32::from(cb) - 128.0;
                let cr = f32::from(cr) - 128.0;
                let exact = [y + 1.402 * cr, y - 0.344_136 * cb - 0.714_136 * cr, y + 1.772 * cb];
                for (ours, exact) in ours.into_iter().zip(exact) {
                    assert!((f32::from(ours) - exact).abs() <= 2.01, "{luma} {cb} {cr}: {ours} {exact}");
                }
            }
        }
        let grey = |luma| VIDEO_RANGE.pixel([luma, 128, 128]);
        assert_eq!([grey(16), grey(235)], [[0, 0, 0, 0], [255, 255, 255, 0]], "black and white of a video");
    }
}
