//! Landmarks from a recording of facewire.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use super::{CaptureError, Content, Description, Frame, FrameRate, Source};
use crate::face::Face;
use crate::recording::{Reader, Recorded, RecordingError};

/// A recording as a source of landmarks.
pub struct RecordingSource {
    reader: Reader<BufReader<File>>,
    /// The first frame, which was read for the size of its picture.
    first: Option<Recorded>,
    current: Option<Recorded>,
    origin: String,
    size_px: [u16; 2],
    number: u64,
}

impl RecordingSource {
    /// Opens the file at `path`.
    ///
    /// # Errors
    /// [`CaptureError::Recording`].
    pub fn open(path: &str) -> Result<Self, CaptureError> {
        let refuse = |error| CaptureError::Recording { path: path.to_owned(), error };
        let mut reader = Reader::open(Path::new(path)).map_err(refuse)?;
        let first = reader.next_frame().map_err(refuse)?;
        let size_px = first.as_ref().map_or([0; 2], |frame| frame.size_px);
        Ok(Self { reader, first, current: None, origin: path.to_owned(), size_px, number: 0 })
    }
}

impl Source for RecordingSource {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        let refuse = |error: RecordingError| CaptureError::Recording { path: self.origin.clone(), error };
        self.current = match self.first.take() {
            Some(first) => Some(first),
            None => self.reader.next_frame().map_err(refuse)?,
        };
        let Some(frame) = &self.current else { return Ok(None) };
        let number = self.number;
        self.number += 1;
        let content =
            Content::Face { face: frame.landmarks.as_ref().map(Face::from), size_px: frame.size_px.map(f32::from) };
        Ok(Some(Frame { content, captured_us: frame.time_us, number }))
    }

    fn frame_period_us(&self) -> Option<u64> {
        None
    }

    fn shows_pictures(&self) -> bool {
        false
    }

    fn describe(&self) -> Description<'_> {
        let [width, height] = self.size_px.map(usize::from);
        Description { origin: &self.origin, format: "recording", width, height, rate: None::<FrameRate> }
    }
}
