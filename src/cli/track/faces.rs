//! Where `track` gets landmarks from: a film through the networks, or a `.npy` file of points.

use std::path::Path;

use super::super::Failure;
use super::points::{Values, next_points, open_points};
use crate::capture::{CaptureError, Source, open_file};
use crate::config::Settings;
use crate::face::{Landmarks, Tracker};
use crate::infer::InferError;
use crate::pipeline::{load_tracker, size_px};

/// Rate of a film or of points that state none, frames a second.
const DEFAULT_FPS: f64 = 30.0;

/// One frame, with its landmarks if it shows a face.
#[derive(Debug, Clone)]
pub(super) struct Face {
    /// Position in the input, from 0.
    pub(super) number: u64,
    /// Its moment on the input's own clock.
    pub(super) time_us: u64,
    /// Width and height of the picture.
    pub(super) size_px: [f32; 2],
    /// In pixels.
    pub(super) landmarks: Option<Box<Landmarks>>,
    /// The frame was damaged.
    pub(super) damaged: bool,
}

/// A stream of faces.
pub(super) enum Faces {
    /// A film and the networks.
    Film { source: Box<dyn Source + Send>, tracker: Box<Tracker>, period_us: Option<f64>, numbered: u64 },
    /// Points read from a file.
    Points { values: Values, left: u64, number: u64, period_us: f64, size_px: [f32; 2] },
}

impl Faces {
    /// Opens `input`. `fps` gives the time step where the input has none; `size_px` the picture that points lie in.
    pub(super) fn open(input: &str, settings: &Settings, fps: Option<f64>, size_px: [f32; 2]) -> Result<Self, Failure> {
        let period_us = 1e6 / fps.unwrap_or(DEFAULT_FPS);
        if Path::new(input).extension().is_some_and(|ending| ending.eq_ignore_ascii_case("npy")) {
            let (values, left) = open_points(Path::new(input))?;
            return Ok(Self::Points { values, left, number: 0, period_us, size_px });
        }
        let source = open_file(input)?;
        let tracker = Box::new(load_tracker(&settings.networks)?);
        let period_us = source.frame_period_us().is_none().then_some(period_us);
        Ok(Self::Film { source, tracker, period_us, numbered: 0 })
    }

    /// The next frame; `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<Face>, Failure> {
        match self {
            Self::Film { source, tracker, period_us, numbered } => {
                let face = next_of_film(source.as_mut(), tracker, *numbered)?;
                *numbered = face.as_ref().map_or(*numbered, |face| face.number + 1);
                Ok(face.map(|face| match period_us {
                    Some(period_us) => Face { time_us: stamp_us(face.number, *period_us), ..face },
                    None => face,
                }))
            }
            Self::Points { left: 0, .. } => Ok(None),
            Self::Points { values, left, number, period_us, size_px } => {
                let landmarks = next_points(values, *number)?;
                let face = Face {
                    number: *number,
                    time_us: stamp_us(*number, *period_us),
                    size_px: *size_px,
                    landmarks: landmarks.is_finite().then_some(landmarks),
                    damaged: false,
                };
                *left -= 1;
                *number += 1;
                Ok(Some(face))
            }
        }
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a time of at most some days")]
fn stamp_us(number: u64, period_us: f64) -> u64 {
    (number as f64 * period_us) as u64
}

/// A damaged frame is one without a face; it keeps its row.
fn next_of_film(source: &mut dyn Source, tracker: &mut Tracker, expected: u64) -> Result<Option<Face>, Failure> {
    let period_us = source.frame_period_us().unwrap_or_default();
    match source.next() {
        Ok(None) => Ok(None),
        Ok(Some(frame)) => Ok(Some(Face {
            number: frame.number,
            time_us: frame.captured_us,
            size_px: size_px(&frame.picture),
            landmarks: find(tracker, &frame.picture)?,
            damaged: false,
        })),
        Err(CaptureError::Frame { number, .. }) => {
            let number = number.max(expected);
            Ok(Some(Face { number, time_us: number * period_us, size_px: [0.0; 2], landmarks: None, damaged: true }))
        }
        Err(error) => Err(error.into()),
    }
}

fn find(tracker: &mut Tracker, picture: &crate::capture::Picture) -> Result<Option<Box<Landmarks>>, InferError> {
    let Some(region) = tracker.detect(picture)? else { return Ok(None) };
    Ok(tracker.landmarks(picture, &region)?.map(|landmarks| Box::new(landmarks.clone())))
}
