use facewire_face::{InferError, SolveError};

/// What can go wrong. The message names the cause, and the remedy if one is known.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A network is missing or damaged, or failed to run.
    #[error("{0}")]
    Networks(String),
    /// A picture is too large, or its samples are not complete.
    #[error("{0}")]
    Picture(String),
    /// The blendshape model or the profile of a wearer cannot be read.
    #[error("{0}")]
    File(String),
    /// A value that no option has.
    #[error("{0}")]
    Option(&'static str),
    /// The shaping has filters, but all filters are off.
    #[error(
        "the settings configure filters in [smoothing], but {} switches all filters off",
        if *.stills { "for_stills()" } else { "smoothing(false)" }
    )]
    UnusedFilters {
        /// Whether they are off for stills, and not by [`Options::smoothing`](crate::Options::smoothing) alone.
        stills: bool,
    },
    /// A text of settings has a fault.
    #[error("{0}")]
    Settings(String),
    /// There is no such face, or the given ones are not those of one person.
    #[error("{0}")]
    Face(String),
    /// The given faces do not form a neutral face.
    #[error("{0}")]
    Neutral(#[from] SolveError),
}

impl From<InferError> for Error {
    fn from(error: InferError) -> Self {
        Self::Networks(error.to_string())
    }
}
