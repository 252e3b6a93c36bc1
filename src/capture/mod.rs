//! Where frames come from: cameras, Motion-JPEG and y4m files, standard input, the built-in clip, and that with faults.
//!
//! Contract: a [`Source`] lends one [`Frame`] at a time in the camera's own format; nothing converts the colour of a
//! whole frame, the crop samples the planes directly. Buffers are sized when a source is opened and never grow.
//! A frame that fails is an error of its own ([`CaptureError::Frame`]) and the source goes on with the next.
//!
//! Limits: pictures up to [`MAX_SIDE_PX`] a side, 8 bits a sample.

mod avi;
mod clip;
mod error;
mod jpeg;
mod open;
mod paced;
mod picture;
mod points;
mod rate;
mod read;
mod rehearsal;
mod riff;
#[cfg(test)]
mod testing;
pub mod v4l2;
mod y4m;

pub use avi::AviSource;
pub use clip::Clip;
pub use error::{CaptureError, FrameFault};
pub use jpeg::JpegDecoder;
pub use open::{DEMO, FileOptions, open_camera, open_file};
pub use paced::{Paced, monotonic_us};
pub use picture::{MAX_SIDE_PX, Picture, Pixels};
pub use points::PointsSource;
pub use rate::FrameRate;
pub use y4m::Y4mSource;

use std::fmt;

use crate::face::Landmarks;

/// One frame and the time of its capture, lent by its source until the next call.
#[derive(Debug, Clone, Copy)]
pub struct Frame<'a> {
    /// What the frame shows.
    pub content: Content<'a>,
    /// When it was captured: microseconds of `CLOCK_MONOTONIC` for a camera, of the file's own time from 0 for a file.
    pub captured_us: u64,
    /// Position in the source, counting frames that were skipped or failed; starts at 0 for a file.
    pub number: u64,
}

/// What a frame shows.
#[derive(Debug, Clone, Copy)]
pub enum Content<'a> {
    /// A picture in which the face is still to be found.
    Picture(Picture<'a>),
    /// The result of an earlier search.
    Landmarks {
        /// The landmarks in pixels; `None` where no face was found.
        landmarks: Option<&'a Landmarks>,
        /// Width and height of the picture that was searched.
        size_px: [f32; 2],
    },
}

impl<'a> Frame<'a> {
    /// The picture, if the frame shows one.
    #[must_use]
    pub fn picture(&self) -> Option<&Picture<'a>> {
        match &self.content {
            Content::Picture(picture) => Some(picture),
            Content::Landmarks { .. } => None,
        }
    }

    /// Width and height of the picture, in pixels.
    #[must_use]
    pub fn size_px(&self) -> [f32; 2] {
        match &self.content {
            Content::Picture(picture) => [picture.width as f32, picture.height as f32],
            Content::Landmarks { size_px, .. } => *size_px,
        }
    }
}

/// Something that gives frames.
pub trait Source {
    /// The next frame (a camera: the newest, waiting for it if need be); `None` at the end of a file.
    ///
    /// # Errors
    /// After [`CaptureError::Frame`] the next call goes on behind the failed frame; after any other error a file has
    /// ended and a camera must be opened again.
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError>;

    /// Passes over one frame as cheaply as the source can; `false` at the end of a file.
    ///
    /// # Errors
    /// As [`Source::next`].
    fn skip(&mut self) -> Result<bool, CaptureError> {
        Ok(self.next()?.is_some())
    }

    /// How many frames were passed over for newer ones since this was last asked, whatever [`Source::next`] said then.
    fn take_skipped(&mut self) -> u32 {
        0
    }

    /// Time from one frame to the next, if the source states it.
    fn frame_period_us(&self) -> Option<u64>;

    /// Whether the frames are pictures, so that the landmark networks are needed.
    fn shows_pictures(&self) -> bool {
        true
    }

    /// What this source is, for the operator.
    fn describe(&self) -> Description<'_>;

    /// Closes the source. Dropping it does the same, but hides the error.
    ///
    /// # Errors
    /// [`CaptureError::NotStopped`] if a camera stays open for the rest of the process, so that nobody can open it again.
    fn close(self: Box<Self>) -> Result<(), CaptureError> {
        Ok(())
    }
}

/// What a source delivers, printed as `demo: MJPEG 640x480 at 30 fps`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Description<'a> {
    /// The device node or file.
    pub origin: &'a str,
    /// Name of the pixel format.
    pub format: &'static str,
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Frames a second, if stated.
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
