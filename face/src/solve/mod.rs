//! From landmarks to blendshape coefficients: pure arithmetic without a clock, a log or, but for loading a model, I/O.
//!
//! ```text
//! normalise -> Model::solve ----> RawCoeffs::plus -> correct -> Rules::step -> Filters::step -> ...
//!              Model::residual ---^
//!     ... -> Rules::close_mouth -> Adjustments::apply -> Crossfade::step -> Adjustments::limit
//! ```
//!
//! [`Solver`] runs these stages. A stage that gets values it cannot use, such as landmarks that are not finite or do
//! not form a face, returns an error, and the whole frame is rejected.

mod adjustments;
mod affine;
mod appearance;
mod canonical;
mod correction;
mod crossfade;
mod features;
mod filter;
mod formulas;
mod head_filter;
mod neutral;
mod neutral_estimate;
mod noise_level;
mod plausible;
mod pose;
mod regression;
mod smoothing;
mod solver;

use crate::model::Model;
use crate::track::LANDMARKS;

#[cfg(any(test, feature = "testing"))]
pub(crate) use canonical::RIGID;

pub use adjustments::{Adjustment, Adjustments, MIRRORED};
pub use affine::{FaceMean, Normalised, normalise};
pub use appearance::Residual;
pub use correction::{Corrected, GAINS, MAX_REST, correct};
pub(crate) use facewire_packet::{BLENDSHAPE_COUNT as COEFFS, BLENDSHAPES};
pub use features::{Features, Reference};
pub use filter::{Filter, FilterKind};
pub use head_filter::HeadFilter;
pub use neutral::{Neutral, NeutralMean};
pub use neutral_estimate::NeutralMode;
pub use plausible::Rules;
pub use pose::{Camera, HeadPose, mirror_image, yaw_pitch_roll_deg};
pub use regression::RawCoeffs;
pub use smoothing::{Filters, FiltersState, Group, Smoothed};
pub use solver::{Profile, Shaping, Solution, SolveError, Solver};
