//! Converts the pixels around a block of samples at once, so that each sample reads pixels that are red, green and blue
//! already.
//!
//! This is several times faster than converting the four pixels around each sample. Blocks are so small that their pixels
//! stay in the nearest caches. If the region is rotated, only those columns of each row are converted that lie around
//! samples.

use std::ops::Range;

use facewire_engine::kernels::convert::GROUP;
use facewire_engine::kernels::sample::{Line, Pixel, sample};

use super::planes::Planes;

/// Groups of pixels that fit the memory, which takes 128 KiB.
const CAPACITY: usize = 1024;

/// Rows of pixels for which one range of columns around the samples is computed.
const BAND: usize = 8;

/// An upper bound of the distance, in pixels, between a sample and its position without rounding.
const ROUNDING: f32 = 0.5;

/// A row of samples in 16.16 fixed point: the position of the first sample, and the step to the next one.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Row {
    pub(super) start: [i32; 2],
    pub(super) step: [i32; 2],
}

impl Row {
    /// The position of a sample. A position that does not fit 16.16 fixed point wraps around.
    pub(super) fn position(&self, number: usize) -> [i32; 2] {
        let (Self { start: [x, y], step: [right, down] }, number) = (self, signed(number));
        [x.wrapping_add(right.wrapping_mul(number)), y.wrapping_add(down.wrapping_mul(number))]
    }

    /// Whether the positions of all samples up to number `last` fit 16.16 fixed point.
    fn fits(&self, last: usize) -> bool {
        let fits = |(start, step): (i32, i32)| step.checked_mul(signed(last)).and_then(|way| start.checked_add(way));
        self.start.into_iter().zip(self.step).all(|axis| fits(axis).is_some())
    }
}

/// A number of samples or pixels, which is far below 2^31.
pub(super) fn signed(number: usize) -> i32 {
    i32::try_from(number).unwrap_or(i32::MAX)
}

/// Memory for the pixels around a block of samples.
pub struct Block {
    groups: Box<[[Pixel; GROUP]]>,
    /// Groups in a row of pixels.
    width: usize,
    /// Rows of pixels.
    height: usize,
    /// Column and row of the first pixel in the picture.
    origin: [i32; 2],
}

impl Default for Block {
    fn default() -> Self {
        // Not zero: the system provides zeroed memory only when it is first written, which would be during the first frame.
        Self { groups: vec![[[1; 4]; GROUP]; CAPACITY].into(), width: 0, height: 0, origin: [0; 2] }
    }
}

impl Block {
    /// Whether the pixels around blocks of `columns` x `rows` samples fit the memory. `step` leads from a sample to the
    /// next one of its row, and the distance between rows is that between samples.
    pub(super) fn holds([columns, rows]: [usize; 2], step: [i32; 2]) -> bool {
        let [along, across] = step.map(|step| step.unsigned_abs() as usize);
        let pixels = |along: usize, across: usize| ((columns - 1) * along + (rows - 1) * across) / 65536 + 3;
        (pixels(along, across) + 1).div_ceil(GROUP) * pixels(across, along) <= CAPACITY
    }

    /// Converts the pixels around a block of samples. Returns `None` if the pixels do not fit the memory or the positions
    /// do not fit 16.16 fixed point.
    pub(super) fn fill(&mut self, planes: &Planes, rows: &[Row], columns: Range<usize>) -> Option<()> {
        let ends = |row: &Row| [columns.start, columns.end - 1].map(|column| row.position(column));
        let mut bounds = [[i32::MAX; 2], [i32::MIN; 2]];
        for row in rows {
            if !row.fits(columns.end - 1) {
                return None;
            }
            for [x, y] in ends(row) {
                let [min, max] = bounds;
                bounds = [[min[0].min(x), min[1].min(y)], [max[0].max(x), max[1].max(y)]];
            }
        }
        let [[left, top], [right, bottom]] = bounds.map(|corner| corner.map(|at| at >> 16));
        // A group begins with a pixel that shares its chroma with the next one.
        self.origin = [left & !1, top];
        let pixels = |first: i32, last: i32| (last - first).unsigned_abs() as usize + 2;
        (self.width, self.height) = (pixels(left & !1, right).div_ceil(GROUP), pixels(top, bottom));
        let groups = self.groups.get_mut(..self.width * self.height)?;
        let outline = Outline::new(ends(rows.first()?), ends(rows.last()?), self.origin);
        for (band_number, band) in groups.chunks_mut(BAND * self.width).enumerate() {
            let columns = outline.groups(band_number * BAND);
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
        let ([x, y], [left, top]) = (row.position(first), self.origin);
        let start = [x.wrapping_sub(left << 16), y.wrapping_sub(top << 16)];
        sample(&Line { pixels, stride: self.width * GROUP, start, step: row.step, scale }, output);
    }
}

/// The outline of a block of samples.
struct Outline {
    /// Columns and rows of the corners in the memory, in the order in which the outline connects them.
    corners: [[f32; 2]; 4],
}

impl Outline {
    /// The outline of a block, given the positions of the ends of its first row and its last row.
    fn new([first, second]: [[i32; 2]; 2], [fourth, third]: [[i32; 2]; 2], [left, top]: [i32; 2]) -> Self {
        let relative = |at: i32, origin: i32| at.wrapping_sub(origin << 16) as f32 / 65536.0;
        Self { corners: [first, second, third, fourth].map(|[x, y]| [relative(x, left), relative(y, top)]) }
    }

    /// The groups around the samples in the rows of the band that begins with row `top`.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
    fn groups(&self, top: usize) -> Range<usize> {
        // A sample also takes pixels from the next row and the next column.
        let ends = [top as f32 - 1.0 - ROUNDING, (top + BAND) as f32 + ROUNDING];
        let (mut left, mut right) = (f32::MAX, f32::MIN);
        let [first, second, third, fourth] = self.corners;
        for [from, to] in [[first, second], [second, third], [third, fourth], [fourth, first]] {
            let (highest, lowest) = (from[1].min(to[1]), from[1].max(to[1]));
            if highest > ends[1] || lowest < ends[0] {
                continue;
            }
            let slope = if highest < lowest { (to[0] - from[0]) / (to[1] - from[1]) } else { 0.0 };
            for end in ends {
                let x = from[0] + (end.max(highest).min(lowest) - from[1]) * slope;
                (left, right) = (left.min(x), right.max(x));
            }
        }
        (left - ROUNDING) as usize / GROUP..(right + 1.0 + ROUNDING) as usize / GROUP + 1
    }
}
