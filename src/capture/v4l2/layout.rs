//! The layouts of frames, and how they become pictures.
//!
//! Contract: a frame that is complete becomes a picture without another allocation. Layouts that the crop does not sample as they
//! are get another order of bytes on the way out of the driver's buffer, from which they must be copied anyway.
//!
//! Source: the chapter "Image Formats" of the kernel's guide to `Video4Linux2`.

use facewire_face::{MAX_SIDE_PX, Picture, Pixels};
use v4l::Format;
use v4l::format::{Colorspace, Quantization};

use super::super::{CaptureError, FrameFault, JpegDecoder};

/// A pixel format of the kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelFormat {
    pub fourcc: [u8; 4],
    pub name: &'static str,
    samples: Samples,
}

/// How the samples of a frame lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Samples {
    Jpeg,
    /// Four bytes for two pixels of 4:2:2, in the order of the name.
    Yuyv,
    Uyvy,
    Yvyu,
    Vyuy,
    /// A plane of luma, and one of pairs of chroma with as many or half the rows. The pairs begin with Cb or Cr.
    SemiPlanar {
        is_cr_first: bool,
        has_half_rows: bool,
    },
    /// A plane of luma, and two of chroma of half the width, with as many or half the rows. Cb or Cr comes first.
    Planar {
        is_cr_first: bool,
        has_half_rows: bool,
    },
    /// Pixels of so many bytes, in which red, green and blue have these places.
    Packed {
        step: usize,
        rgb: [usize; 3],
    },
    /// Pixels of two bytes, the lower one first, with 5 bits of red at the top, 6 of green and 5 of blue.
    Rgb565,
    /// Luma in bytes.
    Grey,
    /// Luma of so many bits in two bytes, the lower one first.
    DeepGrey {
        bits: u32,
    },
}

impl PixelFormat {
    pub const YUYV: Self = Self::new("YUYV", Samples::Yuyv);
    pub const NV12: Self = Self::new("NV12", Samples::SemiPlanar { is_cr_first: false, has_half_rows: true });
    pub const MJPEG: Self = Self { fourcc: *b"MJPG", ..Self::new("MJPEG", Samples::Jpeg) };
    /// Separate JPEG images, which are decoded like Motion-JPEG.
    pub const JPEG: Self = Self::new("JPEG", Samples::Jpeg);
    pub const GREY: Self = Self::new("GREY", Samples::Grey);

    /// All formats in order of preference. Raw formats with luma come first because they need no decoding. RGB, which few cameras
    /// send by themselves, comes after JPEG. Grey comes last because the networks were trained on colour.
    pub const ALL: [Self; 31] = [
        Self::YUYV,
        Self::NV12,
        Self::new("UYVY", Samples::Uyvy),
        Self::new("YVYU", Samples::Yvyu),
        Self::new("VYUY", Samples::Vyuy),
        Self::new("YU12", Samples::Planar { is_cr_first: false, has_half_rows: true }),
        Self::new("YV12", Samples::Planar { is_cr_first: true, has_half_rows: true }),
        Self::new("422P", Samples::Planar { is_cr_first: false, has_half_rows: false }),
        Self::new("NV21", Samples::SemiPlanar { is_cr_first: true, has_half_rows: true }),
        Self::new("NV16", Samples::SemiPlanar { is_cr_first: false, has_half_rows: false }),
        Self::new("NV61", Samples::SemiPlanar { is_cr_first: true, has_half_rows: false }),
        Self::MJPEG,
        Self::JPEG,
        Self::new("RGB3", Samples::Packed { step: 3, rgb: [0, 1, 2] }),
        Self::new("BGR3", Samples::Packed { step: 3, rgb: [2, 1, 0] }),
        Self::new("RGB4", Samples::Packed { step: 4, rgb: [1, 2, 3] }),
        Self::new("BGR4", Samples::Packed { step: 4, rgb: [2, 1, 0] }),
        Self::new("XB24", Samples::Packed { step: 4, rgb: [0, 1, 2] }),
        Self::new("AB24", Samples::Packed { step: 4, rgb: [0, 1, 2] }),
        Self::new("XR24", Samples::Packed { step: 4, rgb: [2, 1, 0] }),
        Self::new("AR24", Samples::Packed { step: 4, rgb: [2, 1, 0] }),
        Self::new("BX24", Samples::Packed { step: 4, rgb: [1, 2, 3] }),
        Self::new("BA24", Samples::Packed { step: 4, rgb: [1, 2, 3] }),
        Self::new("RX24", Samples::Packed { step: 4, rgb: [3, 2, 1] }),
        Self::new("RA24", Samples::Packed { step: 4, rgb: [3, 2, 1] }),
        Self::new("RGBP", Samples::Rgb565),
        Self::GREY,
        Self::new("Y10 ", Samples::DeepGrey { bits: 10 }),
        Self::new("Y12 ", Samples::DeepGrey { bits: 12 }),
        Self::new("Y14 ", Samples::DeepGrey { bits: 14 }),
        Self::new("Y16 ", Samples::DeepGrey { bits: 16 }),
    ];

    /// A format that has the code of the kernel for its name.
    const fn new(code: &'static str, samples: Samples) -> Self {
        let fourcc = match code.as_bytes() {
            [a, b, c, d] => [*a, *b, *c, *d],
            _ => *b"MJPG",
        };
        Self { fourcc, name: code.trim_ascii(), samples }
    }

    pub fn of(fourcc: [u8; 4]) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.fourcc == fourcc)
    }

    pub fn is_grey(self) -> bool {
        matches!(self.samples, Samples::Grey | Samples::DeepGrey { .. })
    }

    pub fn is_jpeg(self) -> bool {
        self.samples == Samples::Jpeg
    }

    /// The bytes of a row of so many pixels. Rows of chroma pairs have the stride of rows of luma, and hold whole pairs.
    fn row_bytes(self, width: usize) -> usize {
        match self.samples {
            Samples::Yuyv | Samples::Uyvy | Samples::Yvyu | Samples::Vyuy => 4 * width.div_ceil(2),
            Samples::SemiPlanar { .. } | Samples::Planar { .. } => 2 * width.div_ceil(2),
            Samples::Packed { step, .. } => step * width,
            Samples::Rgb565 | Samples::DeepGrey { .. } => 2 * width,
            Samples::Jpeg | Samples::Grey => width,
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    pub format: PixelFormat,
    pub width: usize,
    pub height: usize,
    pub stride: usize,
    /// Whether black and white are 0 and 255 in raw frames, rather than 16 and 235.
    pub full_range: bool,
}

impl Layout {
    /// The layout of the format that a driver has set; `None` if it is not supported. If the driver does not state the
    /// range of luma, the kernel's rule applies: full for grey, RGB and the JPEG colour space, limited for all others.
    pub fn of(set: &Format) -> Option<Self> {
        let format = PixelFormat::of(set.fourcc.repr)?;
        let [width, height, stride] = [set.width, set.height, set.stride].map(|number| number as usize);
        let row_bytes = format.row_bytes(width);
        let stride = if stride == 0 { row_bytes } else { stride };
        let has_luma_of_its_own =
            !format.is_grey() && !matches!(format.samples, Samples::Packed { .. } | Samples::Rgb565);
        let full_range = match set.quantization {
            Quantization::FullRange => true,
            Quantization::LimitedRange => false,
            Quantization::Default => !has_luma_of_its_own || matches!(set.colorspace, Colorspace::JPEG),
        };
        let fits = [width, height].iter().all(|side| (1..=MAX_SIDE_PX).contains(side))
            && (row_bytes..=16 * MAX_SIDE_PX).contains(&stride);
        fits.then_some(Self { format, width, height, stride, full_range })
    }

    /// The bytes of all planes of a frame; 0 for a JPEG image, whose length is not known.
    fn frame_bytes(&self) -> usize {
        let Self { height, stride, .. } = *self;
        let chroma_rows = |has_half_rows| if has_half_rows { height.div_ceil(2) } else { height };
        match self.format.samples {
            Samples::Jpeg => 0,
            Samples::SemiPlanar { has_half_rows, .. } => stride * (height + chroma_rows(has_half_rows)),
            Samples::Planar { has_half_rows, .. } => stride * height + 2 * (stride / 2) * chroma_rows(has_half_rows),
            _ => stride * height,
        }
    }

    /// The bytes of the rows that are kept, and how many of them are.
    fn kept(&self) -> [usize; 2] {
        let Self { height, stride, .. } = *self;
        match self.format.samples {
            Samples::SemiPlanar { .. } => [stride, height + height.div_ceil(2)],
            Samples::Rgb565 => [stride / 2 * 3, height],
            Samples::DeepGrey { .. } => [stride / 2, height],
            _ => [stride, height],
        }
    }
}

pub struct Store {
    pub(super) layout: Layout,
    /// What is kept of a raw frame.
    raw: Box<[u8]>,
    jpeg: Option<JpegDecoder>,
}

impl Store {
    pub fn new(layout: Layout) -> Result<Self, CaptureError> {
        let Layout { format, width, height, .. } = layout;
        let jpeg = format.is_jpeg().then(|| JpegDecoder::new(width, height)).transpose()?;
        let bytes = match format.samples {
            Samples::Planar { .. } | Samples::Jpeg => layout.frame_bytes(),
            _ => layout.kept().iter().product(),
        };
        Ok(Self { layout, raw: vec![0; bytes].into_boxed_slice(), jpeg })
    }

    /// Copies or decodes a frame, so that its buffer can go back to the driver.
    pub fn keep(&mut self, bytes: &[u8]) -> Result<(), FrameFault> {
        if let Some(decoder) = &mut self.jpeg {
            return decoder.decode(bytes);
        }
        let frame = bytes.get(..self.layout.frame_bytes()).ok_or(FrameFault::Incomplete)?;
        match self.layout.format.samples {
            Samples::Uyvy => self.reorder(frame, |[cb, first, cr, second]| [first, cb, second, cr]),
            Samples::Yvyu => self.reorder(frame, |[first, cr, second, cb]| [first, cb, second, cr]),
            Samples::Vyuy => self.reorder(frame, |[cr, first, cb, second]| [first, cb, second, cr]),
            Samples::SemiPlanar { is_cr_first, has_half_rows } if is_cr_first || !has_half_rows => {
                self.keep_semi_planar(frame, is_cr_first, has_half_rows);
            }
            Samples::Rgb565 => self.reorder(frame, |[low, high]: [u8; 2]| {
                let [red, green, blue] = [high >> 3, high << 5 >> 2 | low >> 5, low & 0x1f];
                [red << 3 | red >> 2, green << 2 | green >> 4, blue << 3 | blue >> 2]
            }),
            Samples::DeepGrey { bits } => {
                let shift = bits - u8::BITS;
                self.reorder(frame, |pixel| [(u16::from_le_bytes(pixel) >> shift).min(255) as u8]);
            }
            _ => self.raw.copy_from_slice(frame),
        }
        Ok(())
    }

    /// Copies rows, and makes M bytes of every N.
    fn reorder<const N: usize, const M: usize>(&mut self, frame: &[u8], change: impl Fn([u8; N]) -> [u8; M]) {
        let [kept_bytes, _] = self.layout.kept();
        let rows = frame.chunks_exact(self.layout.stride);
        for (to, from) in self.raw.chunks_exact_mut(kept_bytes.max(1)).zip(rows) {
            for (to, from) in to.as_chunks_mut::<M>().0.iter_mut().zip(from.as_chunks::<N>().0) {
                *to = change(*from);
            }
        }
    }

    /// Keeps the chroma rows that NV12 has, with Cb first.
    fn keep_semi_planar(&mut self, frame: &[u8], is_cr_first: bool, has_half_rows: bool) {
        let Layout { stride, height, .. } = self.layout;
        let Some(((luma, chroma), (kept_luma, kept_chroma))) =
            frame.split_at_checked(stride * height).zip(self.raw.split_at_mut_checked(stride * height))
        else {
            return;
        };
        kept_luma.copy_from_slice(luma);
        let rows = chroma.chunks_exact(stride).step_by(if has_half_rows { 1 } else { 2 });
        for (to, from) in kept_chroma.chunks_exact_mut(stride).zip(rows) {
            to.copy_from_slice(from);
            if is_cr_first {
                to.as_chunks_mut::<2>().0.iter_mut().for_each(|pair| pair.reverse());
            }
        }
    }

    pub fn picture(&self) -> Option<Picture<'_>> {
        if let Some(decoder) = &self.jpeg {
            return decoder.picture();
        }
        let Layout { format, width, height, full_range, .. } = self.layout;
        let [stride, _] = self.layout.kept();
        let data = &self.raw;
        let pixels = match format.samples {
            Samples::Yuyv | Samples::Uyvy | Samples::Yvyu | Samples::Vyuy => Pixels::Yuyv { data, stride },
            Samples::SemiPlanar { .. } => {
                let (luma, chroma) = data.split_at_checked(stride * height)?;
                Pixels::Nv12 { luma, chroma, stride }
            }
            Samples::Planar { is_cr_first, has_half_rows } => {
                let (luma, chroma) = data.split_at_checked(stride * height)?;
                let (first, second) = chroma.split_at_checked(chroma.len() / 2)?;
                let [cb, cr] = if is_cr_first { [second, first] } else { [first, second] };
                let chroma_shift = [1, u8::from(has_half_rows)];
                Pixels::Planar { planes: [luma, cb, cr], strides: [stride, stride / 2], chroma_shift }
            }
            Samples::Packed { step, rgb } => Pixels::Packed { data, stride, step, rgb },
            Samples::Rgb565 => Pixels::Packed { data, stride, step: 3, rgb: [0, 1, 2] },
            Samples::Grey | Samples::DeepGrey { .. } | Samples::Jpeg => Pixels::Grey { data, stride },
        };
        Picture::new(width, height, pixels, full_range)
    }
}

#[cfg(test)]
mod tests {
    use v4l::FourCC;

    use super::*;

    #[test]
    fn a_raw_frame_fills_rows_of_whole_pairs_and_a_short_one_or_a_layout_without_room_is_refused() {
        // The width, height and stride that a driver sets, and the bytes of a frame, unless the layout is refused.
        let table = [
            (b"YUYV", [6, 4, 12], Some(48)),
            (b"YUYV", [6, 4, 16], Some(64)),
            (b"YUYV", [5, 3, 0], Some(36)),
            (b"YUYV", [6, 4, 11], None),
            (b"YUYV", [5, 3, 11], None),
            (b"NV12", [6, 4, 8], Some(48)),
            (b"NV12", [5, 3, 0], Some(30)),
            (b"NV12", [5, 3, 5], None),
            (b"GREY", [6, 4, 0], Some(24)),
            (b"GREY", [5000, 4, 0], None),
            (b"GREY", [0, 4, 0], None),
            (b"NV16", [5, 3, 0], Some(36)),
            (b"YU12", [6, 4, 8], Some(48)),
            (b"YU12", [5, 3, 0], Some(30)),
            (b"422P", [5, 3, 0], Some(36)),
            (b"RGB3", [6, 4, 18], Some(72)),
            (b"RGB3", [6, 4, 17], None),
            (b"RGBP", [5, 4, 0], Some(40)),
            (b"Y10 ", [5, 4, 11], Some(44)),
            (b"pBAA", [6, 4, 8], None),
        ];
        for (fourcc, [width, height, stride], bytes) in table {
            let layout = Layout::of(&Format { stride, ..Format::new(width, height, FourCC::new(fourcc)) });
            assert_eq!(layout.is_some(), bytes.is_some(), "{layout:?}");
            let Some((mut store, bytes)) = layout.map(|layout| Store::new(layout).unwrap()).zip(bytes) else {
                continue;
            };
            assert_eq!(store.keep(&vec![9; bytes - 1]), Err(FrameFault::Incomplete), "{layout:?}");
            assert_eq!(store.keep(&vec![9; bytes + 100]), Ok(()), "padding behind it");
            assert_eq!((store.keep(&vec![9; bytes]), store.picture().is_some()), (Ok(()), true));
        }
    }

    #[test]
    fn the_range_is_limited_unless_the_driver_says_otherwise() {
        let is_full = |fourcc, colorspace, quantization| {
            let set = Format { colorspace, quantization, ..Format::new(6, 4, FourCC::new(fourcc)) };
            Layout::of(&set).unwrap().full_range
        };
        assert!(!is_full(b"YUYV", Colorspace::SRGB, Quantization::Default));
        assert!(is_full(b"YUYV", Colorspace::JPEG, Quantization::Default));
        assert!(is_full(b"GREY", Colorspace::SRGB, Quantization::Default));
        assert!(is_full(b"YUYV", Colorspace::SRGB, Quantization::FullRange));
        assert!(!is_full(b"YUYV", Colorspace::JPEG, Quantization::LimitedRange));
        assert!(is_full(b"RGB3", Colorspace::SRGB, Quantization::Default));
    }

    #[test]
    fn each_format_has_its_own_name_and_code() {
        for (at, format) in PixelFormat::ALL.into_iter().enumerate() {
            assert_eq!(PixelFormat::of(format.fourcc), Some(format));
            assert!(PixelFormat::ALL[..at].iter().all(|other| other.name != format.name), "{}", format.name);
        }
    }
}
