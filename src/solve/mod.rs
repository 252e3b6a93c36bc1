//! From landmarks to blendshape coefficients: pure arithmetic without a clock, a log or, but for loading a model, I/O.
//!
//! ```text
//! normalise -> Model::solve ----> RawCoeffs::plus -> correct -> Rules::step -> Filters::step -> ...
//!              Model::residual ---^
//!     ... -> Rules::close_mouth -> Adjustments::apply -> Bridge::step -> Adjustments::limit
//! ```
//!
//! [`Solver`] runs these stages. A stage that gets values it cannot use, such as landmarks that are not finite or do
//! not form a face, returns an error, and the whole frame is rejected.

mod adjustments;
mod affine;
mod appearance;
mod bridge;
mod canonical;
mod correction;
mod face_mean;
mod feature_id;
mod features;
mod filter;
mod head_filter;
mod model;
mod model_error;
pub mod model_file;
mod neutral;
mod neutral_estimate;
mod noise_level;
mod plausible;
mod pose;
mod profile;
mod regression;
mod smoothing;
mod smoothstep;
mod solver;
#[cfg(test)]
#[allow(clippy::indexing_slicing)]
pub(crate) mod test_face;

use crate::face::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS, LANDMARKS};

pub use adjustments::{Adjustment, Adjustments, MIRRORED};
pub use affine::{DegenerateFace, Normalised, normalise};
pub use appearance::Residual;
pub use correction::{Corrected, GAINS, MAX_REST, correct};
pub use face_mean::FaceMean;
pub use facewire_packet::{BLENDSHAPE_COUNT as COEFFS, BLENDSHAPES};
pub use feature_id::{FEATURES, FeatureId, MEASURES};
pub use features::{Features, Reference};
pub use filter::{Filter, FilterKind, FilterState, LONGEST_STEP_S};
pub use head_filter::{HeadFilter, HeadState};
pub use model::{
    Model,
    appearance::{APPEARANCE_UNITS, AppearanceLayer},
    correction::{Correction, CorrectiveTerms},
    formulas::{
        FormulaKind, LIFT, MAX_EXPONENT, MAX_FORMULA_INPUTS, MAX_MULTIPLIED, Response, product_index, signed_logarithm,
    },
    hidden_layer::{MAX_HIDDEN, MAX_INPUTS},
};
pub use model_error::ModelError;
pub use neutral::{Neutral, NeutralError, NeutralMean};
pub use neutral_estimate::NeutralMode;
pub use plausible::{GazeState, Rules};
pub use pose::{Camera, HeadPose, mirror_image, yaw_pitch_roll_deg};
pub use profile::Profile;
pub use regression::{AbsurdResult, RawCoeffs};
pub use smoothing::{Filters, FiltersState, Group, Smoothed};
pub use solver::{Shaping, Solution, SolveError, Solver};
