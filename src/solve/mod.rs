//! From landmarks to blendshape coefficients: pure arithmetic without a clock, a log or, but for loading a model, I/O.
//!
//! ```text
//! normalise -> Model::solve -> RawCoeffs::plus -> correct -> Filters::step
//!                             AppearanceLayer::process --^
//! ```
//!
//! [`Solver`] runs these stages. A stage that gets values it cannot use, such as landmarks that are not finite or do
//! not form a face, returns an error, and the whole frame is rejected.

mod affine;
mod appearance;
mod canonical;
mod correction;
mod feature_id;
mod features;
mod filter;
mod gated_average;
mod model;
mod model_error;
pub mod model_file;
mod neutral;
mod pose;
mod profile;
mod regression;
mod solver;
#[cfg(test)]
#[allow(clippy::indexing_slicing)]
pub(crate) mod test_face;

use crate::face::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS, LANDMARKS};

pub use affine::{DegenerateFace, Normalised, normalise};
pub use appearance::{Residual, ResidualState};
pub use correction::{Corrected, GAINS, MAX_REST, correct};
pub use facewire_packet::{BLENDSHAPE_COUNT as COEFFS, BLENDSHAPES};
pub use feature_id::{FEATURES, FeatureId, MEASURES};
pub use features::{Features, Reference};
pub use filter::{Filter, FilterState, Filters, FiltersState, Smoothed};
pub use gated_average::GatedAverage;
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
pub use pose::{Camera, HeadPose};
pub use profile::Profile;
pub use regression::{AbsurdResult, RawCoeffs};
pub use solver::{Solution, SolveError, Solver};
