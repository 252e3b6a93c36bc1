use facewire_face::{MAX_SIDE_PX, Picture, Pixels};

use crate::Error;

/// How the samples of a picture lie in one piece of memory. [`Pixels`] describes those that lie in several, or otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// Red, green and blue.
    Rgb,
    /// Blue, green and red, as in OpenCV.
    Bgr,
    /// Red, green, blue and a byte that is not read.
    Rgba,
    /// Blue, green, red and a byte that is not read.
    Bgra,
    /// Luma only.
    Grey,
    /// Packed 4:2:2, `Y0 Cb Y1 Cr`.
    Yuyv,
    /// 4:2:0: a plane of luma, then one of `Cb Cr`.
    Nv12,
    /// 4:2:0: planes of luma, Cb and Cr.
    I420,
    /// 4:2:2: planes of luma, Cb and Cr.
    I422,
    /// 4:4:4: planes of luma, Cb and Cr.
    I444,
}

impl Format {
    /// Every format.
    pub const ALL: [Self; 10] = [
        Self::Rgb,
        Self::Bgr,
        Self::Rgba,
        Self::Bgra,
        Self::Grey,
        Self::Yuyv,
        Self::Nv12,
        Self::I420,
        Self::I422,
        Self::I444,
    ];

    /// The name in lower case, such as `bgr`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rgb => "rgb",
            Self::Bgr => "bgr",
            Self::Rgba => "rgba",
            Self::Bgra => "bgra",
            Self::Grey => "grey",
            Self::Yuyv => "yuyv",
            Self::Nv12 => "nv12",
            Self::I420 => "i420",
            Self::I422 => "i422",
            Self::I444 => "i444",
        }
    }

    /// Bytes of a row without padding: of luma, if the format has planes.
    pub fn row_bytes(self, width: usize) -> usize {
        match self {
            Self::Rgb | Self::Bgr => width.saturating_mul(3),
            Self::Rgba | Self::Bgra => width.saturating_mul(4),
            Self::Yuyv => width.div_ceil(2).saturating_mul(4),
            // The plane of chroma has rows of this length, too.
            Self::Nv12 => width.saturating_add(width % 2),
            Self::Grey | Self::I420 | Self::I422 | Self::I444 => width,
        }
    }

    /// Returns the picture of `[width, height]` in `data`, whose rows have no padding and whose black is 0.
    pub fn picture(self, data: &[u8], size: [usize; 2]) -> Result<Picture<'_>, Error> {
        self.padded_picture(data, size, self.row_bytes(size[0]), true)
    }

    /// Returns the picture of `[width, height]` in `data`, whose rows are `stride` bytes apart. Rows of separate Cb and Cr planes
    /// are half as far apart, rounded up, in I420 and I422. With `full_range`, black and white are 0 and 255, otherwise 16
    /// and 235. Formats in red, green and blue ignore it.
    pub fn padded_picture(
        self,
        data: &[u8],
        [width, height]: [usize; 2],
        stride: usize,
        full_range: bool,
    ) -> Result<Picture<'_>, Error> {
        let pixels = self.pixels(data, height, stride);
        let picture = pixels.and_then(|pixels| Picture::new(width, height, pixels, full_range));
        picture.ok_or_else(|| {
            Error::Picture(format!(
                "{} bytes with rows of {stride} are no {} picture of {width} x {height} pixels; sides may be 1 to {MAX_SIDE_PX} \
                 pixels long, and every row must be complete",
                data.len(),
                self.name()
            ))
        })
    }

    fn pixels(self, data: &[u8], height: usize, stride: usize) -> Option<Pixels<'_>> {
        let packed = |step, rgb| Some(Pixels::Packed { data, stride, step, rgb });
        let planar = |chroma_stride: usize, chroma_shift: [u8; 2]| {
            let (luma, chroma) = data.split_at_checked(stride.checked_mul(height)?)?;
            let (cb, cr) =
                chroma.split_at_checked(chroma_stride.checked_mul(height.div_ceil(1 << chroma_shift[1]))?)?;
            Some(Pixels::Planar { planes: [luma, cb, cr], strides: [stride, chroma_stride], chroma_shift })
        };
        match self {
            Self::Rgb => packed(3, [0, 1, 2]),
            Self::Bgr => packed(3, [2, 1, 0]),
            Self::Rgba => packed(4, [0, 1, 2]),
            Self::Bgra => packed(4, [2, 1, 0]),
            Self::Grey => Some(Pixels::Grey { data, stride }),
            Self::Yuyv => Some(Pixels::Yuyv { data, stride }),
            Self::Nv12 => {
                let (luma, chroma) = data.split_at_checked(stride.checked_mul(height)?)?;
                Some(Pixels::Nv12 { luma, chroma, stride })
            }
            Self::I420 => planar(stride.div_ceil(2), [1, 1]),
            Self::I422 => planar(stride.div_ceil(2), [1, 0]),
            Self::I444 => planar(stride, [0, 0]),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    /// Bytes that a picture of 5 x 3 pixels takes, by the definition of each format.
    const BYTES: [usize; 10] = [45, 45, 60, 60, 15, 36, 6 * 3 + 6 * 2, 15 + 2 * 6, 15 + 2 * 9, 45];

    #[test]
    fn every_format_takes_as_many_bytes_as_its_definition_says_and_not_one_less() {
        for (format, bytes) in Format::ALL.into_iter().zip(BYTES) {
            let (data, size) = (vec![0; bytes], [5, 3]);
            assert!(format.picture(&data, size).is_ok(), "{format:?}");
            let error = format.picture(&data[1..], size).unwrap_err().to_string();
            assert!(error.contains(format.name()) && error.contains("5 x 3"), "{error}");
        }
        assert!(
            Format::Rgb.picture(&[0; 40], [4097, 0]).is_err() && Format::I420.picture(&[], [usize::MAX; 2]).is_err()
        );
        assert!(Format::Nv12.padded_picture(&[0; 99], [4, 4], usize::MAX, true).is_err());
    }
}
