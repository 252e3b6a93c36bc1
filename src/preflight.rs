//! Preflight: loads what settings name, and finds out what their text cannot tell.
//!
//! [`crate::config`] judges settings by their text alone. Whether the files that they name can be used is found out here.

use facewire_face::{Filters, Group, InferError, Model, ModelError, Profile, Shaping, Solver, Tracker};

use crate::calibration::{Store, StoreError, WearerName, model_hash};
use crate::config::{NetworkSettings, Settings, SolverSettings, WearerSettings};

#[derive(Debug, thiserror::Error)]
pub enum SetupError {
    #[error(transparent)]
    Networks(#[from] InferError),
    /// The blendshape model does not load. An error that does not name the file itself gets its path in front.
    #[error("{}{error}", if self.is_temporary() { String::new() } else { format!("{path}: ") })]
    Model { path: String, error: ModelError },
}

impl SetupError {
    /// Whether the same attempt can succeed later without anybody changing the settings or a file: a disk may be mounted.
    pub fn is_temporary(&self) -> bool {
        matches!(self, Self::Model { error: ModelError::Unreadable { .. }, .. })
    }
}

pub fn load_tracker(settings: &NetworkSettings) -> Result<Tracker, InferError> {
    Tracker::load(facewire_face::engine(settings.engine, &settings.folder, settings.threads)?.as_ref())
}

pub fn load_model(settings: &SolverSettings) -> Result<Model, SetupError> {
    let path = &settings.model;
    if path.is_empty() {
        return Ok(Model::embedded());
    }
    Model::load(path.as_ref()).map_err(|error| SetupError::Model { path: path.clone(), error })
}

pub fn is_same_profile(one: &WearerSettings, other: &WearerSettings) -> bool {
    (&one.name, &one.folder) == (&other.name, &other.folder)
}

/// Returns the wearer's profile, and the [`model_warning`] of it.
pub fn load_profile(wearer: &WearerSettings, solver: &SolverSettings) -> Result<(Profile, Option<String>), StoreError> {
    let Some(name) = WearerName::new(&wearer.name) else { return Ok((Profile::default(), None)) };
    let file = Store::new(&wearer.folder).load(&name)?;
    let warning = model_warning(&name, file.model, solver);
    Ok((file.profile, warning))
}

/// Says that a wearer's profile was made with another model, if it was: what it says of the wearer's rest and range may
/// then not fit.
pub fn model_warning(name: &WearerName, made_with: Option<u32>, solver: &SolverSettings) -> Option<String> {
    (made_with? != model_hash(&load_model(solver).ok()?)).then(|| {
        format!(
            "the profile of {name} was made with another blendshape model, and may not fit this one: run `facewire \
             calibrate --wearer {name}`"
        )
    })
}

pub fn shaping(settings: &Settings) -> Shaping {
    let (smoothing, seconds) = (&settings.smoothing, |ms: u32| ms as f32 / 1000.0);
    let of_group = |group: Group| {
        let (kind, ms) = smoothing.of(group);
        group.filter(kind, seconds(ms))
    };
    let filters = Filters::new(of_group, smoothing.head, seconds(smoothing.head_ms));
    Shaping { rules: settings.plausibility, filters, adjustments: settings.adjust.clone() }
}

pub fn load_solver(settings: &Settings) -> Result<Solver, SetupError> {
    let mut solver = Solver::new(load_model(&settings.solver)?, Profile::default(), shaping(settings));
    solver.neutral_mode = settings.wearer.neutral;
    Ok(solver)
}
