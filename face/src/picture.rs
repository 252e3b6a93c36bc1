//! A picture in the format of the camera, borrowed from its source.

/// Longest side of a picture that is supported.
pub const MAX_SIDE_PX: usize = 4096;

/// A borrowed picture, whose samples [`Picture::new`] has checked to be complete.
#[derive(Debug, Clone, Copy)]
pub struct Picture<'a> {
    width: usize,
    height: usize,
    pixels: Pixels<'a>,
    full_range: bool,
    rotation: Rotation,
}

/// Clockwise turn that makes the picture of a camera upright, which is mounted on its side or upside down.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Rotation {
    /// The picture is upright.
    #[default]
    None,
    /// By 90 degrees.
    Quarter,
    /// By 180 degrees.
    Half,
    /// By 270 degrees.
    ThreeQuarters,
}

impl Rotation {
    /// All turns, by their angles.
    pub const ALL: [Self; 4] = [Self::None, Self::Quarter, Self::Half, Self::ThreeQuarters];

    /// The clockwise angle in degrees.
    pub const fn degrees(self) -> u32 {
        90 * self as u32
    }

    /// Whether columns become rows.
    pub const fn is_sideways(self) -> bool {
        matches!(self, Self::Quarter | Self::ThreeQuarters)
    }

    /// The place in the rows of a point of the upright picture, if `right` and `bottom` are the places of the last pixel of a row
    /// and of the last row. If both are 0, this turns a direction.
    pub(crate) fn in_rows(self, [x, y]: [f32; 2], [right, bottom]: [f32; 2]) -> [f32; 2] {
        match self {
            Self::None => [x, y],
            Self::Quarter => [y, bottom - x],
            Self::Half => [right - x, bottom - y],
            Self::ThreeQuarters => [right - y, x],
        }
    }
}

/// The samples of a picture. A stride is the number of bytes from one row to the next.
#[derive(Debug, Clone, Copy)]
#[allow(missing_docs, reason = "the variants tell the fields")]
pub enum Pixels<'a> {
    /// Packed 4:2:2, `Y0 Cb Y1 Cr`.
    Yuyv { data: &'a [u8], stride: usize },
    /// A luma plane, and a plane of interleaved `Cb Cr` of half the width and height.
    Nv12 { luma: &'a [u8], chroma: &'a [u8], stride: usize },
    /// Luma, Cb and Cr (Motion-JPEG, y4m), with the strides of luma and of both chroma planes. Chroma is `1 << x` narrower
    /// and `1 << y` lower than luma, rounded up.
    Planar { planes: [&'a [u8]; 3], strides: [usize; 2], chroma_shift: [u8; 2] },
    /// Luma only.
    Grey { data: &'a [u8], stride: usize },
    /// Pixels of `step` bytes, with red, green and blue at these places: `[0, 1, 2]` is RGB, `[2, 1, 0]` BGR.
    Packed { data: &'a [u8], stride: usize, step: usize, rgb: [usize; 3] },
}

impl<'a> Picture<'a> {
    /// A picture that is upright. Returns `None` if a side is 0 or longer than [`MAX_SIDE_PX`], or if the last row or column
    /// is not complete.
    pub fn new(width: usize, height: usize, pixels: Pixels<'a>, full_range: bool) -> Option<Self> {
        let sides = 1..=MAX_SIDE_PX;
        let fits = sides.contains(&width) && sides.contains(&height) && pixels.hold(width, height);
        fits.then_some(Self { width, height, pixels, full_range, rotation: Rotation::None })
    }

    /// The same samples, of which this turn makes the upright picture. Landmarks and regions are those of the upright picture.
    pub fn rotated(self, rotation: Rotation) -> Self {
        Self { rotation, ..self }
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The samples.
    pub fn pixels(&self) -> Pixels<'a> {
        self.pixels
    }

    /// Whether black and white are 0 and 255 (JPEG) rather than 16 and 235 (video).
    pub fn full_range(&self) -> bool {
        self.full_range
    }

    /// How the picture must be turned to stand upright.
    pub fn rotation(&self) -> Rotation {
        self.rotation
    }

    /// Width and height of the upright picture, pixels.
    pub fn size_px(&self) -> [f32; 2] {
        let size = [self.width as f32, self.height as f32];
        if self.rotation.is_sideways() { [size[1], size[0]] } else { size }
    }

    /// The place in the rows of a point of the upright picture. Whole numbers are centres of pixels.
    pub fn in_rows(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let last = [self.width, self.height].map(|side| side as f32 - 1.0);
        self.rotation.in_rows([x, y], last)
    }
}

impl Pixels<'_> {
    fn hold(&self, width: usize, height: usize) -> bool {
        match *self {
            Self::Yuyv { data, stride } => holds(data, stride, [4 * width.div_ceil(2), height]),
            Self::Grey { data, stride } => holds(data, stride, [width, height]),
            Self::Packed { data, stride, step, rgb } => {
                rgb.iter().all(|at| *at < step)
                    && step.checked_mul(width).is_some_and(|row| holds(data, stride, [row, height]))
            }
            Self::Nv12 { luma, chroma, stride } => {
                let chroma_size = [2 * width.div_ceil(2), height.div_ceil(2)];
                holds(luma, stride, [width, height]) && holds(chroma, stride, chroma_size)
            }
            // No format has chroma planes of less than a quarter of the width or height of luma.
            Self::Planar { chroma_shift: [x, y], .. } if x.max(y) > 2 => false,
            Self::Planar { planes: [luma, cb, cr], strides: [stride, chroma_stride], chroma_shift: [x, y] } => {
                let chroma_size = [width.div_ceil(1 << x), height.div_ceil(1 << y)];
                holds(luma, stride, [width, height])
                    && [cb, cr].iter().all(|plane| holds(plane, chroma_stride, chroma_size))
            }
        }
    }
}

/// Returns whether `plane` has `rows` rows of `row_bytes`, which are `stride` apart. The last row needs no padding.
fn holds(plane: &[u8], stride: usize, [row_bytes, rows]: [usize; 2]) -> bool {
    let before_last = stride.checked_mul(rows.saturating_sub(1));
    let needed = before_last.and_then(|bytes| bytes.checked_add(row_bytes));
    stride >= row_bytes && needed.is_some_and(|needed| plane.len() >= needed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_refused_unless_every_row_and_column_is_complete() {
        const DATA: [u8; 64] = [0; 64];
        let grey = |data, stride| Pixels::Grey { data, stride };
        let yuyv = |stride| Pixels::Yuyv { data: &DATA, stride };
        let nv12 = |chroma| Pixels::Nv12 { luma: &DATA, chroma, stride: 4 };
        let packed = |step, red| Pixels::Packed { data: &DATA, stride: 22, step, rgb: [red, 1, 0] };
        let planar = |cr, chroma_shift| Pixels::Planar { planes: [&DATA, &DATA, cr], strides: [5, 3], chroma_shift };
        let cases = [
            (true, [5, 4], grey(&DATA[..29], 8)),
            (false, [5, 4], grey(&DATA[..28], 8)),
            (false, [5, 4], grey(&DATA, 4)),
            (false, [0, 4], grey(&DATA, 8)),
            (false, [5, 4097], grey(&DATA, 8)),
            (false, [5, 4], grey(&DATA, usize::MAX)),
            (true, [3, 2], yuyv(8)),
            (false, [3, 2], yuyv(7)),
            (true, [5, 3], packed(4, 3)),
            (false, [5, 3], packed(4, 4)),
            (false, [5, 3], packed(5, 0)),
            (false, [5, 3], packed(usize::MAX / 2, 0)),
            (true, [3, 3], nv12(&DATA[..8])),
            (false, [3, 3], nv12(&DATA[..7])),
            (true, [5, 3], planar(&DATA[..6], [1, 1])),
            (false, [5, 3], planar(&DATA[..5], [1, 1])),
            (false, [5, 3], planar(&DATA, [0, 0])),
            (false, [5, 3], planar(&DATA, [3, 0])),
            (false, [5, 3], planar(&DATA, [255, 255])),
        ];
        for (is_whole, [width, height], pixels) in cases {
            assert_eq!(Picture::new(width, height, pixels, true).is_some(), is_whole, "{width} x {height} {pixels:?}");
        }
    }
}
