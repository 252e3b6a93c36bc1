//! A camera as a source: sets the mode, checks every buffer, keeps the pixels of the newest.

use std::path::Path;
use std::time::Duration;

use v4l::format::{Colorspace, Quantization};
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Format, FourCC, Fraction};

use super::super::{
    CaptureError, Description, Frame, FrameFault, FrameRate, JpegDecoder, MAX_SIDE_PX, Picture,
    Pixels, Source,
};
use super::mode::{Choice, PixelFormat, Wish, choose};
use super::select;
use super::stream::{Limits, Shot, Stream};

/// Damaged frames in a row that are passed over; a camera that sends more is opened anew.
const MAX_DAMAGED: u32 = 8;

/// Frame periods after which a frame that lay waiting is too old: the next one is nearer than it.
const STALE_PERIODS: u64 = 2;

/// An open camera.
pub struct CameraSource {
    stream: Stream,
    pixels: Store,
    layout: Layout,
    origin: String,
    rate: Option<FrameRate>,
    /// Frames taken from the driver.
    taken: u64,
}

/// What the driver has set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Layout {
    format: PixelFormat,
    width: usize,
    height: usize,
    stride: usize,
    full_range: bool,
}

/// Where the pixels of the newest frame are kept.
enum Store {
    /// As the camera sent them.
    Raw(Box<[u8]>),
    /// Decoded.
    Jpeg(JpegDecoder),
}

impl CameraSource {
    /// Finds the camera `wanted` means (see [`super::find`]), sets the mode nearest to `wish` and starts it. A frame
    /// that does not come within `timeout` is an error.
    ///
    /// # Errors
    /// Those of [`super::find`], [`CaptureError::ModeLacking`], [`CaptureError::ModeRefused`], [`CaptureError::Stalled`].
    pub fn open(wanted: &str, wish: &Wish, timeout: Duration) -> Result<Self, CaptureError> {
        let (camera, device) = select::open(wanted, wish)?;
        let choice = choose(&camera.modes, wish).ok_or_else(|| camera.lacks(wish))?;
        let layout = set_format(&device, &camera.node, choice)?;
        let rate = choice
            .rate
            .and_then(|rate| set_rate(&device, rate))
            .or(choice.rate);
        let pixels = Store::new(&layout)?;
        let period_us = rate.unwrap_or(FrameRate::FPS_30).period_us();
        let limits = Limits {
            timeout,
            stale_us: STALE_PERIODS * period_us,
        };
        let stream = Stream::start(&device, &camera.node, limits)?;
        let origin = format!("{} ({})", camera.card, camera.node.display());
        Ok(Self {
            stream,
            pixels,
            layout,
            origin,
            rate,
            taken: 0,
        })
    }

    /// Takes the newest good frame; says when it was taken and how many were passed over and damaged.
    fn advance(&mut self) -> Result<(u64, u32, u32), CaptureError> {
        let (mut skipped, mut fault) = (0, FrameFault::Marked);
        for damaged in 0..MAX_DAMAGED {
            let (pixels, layout) = (&mut self.pixels, &self.layout);
            let look = |shot: Shot<'_>| pixels.keep(shot.bytes, layout).map(|()| shot.captured_us);
            let (passed, kept) = self.stream.newest(look)?;
            skipped += passed;
            self.taken += u64::from(passed) + 1;
            match kept {
                Ok(captured_us) => return Ok((captured_us, skipped, damaged)),
                Err(found) => fault = found,
            }
        }
        Err(CaptureError::AllDamaged {
            count: MAX_DAMAGED,
            fault,
        })
    }
}

impl Source for CameraSource {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let (captured_us, skipped, damaged) = self.advance()?;
        let number = self.taken - 1;
        let no_picture = CaptureError::Frame {
            number,
            fault: FrameFault::Incomplete,
        };
        let picture = self.pixels.picture(&self.layout).ok_or(no_picture)?;
        Ok(Some(Frame {
            picture,
            captured_us,
            number,
            skipped,
            damaged,
        }))
    }

    fn frame_period_us(&self) -> Option<u64> {
        self.rate.map(FrameRate::period_us)
    }

    fn describe(&self) -> Description<'_> {
        let Layout {
            format,
            width,
            height,
            ..
        } = self.layout;
        Description {
            origin: &self.origin,
            format: format.name(),
            width,
            height,
            rate: self.rate,
        }
    }
}

/// Sets format and size, and reads back what the driver made of it.
fn set_format(device: &Device, path: &Path, choice: Choice) -> Result<Layout, CaptureError> {
    let wanted = Format::new(
        choice.width,
        choice.height,
        FourCC::new(&choice.format.fourcc()),
    );
    let set = device
        .set_format(&wanted)
        .map_err(|error| CaptureError::device(path, "setting its format", error))?;
    layout(&set).ok_or_else(|| CaptureError::ModeRefused {
        path: path.display().to_string(),
        got: format!("{} {}x{}", set.fourcc, set.width, set.height),
    })
}

/// The layout of a format that is read. Without a word on the range, the kernel's rule: limited
/// but for grey and for JPEG colour.
fn layout(set: &Format) -> Option<Layout> {
    let format = PixelFormat::of(set.fourcc.repr)?;
    let [width, height, stride] = [set.width, set.height, set.stride].map(|number| number as usize);
    let row_bytes = if format == PixelFormat::Yuyv {
        4 * width.div_ceil(2)
    } else {
        width
    };
    let stride = if stride == 0 { row_bytes } else { stride };
    let full_range = match set.quantization {
        Quantization::FullRange => true,
        Quantization::LimitedRange => false,
        Quantization::Default => {
            format == PixelFormat::Grey || matches!(set.colorspace, Colorspace::JPEG)
        }
    };
    let sides = 1..=MAX_SIDE_PX;
    let fits = sides.contains(&width)
        && sides.contains(&height)
        && (row_bytes..=16 * MAX_SIDE_PX).contains(&stride);
    fits.then_some(Layout {
        format,
        width,
        height,
        stride,
        full_range,
    })
}

/// Asks for a rate; the driver's answer, if it has one.
fn set_rate(device: &Device, rate: FrameRate) -> Option<FrameRate> {
    let [frames, seconds] = rate.fraction();
    let set = device
        .set_params(&Parameters::new(Fraction::new(seconds, frames)))
        .ok()?
        .interval;
    FrameRate::new(set.denominator, set.numerator)
}

impl Layout {
    /// Bytes of a raw frame.
    fn bytes(&self) -> usize {
        let chroma_rows = if self.format == PixelFormat::Nv12 {
            self.height.div_ceil(2)
        } else {
            0
        };
        self.stride * (self.height + chroma_rows)
    }
}

impl Store {
    fn new(layout: &Layout) -> Result<Self, CaptureError> {
        match layout.format {
            PixelFormat::Mjpeg | PixelFormat::Jpeg => {
                JpegDecoder::new(layout.width, layout.height).map(Self::Jpeg)
            }
            _ => Ok(Self::Raw(vec![0; layout.bytes()].into_boxed_slice())),
        }
    }

    /// Copies or decodes the buffer, which then goes back to the driver.
    fn keep(&mut self, bytes: &[u8], layout: &Layout) -> Result<(), FrameFault> {
        match self {
            Self::Jpeg(decoder) => decoder.decode(bytes),
            Self::Raw(kept) => {
                kept.copy_from_slice(bytes.get(..layout.bytes()).ok_or(FrameFault::Incomplete)?);
                Ok(())
            }
        }
    }

    fn picture(&self, layout: &Layout) -> Option<Picture<'_>> {
        let data = match self {
            Self::Jpeg(decoder) => return decoder.picture(),
            Self::Raw(data) => data,
        };
        let &Layout {
            format,
            width,
            height,
            stride,
            full_range,
        } = layout;
        let pixels = match format {
            PixelFormat::Yuyv => Pixels::Yuyv { data, stride },
            PixelFormat::Nv12 => {
                let (luma, chroma) = data.split_at_checked(stride * height)?;
                Pixels::Nv12 {
                    luma,
                    chroma,
                    stride,
                }
            }
            _ => Pixels::Grey { data, stride },
        };
        Picture::new(width, height, pixels, full_range)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn format(fourcc: [u8; 4], stride: u32) -> Format {
        Format {
            stride,
            ..Format::new(6, 4, FourCC::new(&fourcc))
        }
    }

    fn kept(fourcc: [u8; 4], stride: u32, bytes: usize) -> Result<(), FrameFault> {
        let layout = layout(&format(fourcc, stride)).unwrap();
        let mut store = Store::new(&layout).unwrap();
        store.keep(&vec![9; bytes], &layout)?;
        assert!(store.picture(&layout).is_some());
        Ok(())
    }

    #[test]
    fn a_raw_frame_is_kept_whole_or_refused_when_it_is_short() {
        for (fourcc, stride, bytes) in [
            (*b"YUYV", 12, 48),
            (*b"YUYV", 16, 64),
            (*b"NV12", 8, 48),
            (*b"GREY", 0, 24),
        ] {
            assert_eq!(kept(fourcc, stride, bytes), Ok(()));
            assert_eq!(
                kept(fourcc, stride, bytes + 100),
                Ok(()),
                "padding behind it"
            );
            assert_eq!(kept(fourcc, stride, bytes - 1), Err(FrameFault::Incomplete));
            assert_eq!(kept(fourcc, stride, 0), Err(FrameFault::Incomplete));
        }
        assert_eq!(kept(*b"MJPG", 0, 100), Err(FrameFault::NotJpeg));
    }

    #[test]
    fn what_the_driver_set_instead_is_refused_unless_it_can_be_read() {
        assert_eq!(layout(&format(*b"RGB3", 18)), None);
        assert_eq!(layout(&format(*b"YUYV", 11)), None, "rows overlap");
        assert_eq!(layout(&Format::new(5000, 4, FourCC::new(b"GREY"))), None);
        assert_eq!(layout(&Format::new(0, 4, FourCC::new(b"GREY"))), None);
    }

    #[test]
    fn the_range_is_limited_unless_the_driver_says_otherwise() {
        let full = |colorspace, quantization| {
            layout(&Format {
                colorspace,
                quantization,
                ..format(*b"YUYV", 12)
            })
            .unwrap()
            .full_range
        };
        assert!(!full(Colorspace::SRGB, Quantization::Default));
        assert!(full(Colorspace::JPEG, Quantization::Default));
        assert!(layout(&format(*b"GREY", 6)).unwrap().full_range);
        assert!(full(Colorspace::SRGB, Quantization::FullRange));
        assert!(!full(Colorspace::JPEG, Quantization::LimitedRange));
    }
}
