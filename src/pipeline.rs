//! One frame from the camera's pixels to the coefficients: the hot path.
//!
//! Contract: [`Pipeline::process`] allocates nothing, takes no lock, writes no log and reaches no
//! panic. All memory is taken when the pipeline is made. A frame that gives no trustworthy result gives none at all.

use std::time::{Duration, Instant};

use crate::capture::{Frame, Picture};
use crate::config::{NetworkSettings, Settings, SolverSettings};
use crate::face::Tracker;
use crate::infer::{self, InferError};
use crate::solve::{Camera, Filters, Model, ModelError, Profile, Solution, SolveError, Solver};

/// Why a frame gave no solution.
#[derive(Debug, thiserror::Error)]
pub enum Rejected {
    /// There is no face in the picture.
    #[error("no face in the picture")]
    NoFace,
    /// A network failed.
    #[error(transparent)]
    Infer(#[from] InferError),
    /// The landmarks give no solution.
    #[error(transparent)]
    Unsolved(#[from] SolveError),
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

impl SetupError {
    /// Whether the same attempt can succeed later without anybody changing the settings or a file: a disk may be mounted.
    #[must_use]
    pub fn is_temporary(&self) -> bool {
        matches!(self, Self::Model { error: ModelError::Unreadable { .. }, .. })
    }
}

/// The error with its model, once.
fn told(origin: &str, error: &ModelError) -> String {
    match error {
        ModelError::Unreadable { .. } => error.to_string(),
        _ => format!("{origin}: {error}"),
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
    /// Angle of view of the camera, for the head's position.
    pub horizontal_fov_deg: f32,
    times: StageTimes,
}

impl Pipeline {
    /// Loads the networks and the model that the settings name.
    ///
    /// # Errors
    /// [`SetupError`].
    pub fn load(settings: &Settings) -> Result<Self, SetupError> {
        // First the model, so that the networks take the memory that reading it leaves free.
        let solver = load_solver(&settings.solver)?;
        Ok(Self::new(load_tracker(&settings.networks)?, solver, settings.camera.horizontal_fov_deg))
    }

    /// A pipeline of these parts, for a camera with this angle of view.
    #[must_use]
    pub fn new(tracker: Tracker, solver: Solver, horizontal_fov_deg: f32) -> Self {
        Self { tracker, solver, horizontal_fov_deg, times: StageTimes::default() }
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
        let camera = Camera::new(size_px(picture), self.horizontal_fov_deg);
        Ok(timed(&mut times.solve, || self.solver.solve(landmarks, &camera, frame.captured_us))?)
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
/// Those of [`infer::engine`] and [`Tracker::load`].
pub fn load_tracker(settings: &NetworkSettings) -> Result<Tracker, InferError> {
    Tracker::load(infer::engine(settings)?.as_ref())
}

/// Loads the model that the settings name.
///
/// # Errors
/// [`SetupError::Model`].
pub fn load_model(settings: &SolverSettings) -> Result<Model, SetupError> {
    let path = &settings.model;
    let (origin, loaded) = if path.is_empty() {
        ("the built-in model".to_owned(), Model::embedded())
    } else {
        (path.clone(), Model::load(path.as_ref()))
    };
    loaded.map_err(|error| SetupError::Model { origin, error })
}

/// The filters that the settings ask for.
#[must_use]
pub fn filters(settings: &SolverSettings) -> Filters {
    Filters::gated_average(settings.smoothing_ms as f32 / 1000.0)
}

/// A solver by the settings, for a wearer of whom nothing is known.
///
/// # Errors
/// Those of [`load_model`].
pub fn load_solver(settings: &SolverSettings) -> Result<Solver, SetupError> {
    Ok(Solver::new(load_model(settings)?, Profile::default(), filters(settings)))
}

/// Width and height of a picture as the solver takes them.
#[must_use]
pub fn size_px(picture: &Picture) -> [f32; 2] {
    [picture.width as f32, picture.height as f32]
}
