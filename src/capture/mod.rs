//! Sources of frames: cameras, films, files of landmarks, standard input, and the built-in clip with or without faults.
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
mod open;
mod paced;
mod points;
mod rate;
mod read;
mod rehearsal;
pub mod v4l2;
mod y4m;

pub use avi::AviSource;
pub use clip::{Clip, DEMO};
pub use delivery::Delivery;
pub use error::{CaptureError, FrameFault};
pub use jpeg::JpegDecoder;
pub use open::{FileOptions, open_camera, open_file};
pub use paced::{Paced, monotonic_us};
pub use rate::FrameRate;
pub use y4m::Y4mSource;

use std::fmt;
use std::time::Duration;

use crate::impairment::ImpairmentSet;
use facewire_face::{Face, Picture};

/// One frame and the time of its capture, lent by its source until the next call.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    pub content: Content<'a>,
    /// Time of capture in microseconds: on `CLOCK_MONOTONIC` for a camera, from the beginning of the file for a file.
    pub captured_us: u64,
    /// Position in the source, from 0. Frames that were skipped or could not be read are counted.
    pub number: u64,
}

/// What a frame shows.
#[derive(Debug, Clone, Copy)]
pub enum Content<'a> {
    /// A picture in which the face is still to be found.
    Picture(Picture<'a>),
    /// The result of an earlier search: the face, with landmarks in pixels, and the size of the picture that was searched.
    Face { face: Option<Face<'a>>, size_px: [f32; 2] },
}

impl<'a> Frame<'a> {
    /// The picture, if the frame shows one.
    pub fn picture(&self) -> Option<&Picture<'a>> {
        match &self.content {
            Content::Picture(picture) => Some(picture),
            Content::Face { .. } => None,
        }
    }

    /// Width and height of the picture, in pixels.
    pub fn size_px(&self) -> [f32; 2] {
        match &self.content {
            Content::Picture(picture) => [picture.width as f32, picture.height as f32],
            Content::Face { size_px, .. } => *size_px,
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

    /// Returns how many frames [`Source::next`] has skipped since the last call of this method, also where it returned an
    /// error.
    fn take_skipped(&mut self) -> Skipped {
        Skipped::default()
    }

    /// Returns how long a camera's frames took to decode since the last call of this method.
    fn take_decoding(&mut self) -> Duration {
        Duration::ZERO
    }

    /// What the service is to take for impaired although it is not, because a rehearsal asks for it.
    fn rehearsed(&self) -> ImpairmentSet {
        ImpairmentSet::default()
    }

    /// Returns what a camera has delivered whenever a window of about 1.5 s is complete. A source that loses no frames and
    /// keeps its rate returns `None`.
    fn take_delivery(&mut self) -> Option<Delivery> {
        None
    }

    /// Time from one frame to the next in microseconds, if the source states a rate.
    fn frame_period_us(&self) -> Option<u64> {
        self.describe().rate.map(FrameRate::period_us)
    }

    /// Whether a camera offers pictures with half the pixels or fewer at the same rate.
    fn has_smaller_mode(&self) -> bool {
        false
    }

    /// Whether the frames are pictures, so that the landmark networks are needed.
    fn shows_pictures(&self) -> bool {
        true
    }

    fn describe(&self) -> Description<'_>;

    /// Closes the source. Dropping it does the same, but hides [`CaptureError::NotStopped`].
    fn close(self: Box<Self>) -> Result<(), CaptureError> {
        Ok(())
    }
}

/// Numbers of frames that were not decoded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Skipped {
    /// Frames skipped because a newer one had arrived.
    pub for_newer: u32,
    /// Frames left out because the reader wanted a later one ([`Source::leave_out_until`]).
    pub left_out: u32,
}

/// What a source delivers. Printed as `demo: MJPEG 640x480 at 30 fps`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Description<'a> {
    /// The camera or file.
    pub origin: &'a str,
    /// Name of the pixel format.
    pub format: &'static str,
    pub width: usize,
    pub height: usize,
    pub rate: Option<FrameRate>,
}

impl fmt::Display for Description<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {} {}x{}", self.origin, self.format, self.width, self.height)?;
        match self.rate {
            Some(rate) => write!(f, " at {rate}"),
            None => Ok(()),
        }
    }
}
