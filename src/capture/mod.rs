//! Sources of frames: cameras, Motion-JPEG films, and the built-in clip with or without faults.
//!
//! Contract: a [`Source`] lends one [`Frame`] at a time. Pictures stay in the camera's format, because the crop samples
//! the planes directly. Buffers get their size when a source is opened, and never grow. A frame that cannot be read is an
//! error of its own ([`CaptureError::Frame`]), after which the source continues with the next frame.
//!
//! Limits: pictures of up to [`facewire_face::MAX_SIDE_PX`] pixels a side with 8 bits per sample.

mod avi;
mod clip;
mod delivery;
mod error;
mod jpeg;
mod live;
mod pipe;
mod rehearsal;
mod repeats;
pub mod v4l2;

pub use avi::AviSource;
pub use clip::{Clip, DEMO};
pub use delivery::Delivery;
pub use error::{CaptureError, FrameFault};
pub use jpeg::JpegDecoder;

use std::fmt;
use std::ops::RangeInclusive;
use std::path::Path;
use std::time::Duration;

use facewire_face::{Camera, Face, Picture};

pub use self::pipe::module_pipe;
use self::pipe::{PipeSource, is_pipe};
use self::rehearsal::Rehearsal;
use self::v4l2::{AUTO, CameraSource, Wish, cameras, start_one};
use crate::config::Script;
use facewire_board::ImpairmentSet;

/// Opens the camera that a setting names (see [`CameraSource::open`]), or the named pipe through which another program passes it.
/// `auto` takes the camera module of a Raspberry Pi if its service runs. The name `demo` stands for the built-in clip, which
/// is repeated in real time, and a [`Script`] for a rehearsal. A camera that delivers nothing for `timeout` has stalled.
pub fn open_camera(device: &str, wish: &Wish, timeout: Duration) -> Result<Box<dyn Source + Send>, CaptureError> {
    match Script::of(device) {
        _ if device == DEMO => Ok(Box::new(Rehearsal::open(None, wish.width, timeout)?)),
        Some(Ok(script)) => Ok(Box::new(Rehearsal::open(Some(script), wish.width, timeout)?)),
        Some(Err(expected)) => Err(CaptureError::Absent(format!("{device} is no rehearsal; give {expected}"))),
        None if is_pipe(device) => Ok(Box::new(PipeSource::open(device, "", wish, timeout)?)),
        None if device == AUTO => open_any(wish, timeout),
        None => Ok(Box::new(CameraSource::open(device, wish, timeout)?)),
    }
}

/// Opens the camera module of a Raspberry Pi if its service runs, or else another camera.
fn open_any(wish: &Wish, timeout: Duration) -> Result<Box<dyn Source + Send>, CaptureError> {
    let module = module_pipe();
    let open = |path: &Path, note: &str| -> Result<Box<dyn Source + Send>, CaptureError> {
        match module {
            Some(module) if path == Path::new(module) => Ok(Box::new(PipeSource::open(module, note, wish, timeout)?)),
            _ => Ok(Box::new(CameraSource::open_node(path, note, wish, timeout)?)),
        }
    };
    start_one(module.map(Path::new), cameras, AUTO, wish, open)
}

/// One frame and the time of its capture, lent by its source until the next call.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    pub content: Content<'a>,
    /// Time of capture in microseconds: on `CLOCK_MONOTONIC` for a camera, from the beginning of the file for a file.
    pub captured_us: u64,
    /// Position in the source, from 0. Frames that were skipped or could not be read count.
    pub number: u64,
}

#[derive(Debug, Clone, Copy)]
pub enum Content<'a> {
    /// A picture in which the face is still to be found.
    Picture(Picture<'a>),
    /// The result of an earlier search: the face, with landmarks in pixels, and the size of the picture that was searched.
    Face { face: Option<Face<'a>>, size_px: [f32; 2] },
}

impl<'a> Frame<'a> {
    pub fn picture(&self) -> Option<&Picture<'a>> {
        match &self.content {
            Content::Picture(picture) => Some(picture),
            Content::Face { .. } => None,
        }
    }

    pub fn size_px(&self) -> [f32; 2] {
        match &self.content {
            Content::Picture(picture) => picture.size_px(),
            Content::Face { size_px, .. } => *size_px,
        }
    }

    /// The camera that captured the frame, whose angle of view is that across its rows.
    pub fn camera(&self, horizontal_fov_deg: f32) -> Camera {
        let camera = Camera::new(self.size_px(), horizontal_fov_deg);
        if self.picture().is_some_and(|picture| picture.rotation().is_sideways()) {
            camera.on_its_side()
        } else {
            camera
        }
    }
}

/// Something that gives frames.
pub trait Source {
    /// Returns the next frame of a file, or `None` at its end. Waits for the newest frame of a camera.
    ///
    /// After [`CaptureError::Frame`] the next call continues with the following frame. After any other error a file has
    /// ended, and a camera must be opened again.
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError>;

    /// Skips one frame, without decoding it if possible. Returns `false` at the end of a file.
    fn skip(&mut self) -> Result<bool, CaptureError> {
        Ok(self.next()?.is_some())
    }

    /// Lets the next call of [`Source::next`] leave out the frames that a camera captured before this time, without
    /// decoding them. It then waits for the first frame that was captured later.
    fn leave_out_until(&mut self, _captured_us: u64) {}

    /// Returns what this source has counted since the last call of this method, also where [`Source::next`] failed.
    fn take_tally(&mut self) -> Tally {
        Tally::default()
    }

    /// Returns what a camera has delivered whenever a window of about 1.5 s is complete.
    fn take_delivery(&mut self) -> Option<Delivery> {
        None
    }

    fn frame_period_us(&self) -> Option<u64> {
        self.describe().rate.map(FrameRate::period_us)
    }

    /// Whether a camera offers pictures with half the pixels or fewer at the same rate.
    fn has_smaller_mode(&self) -> bool {
        false
    }

    /// Whether the landmark networks are needed.
    fn shows_pictures(&self) -> bool {
        true
    }

    fn describe(&self) -> Description<'_>;

    /// Closes the source. Dropping it does the same, but hides [`CaptureError::NotStopped`].
    fn close(self: Box<Self>) -> Result<(), CaptureError> {
        Ok(())
    }
}

/// What a source has counted and measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Tally {
    /// Frames skipped because a newer one had arrived.
    pub for_newer: u32,
    /// Frames left out because the reader wanted a later one ([`Source::leave_out_until`]).
    pub left_out: u32,
    /// Frames whose time of arrival is used, because their driver timestamp cannot be true.
    pub mistimed: u32,
    /// Whether the driver's timestamps have been given up for this camera.
    pub has_false_clock: bool,
    /// Bytes of a file that stood between its frames and do not belong there.
    pub stray_bytes: u64,
    pub decoding: Duration,
    pub motion: Motion,
    /// What the service is to take for impaired although it is not, because a rehearsal asks for it.
    pub rehearsed: ImpairmentSet,
}

/// Whether the picture of a camera or a program changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Motion {
    #[default]
    Moving,
    /// The last frame shows the same picture as all those of the last second. What a program sends may be a photo.
    Frozen,
    /// The same, and the camera hangs or shows nothing: its sensor would have noise.
    Hung,
}

/// What a source delivers. Printed as `demo: MJPEG 640x480 at 30 fps`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Description<'a> {
    pub origin: &'a str,
    pub format: &'static str,
    pub width: usize,
    pub height: usize,
    pub rate: Option<FrameRate>,
}

impl fmt::Display for Description<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} {}x{}", self.origin, self.format, self.width, self.height)?;
        self.rate.iter().try_for_each(|rate| write!(f, " at {rate}"))
    }
}

/// A rate of `frames` in `seconds`, between 0.1 and 1000 frames per second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameRate {
    frames: u32,
    seconds: u32,
}

impl FrameRate {
    pub const FPS_30: Self = Self { frames: 30, seconds: 1 };
    /// The slowest rate that is believed.
    pub const SLOWEST: Self = Self { frames: 1, seconds: 10 };
    /// Frames per second that are believed. Files with a slower or faster rate hold arbitrary numbers.
    const BELIEVED_FPS: RangeInclusive<f64> = 0.1..=1000.0;

    /// Returns `None` if the rate is not believed.
    pub fn new(frames: u32, seconds: u32) -> Option<Self> {
        let rate = Self { frames, seconds };
        (frames > 0 && seconds > 0 && Self::BELIEVED_FPS.contains(&rate.fps())).then_some(rate)
    }

    pub fn from_fps(fps: f64) -> Option<Self> {
        let millionths = Self::BELIEVED_FPS.contains(&fps).then(|| (fps * 1e6).round() as u32)?;
        Self::new(millionths, 1_000_000)
    }

    pub fn fps(self) -> f64 {
        f64::from(self.frames) / f64::from(self.seconds)
    }

    /// Time from one frame to the next in microseconds, rounded down.
    pub fn period_us(self) -> u64 {
        self.stamp_us(1)
    }

    /// Time of frame `number` in microseconds after frame 0, exact to 1 microsecond for streams of any length.
    pub fn stamp_us(self, number: u64) -> u64 {
        let us = u128::from(number) * 1_000_000 * u128::from(self.seconds) / u128::from(self.frames);
        u64::try_from(us).unwrap_or(u64::MAX)
    }
}

impl fmt::Display for FrameRate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} fps", (self.fps() * 100.0).round() / 100.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_do_not_drift_over_a_day_of_ntsc_and_absurd_rates_are_refused() {
        let ntsc = FrameRate::new(30_000, 1001).unwrap();
        assert_eq!(ntsc.stamp_us(30_000 * 86), 1_001_000_000 * 86);
        assert_eq!((ntsc.period_us(), ntsc.to_string().as_str()), (33_366, "29.97 fps"));
        assert_eq!(FrameRate::new(1, 10).unwrap().period_us(), 10_000_000);
        for (frames, seconds) in [(0, 1), (1, 0), (1, 11), (u32::MAX, 1), (0, 0)] {
            assert_eq!(FrameRate::new(frames, seconds), None, "{frames}/{seconds}");
        }
    }

    #[test]
    fn a_path_to_another_kind_of_device_is_refused_before_it_is_opened() {
        let wish = Wish { width: 640, height: 480, rate: FrameRate::FPS_30, format: None };
        let reason = |path| open_camera(path, &wish, Duration::ZERO).err().unwrap().to_string();
        for path in ["/dev/null", "/dev/tty", "/etc/passwd"] {
            assert!(reason(path).starts_with(&format!("{path} is not a camera")));
        }
        assert!(reason("/dev/video4000").contains("no camera is called /dev/video4000"));
    }
}
