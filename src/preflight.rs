//! Preflight: loads what settings name, and finds out what their text cannot tell.
//!
//! [`crate::config`] judges settings by their text alone. Whether the networks and the model that they name can be used at
//! this moment is found out here, and by [`crate::link`] for links. The service does so when it starts, a reload for the
//! parts that it changes, and `facewire check` for every part by itself.

use crate::calibration::{Store, StoreError, WearerName};
use crate::config::{NetworkSettings, Settings, SmoothingSettings, SolverSettings, WearerSettings};
use crate::face::Tracker;
use crate::infer::{self, InferError};
use crate::solve::{Filters, HeadFilter, Model, ModelError, Profile, Shaping, Solver};

/// Why a part that settings name cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    /// The landmark networks do not load, or do not run.
    #[error(transparent)]
    Networks(#[from] InferError),
    /// The blendshape model does not load.
    #[error("{}", with_path(path, error))]
    Model {
        /// The path of the model file.
        path: String,
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

/// Names the file in front of an error that does not name it itself.
fn with_path(path: &str, error: &ModelError) -> String {
    match error {
        ModelError::Unreadable { .. } => error.to_string(),
        _ => format!("{path}: {error}"),
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
    if path.is_empty() {
        return Ok(Model::embedded());
    }
    Model::load(path.as_ref()).map_err(|error| SetupError::Model { path: path.clone(), error })
}

/// Whether both settings name the same profile.
#[must_use]
pub fn is_same_profile(one: &WearerSettings, other: &WearerSettings) -> bool {
    (&one.name, &one.folder) == (&other.name, &other.folder)
}

/// Loads the profile of the wearer that the settings name, or nobody's.
///
/// # Errors
/// Those of [`Store::load`].
pub fn load_profile(settings: &WearerSettings) -> Result<Profile, StoreError> {
    match WearerName::new(&settings.name) {
        Some(name) => Ok(Store::new(&settings.folder).load(&name)?.profile),
        None => Ok(Profile::default()),
    }
}

/// The rules, filters and adjustments that the settings ask for.
#[must_use]
pub fn shaping(settings: &Settings) -> Shaping {
    Shaping {
        rules: settings.plausibility.rules(),
        filters: filters(&settings.smoothing),
        adjustments: settings.adjust.0.clone(),
    }
}

fn filters(settings: &SmoothingSettings) -> Filters {
    let seconds = |ms: u32| ms as f32 / 1000.0;
    let of_group = |group| {
        let (kind, ms) = settings.of(group);
        group.filter(kind, seconds(ms))
    };
    Filters::new(of_group, HeadFilter::new(settings.head, seconds(settings.head_ms)))
}

/// A solver by the settings, for a wearer of whom nothing is known.
///
/// # Errors
/// Those of [`load_model`].
pub fn load_solver(settings: &Settings) -> Result<Solver, SetupError> {
    let mut solver = Solver::new(load_model(&settings.solver)?, Profile::default(), shaping(settings));
    solver.neutral_mode = settings.wearer.neutral;
    Ok(solver)
}
