//! The layout of frames that a driver has set, and the memory for the newest frame.

use v4l::Format;
use v4l::format::{Colorspace, Quantization};

use super::super::{CaptureError, FrameFault, JpegDecoder};
use super::mode::PixelFormat;
use facewire_face::{MAX_SIDE_PX, Picture, Pixels};

/// The layout of a camera's frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    pub format: PixelFormat,
    pub width: usize,
    pub height: usize,
    /// Bytes from one row to the next.
    pub stride: usize,
    /// Whether black and white are 0 and 255 in raw frames, rather than 16 and 235.
    pub full_range: bool,
}

/// The pixels of the newest frame.
pub enum Store {
    /// The bytes that the camera sent.
    Raw(Box<[u8]>),
    /// A decoded JPEG image.
    Jpeg(JpegDecoder),
}

impl Layout {
    /// The layout of the format that a driver has set; `None` if it is not supported. If the driver does not state the
    /// range of luma, the kernel's rule applies: full for grey and for the JPEG colour space, limited for all others.
    pub fn of(set: &Format) -> Option<Self> {
        let format = PixelFormat::of(set.fourcc.repr)?;
        let [width, height, stride] = [set.width, set.height, set.stride].map(|number| number as usize);
        let row_bytes = match format {
            PixelFormat::Yuyv => 4 * width.div_ceil(2),
            // Chroma rows have the same stride as luma rows, and hold whole pairs.
            PixelFormat::Nv12 => 2 * width.div_ceil(2),
            _ => width,
        };
        let stride = if stride == 0 { row_bytes } else { stride };
        let full_range = match set.quantization {
            Quantization::FullRange => true,
            Quantization::LimitedRange => false,
            Quantization::Default => format == PixelFormat::Grey || matches!(set.colorspace, Colorspace::JPEG),
        };
        let fits = [width, height].iter().all(|side| (1..=MAX_SIDE_PX).contains(side));
        (fits && (row_bytes..=16 * MAX_SIDE_PX).contains(&stride)).then_some(Self {
            format,
            width,
            height,
            stride,
            full_range,
        })
    }

    /// Number of bytes of a raw frame.
    fn bytes(&self) -> usize {
        let chroma_rows = if self.format == PixelFormat::Nv12 { self.height.div_ceil(2) } else { 0 };
        self.stride * (self.height + chroma_rows)
    }
}

impl Store {
    /// Takes the memory for one frame.
    pub fn new(layout: &Layout) -> Result<Self, CaptureError> {
        match layout.format {
            PixelFormat::Mjpeg | PixelFormat::Jpeg => JpegDecoder::new(layout.width, layout.height).map(Self::Jpeg),
            _ => Ok(Self::Raw(vec![0; layout.bytes()].into_boxed_slice())),
        }
    }

    /// Copies or decodes a frame, so that its buffer can go back to the driver.
    pub fn keep(&mut self, bytes: &[u8], layout: &Layout) -> Result<(), FrameFault> {
        match self {
            Self::Jpeg(decoder) => decoder.decode(bytes),
            Self::Raw(kept) => {
                kept.copy_from_slice(bytes.get(..layout.bytes()).ok_or(FrameFault::Incomplete)?);
                Ok(())
            }
        }
    }

    /// Returns the frame that was kept last.
    pub fn picture(&self, layout: &Layout) -> Option<Picture<'_>> {
        let data = match self {
            Self::Jpeg(decoder) => return decoder.picture(),
            Self::Raw(data) => data,
        };
        let &Layout { format, width, height, stride, full_range } = layout;
        let pixels = match format {
            PixelFormat::Yuyv => Pixels::Yuyv { data, stride },
            PixelFormat::Nv12 => {
                let (luma, chroma) = data.split_at_checked(stride * height)?;
                Pixels::Nv12 { luma, chroma, stride }
            }
            _ => Pixels::Grey { data, stride },
        };
        Picture::new(width, height, pixels, full_range)
    }
}

#[cfg(test)]
mod tests {
    use v4l::FourCC;

    use super::*;

    fn format(fourcc: [u8; 4], stride: u32) -> Format {
        Format { stride, ..Format::new(6, 4, FourCC::new(&fourcc)) }
    }

    fn kept(fourcc: [u8; 4], stride: u32, bytes: usize) -> Result<(), FrameFault> {
        let layout = Layout::of(&format(fourcc, stride)).unwrap();
        let mut store = Store::new(&layout).unwrap();
        store.keep(&vec![9; bytes], &layout)?;
        assert!(store.picture(&layout).is_some());
        Ok(())
    }

    #[test]
    fn a_raw_frame_that_is_too_short_is_refused() {
        for (fourcc, stride, bytes) in [(*b"YUYV", 12, 48), (*b"YUYV", 16, 64), (*b"NV12", 8, 48), (*b"GREY", 0, 24)] {
            assert_eq!(kept(fourcc, stride, bytes), Ok(()));
            assert_eq!(kept(fourcc, stride, bytes + 100), Ok(()), "padding behind it");
            assert_eq!(kept(fourcc, stride, bytes - 1), Err(FrameFault::Incomplete));
            assert_eq!(kept(fourcc, stride, 0), Err(FrameFault::Incomplete));
        }
        assert_eq!(kept(*b"MJPG", 0, 100), Err(FrameFault::NotJpeg));
    }

    #[test]
    fn a_row_of_odd_width_has_room_for_its_last_chroma_pair() {
        let odd = |fourcc: &[u8; 4], stride| Layout::of(&Format { stride, ..Format::new(5, 3, FourCC::new(fourcc)) });
        for (fourcc, row_bytes) in [(b"NV12", 6), (b"YUYV", 12)] {
            assert_eq!(odd(fourcc, row_bytes - 1), None, "it cannot hold a picture");
            for stride in [0, row_bytes] {
                let layout = odd(fourcc, stride).unwrap();
                let mut store = Store::new(&layout).unwrap();
                store.keep(&[9; 36], &layout).unwrap();
                assert!(store.picture(&layout).is_some());
            }
        }
    }

    #[test]
    fn an_unsupported_layout_is_refused() {
        assert_eq!(Layout::of(&format(*b"RGB3", 18)), None);
        assert_eq!(Layout::of(&format(*b"YUYV", 11)), None, "rows overlap");
        assert_eq!(Layout::of(&Format::new(5000, 4, FourCC::new(b"GREY"))), None);
        assert_eq!(Layout::of(&Format::new(0, 4, FourCC::new(b"GREY"))), None);
    }

    #[test]
    fn the_range_is_limited_unless_the_driver_says_otherwise() {
        let full = |colorspace, quantization| {
            Layout::of(&Format { colorspace, quantization, ..format(*b"YUYV", 12) }).unwrap().full_range
        };
        assert!(!full(Colorspace::SRGB, Quantization::Default));
        assert!(full(Colorspace::JPEG, Quantization::Default));
        assert!(Layout::of(&format(*b"GREY", 6)).unwrap().full_range);
        assert!(full(Colorspace::SRGB, Quantization::FullRange));
        assert!(!full(Colorspace::JPEG, Quantization::LimitedRange));
    }
}
