//! One frame from the camera's pixels to the coefficients: the hot path.
//!
//! Contract: [`Pipeline::process`] and [`Solver::solve`] allocate nothing, take no lock, write no log and reach no
//! panic. All memory is taken when they are made. A frame that gives no trustworthy result gives none at all.

use std::time::{Duration, Instant};

use crate::capture::{Frame, Picture};
use crate::config::{NetworkSettings, Settings};
use crate::face::{Landmarks, Tracker};
use crate::infer::{InferError, NetworkFolder};
use crate::solve::{
    AbsurdResult, Camera, Corrected, Correction, CorrectionState, DegenerateFace, Features, GatedAverage,
    GatedAverageState, HeadPose, Model, ModelError, Neutral, RawCoeffs, Smoothed, normalise,
};

/// Time step of the first frame after a gap, seconds.
const FIRST_STEP_S: f32 = 1.0 / 30.0;
/// A longer gap between frames starts filters anew, microseconds.
const GAP_US: u64 = 500_000;

/// What one frame gave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// As the regression gives them.
    pub raw: RawCoeffs,
    /// After the corrective terms.
    pub corrected: Corrected,
    /// After smoothing: what is sent.
    pub smoothed: Smoothed,
    /// The head.
    pub head: HeadPose,
}

/// Why a frame gave no solution.
#[derive(Debug, thiserror::Error)]
pub enum Rejected {
    /// There is no face in the picture.
    #[error("no face in the picture")]
    NoFace,
    /// A network failed.
    #[error(transparent)]
    Infer(#[from] InferError),
    /// The landmarks form no face.
    #[error(transparent)]
    Degenerate(#[from] DegenerateFace),
    /// The coefficients are none.
    #[error(transparent)]
    Absurd(#[from] AbsurdResult),
}

/// Why the pipeline cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// The landmark networks.
    #[error(transparent)]
    Networks(#[from] InferError),
    /// The blendshape model.
    #[error("{}", told(origin, error))]
    Model {
        /// The file, or that it is the built-in one.
        origin: String,
        /// What is wrong with it.
        error: ModelError,
    },
}

/// The error with its model, once.
fn told(origin: &str, error: &ModelError) -> String {
    match error {
        ModelError::Unreadable { .. } => error.to_string(),
        _ => format!("{origin}: {error}"),
    }
}

/// From landmarks to coefficients, with what it remembers between frames.
#[derive(Debug)]
pub struct Solver {
    model: Model,
    neutral: Option<Neutral>,
    correction: Correction,
    smoothing: GatedAverage,
    horizontal_fov_deg: f32,
    history: History,
}

#[derive(Debug)]
struct History {
    correction: CorrectionState,
    smoothing: GatedAverageState,
    last_us: Option<u64>,
}

impl Solver {
    /// Loads the model that the settings name.
    ///
    /// # Errors
    /// [`SetupError::Model`].
    pub fn load(settings: &Settings) -> Result<Self, SetupError> {
        let path = &settings.solver.model;
        let (origin, loaded) = if path.is_empty() {
            ("the built-in model".to_owned(), Model::embedded())
        } else {
            (path.clone(), Model::load(path.as_ref()))
        };
        let model = loaded.map_err(|error| SetupError::Model { origin, error })?;
        let correction = Correction::default();
        Ok(Self {
            history: History::new(&correction),
            model,
            neutral: None,
            correction,
            smoothing: GatedAverage::with_window(settings.solver.smoothing_frames),
            horizontal_fov_deg: settings.camera.horizontal_fov_deg,
        })
    }

    /// Takes the wearer's neutral face, from which displacements are measured from now on.
    pub fn set_neutral(&mut self, neutral: Neutral) {
        self.neutral = Some(neutral);
    }

    /// From the landmarks of a frame captured at `time_us`, in a picture of `size_px`, to coefficients.
    ///
    /// # Errors
    /// [`Rejected::Degenerate`] or [`Rejected::Absurd`]: the frame counts as if there were no face.
    pub fn solve(&mut self, landmarks: &Landmarks, size_px: [f32; 2], time_us: u64) -> Result<Solution, Rejected> {
        let step_s = self.history.step_s(&self.correction, time_us);
        let normalised = normalise(landmarks)?;
        let features = Features::new(&normalised, self.neutral.as_ref());
        let raw = self.model.process(&features)?;
        let corrected = self.correction.process(&mut self.history.correction, &raw, step_s);
        let smoothed = self.smoothing.process(&mut self.history.smoothing, &corrected);
        let [width_px, height_px] = size_px;
        let camera = Camera { width_px, height_px, horizontal_fov_deg: self.horizontal_fov_deg };
        Ok(Solution { raw, corrected, smoothed, head: HeadPose::new(&normalised, &camera) })
    }
}

impl History {
    fn new(correction: &Correction) -> Self {
        Self { correction: correction.start(), smoothing: GatedAverageState::default(), last_us: None }
    }

    /// Seconds since the last frame. A long gap, or a clock that ran backwards, forgets what was before it.
    fn step_s(&mut self, correction: &Correction, time_us: u64) -> f32 {
        let step_us = self.last_us.and_then(|last_us| time_us.checked_sub(last_us)).filter(|step_us| *step_us < GAP_US);
        if step_us.is_none() {
            *self = Self::new(correction);
        }
        self.last_us = Some(time_us);
        step_us.map_or(FIRST_STEP_S, |step_us| step_us as f32 / 1e6)
    }
}

/// How long each stage of a frame took; `None` for one that did not run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StageTimes {
    /// Where the face is: next to nothing while it is followed, else the detector.
    pub detect: Option<Duration>,
    /// Its landmarks.
    pub mesh: Option<Duration>,
    /// From landmarks to coefficients.
    pub solve: Option<Duration>,
}

/// Runs a stage and measures it. The clock is for statistics alone: no result depends on it.
fn timed<T>(time: &mut Option<Duration>, stage: impl FnOnce() -> T) -> T {
    let begun = Instant::now();
    let result = stage();
    *time = Some(begun.elapsed());
    result
}

/// From frames to coefficients.
pub struct Pipeline {
    /// Finds the landmarks.
    pub tracker: Tracker,
    /// Turns them into coefficients.
    pub solver: Solver,
    times: StageTimes,
}

impl Pipeline {
    /// Loads the networks and the model that the settings name.
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn load(settings: &Settings) -> Result<Self, SetupError> {
        Ok(Self {
            // First, so that the networks take the memory that reading the model leaves free.
            solver: Solver::load(settings)?,
            tracker: load_tracker(&settings.networks)?,
            times: StageTimes::default(),
        })
    }

    /// Solves one frame.
    ///
    /// # Errors
    /// [`Rejected`]: the frame gives nothing, and the next one is as good as any.
    pub fn process(&mut self, frame: &Frame) -> Result<Solution, Rejected> {
        let (picture, times) = (&frame.picture, &mut self.times);
        *times = StageTimes::default();
        let face = timed(&mut times.detect, || self.tracker.detect(picture))?.ok_or(Rejected::NoFace)?;
        let landmarks = timed(&mut times.mesh, || self.tracker.landmarks(picture, &face))?.ok_or(Rejected::NoFace)?;
        timed(&mut times.solve, || self.solver.solve(landmarks, size_px(picture), frame.captured_us))
    }

    /// How long the stages of the last frame took.
    #[must_use]
    pub fn times(&self) -> &StageTimes {
        &self.times
    }
}

/// Loads the networks that the settings name.
///
/// # Errors
/// Those of [`NetworkFolder::find`] and [`Tracker::load`].
pub fn load_tracker(settings: &NetworkSettings) -> Result<Tracker, InferError> {
    let folder = NetworkFolder::find(&settings.folder)?;
    Tracker::load(&folder, settings.threads as usize)
}

/// Width and height of a picture as the solver takes them.
#[must_use]
pub fn size_px(picture: &Picture) -> [f32; 2] {
    [picture.width as f32, picture.height as f32]
}
