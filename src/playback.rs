//! Plays a file through the pipeline in the file's own time, as the service runs a camera.
//!
//! [`Playback::find`] finds the faces of a file, and [`Playback::show`] solves them and returns what the service would
//! send. Faces can be kept in between, so that the neutral face may come from a later frame, or to solve them several
//! times.

use std::ops::Range;

use facewire_face::stages::{FaceMean, normalise};
use facewire_face::{Appearance, Landmarks, Neutral, Solution, SolveError};
use facewire_packet::{Pose, Reason, State};

use crate::capture::{CaptureError, Content, Frame, FrameFault, FrameRate, Source};
use crate::config::FailsafeSettings;
use crate::pipeline::{Pipeline, Rejected, SetupError};
use crate::service::ServiceError;
use crate::service::failsafe::{Failsafe, History};

#[derive(Debug, Clone)]
pub struct TrackedFrame {
    pub number: u64,
    pub time_us: u64,
    size_px: [f32; 2],
    pub landmarks: Option<Box<Landmarks>>,
    /// How the face looks at the landmarks, if the frame shows one in a picture.
    appearance: Option<Appearance>,
    /// Why the frame could not be read. It counts as one without a face.
    pub fault: Option<FrameFault>,
}

#[derive(Debug, Clone, Copy)]
pub struct Shown {
    pub solution: Option<Solution>,
    /// Live with a solution, else the state of the failsafe.
    pub state: State,
    /// The pose to show: that of the solution, else the one that the failsafe holds or lets decay.
    pub pose: Pose,
}

pub struct Playback {
    pub pipeline: Pipeline,
    failsafe: FailsafeSettings,
    frame_period_us: u64,
    history: History,
}

impl Playback {
    pub fn new(pipeline: Pipeline, settings: &FailsafeSettings) -> Self {
        Self { pipeline, failsafe: settings.clone(), frame_period_us: 0, history: History::default() }
    }

    /// Reads the next frame and finds its face; `None` at the end. Landmarks that form no face are kept, but the next
    /// frame is searched anew.
    pub fn find(&mut self, source: &mut dyn Source) -> Result<Option<TrackedFrame>, ServiceError> {
        let rate = source.describe().rate;
        self.frame_period_us = rate.map_or(0, FrameRate::period_us);
        let face = match source.next() {
            Ok(None) => return Ok(None),
            Ok(Some(frame)) => {
                let face = self.pipeline.find(&frame).map_err(SetupError::from)?;
                TrackedFrame {
                    number: frame.number,
                    time_us: frame.captured_us,
                    size_px: frame.size_px(),
                    landmarks: face.map(|face| Box::new(face.landmarks.clone())),
                    appearance: face.and_then(|face| face.appearance.cloned()),
                    fault: None,
                }
            }
            Err(CaptureError::Frame { number, fault }) => {
                let time_us = rate.map_or(0, |rate| rate.stamp_us(number));
                let fault = Some(fault);
                TrackedFrame { number, time_us, size_px: [0.0; 2], landmarks: None, appearance: None, fault }
            }
            Err(error) => return Err(error.into()),
        };
        if face.landmarks.as_deref().is_some_and(|landmarks| normalise(landmarks).is_err()) {
            self.pipeline.lose_face();
        }
        Ok(Some(face))
    }

    /// Solves a face. A frame without a solution shows what the service would send.
    pub fn show(&mut self, face: &TrackedFrame) -> Shown {
        let solved = self.pipeline.process(&face.frame()).solved;
        if matches!(solved, Err(Rejected::Unsolved)) {
            self.pipeline.lose_face();
        }
        let solution = solved.ok();
        let pose = solution.as_ref().map(Pose::from);
        let news = pose.map(|pose| (pose, face.time_us)).ok_or(Reason::NoFace);
        let failsafe = Failsafe::new(&self.failsafe, self.frame_period_us);
        let sent = failsafe.update(&mut self.history, face.time_us, Some(&news));
        let (state, pose) = pose.map_or((sent.state, sent.pose), |pose| (State::Live, pose));
        Shown { solution, state, pose }
    }
}

impl TrackedFrame {
    pub fn frame(&self) -> Frame<'_> {
        let appearance = self.appearance.as_ref();
        let face = self.landmarks.as_deref().map(|landmarks| facewire_face::Face { landmarks, appearance });
        let content = Content::Face { face, size_px: self.size_px };
        Frame { content, captured_us: self.time_us, number: self.number }
    }
}

/// Returns the mean of the faces of these frames, to be taken as the wearer's neutral face.
pub fn neutral_of(faces: &[TrackedFrame], frames: &Range<u64>) -> Result<Neutral, SolveError> {
    let mut mean = FaceMean::default();
    let chosen = faces.iter().filter(|face| frames.contains(&face.number));
    for normalised in chosen.filter_map(|face| normalise(face.landmarks.as_deref()?).ok()) {
        mean.add(&normalised);
    }
    mean.neutral()
}
