//! The frames of a file with the landmarks that were found in them, kept until they are solved.

use super::super::Failure;
use crate::capture::{CaptureError, Content, Frame, Source};
use crate::face::Landmarks;
use crate::pipeline::Pipeline;

/// One frame of the input.
#[derive(Debug, Clone)]
pub(super) struct Face {
    /// Position in the input, from 0.
    pub(super) number: u64,
    /// Time of the frame, by the input.
    pub(super) time_us: u64,
    /// Width and height of the picture.
    size_px: [f32; 2],
    /// The landmarks in pixels, if the frame shows a face.
    pub(super) landmarks: Option<Box<Landmarks>>,
    /// Whether the frame could not be read. It counts as one without a face.
    pub(super) damaged: bool,
}

impl Face {
    /// Reads the next frame and finds its landmarks; `None` at the end.
    pub(super) fn next(source: &mut dyn Source, pipeline: &mut Pipeline) -> Result<Option<Self>, Failure> {
        let rate = source.describe().rate;
        match source.next() {
            Ok(None) => Ok(None),
            Ok(Some(frame)) => Ok(Some(Self {
                number: frame.number,
                time_us: frame.captured_us,
                size_px: frame.size_px(),
                landmarks: pipeline.find(&frame)?.map(|landmarks| Box::new(landmarks.clone())),
                damaged: false,
            })),
            Err(CaptureError::Frame { number, .. }) => {
                let time_us = rate.map_or(0, |rate| rate.stamp_us(number));
                Ok(Some(Self { number, time_us, size_px: [0.0; 2], landmarks: None, damaged: true }))
            }
            Err(error) => Err(error.into()),
        }
    }

    /// The frame for the rest of the pipeline.
    pub(super) fn frame(&self) -> Frame<'_> {
        let content = Content::Landmarks { landmarks: self.landmarks.as_deref(), size_px: self.size_px };
        Frame { content, captured_us: self.time_us, number: self.number }
    }
}
