//! From landmarks to blendshape coefficients: pure arithmetic without a clock, a log or, but for loading a model, I/O.
//!
//! ```text
//! normalise -> Model::solve ----> Coefficients::plus -> correct -> Rules::step -> Filters::step -> ...
//!              Model::residual ---^
//!     ... -> Rules::close_mouth -> Adjustments::apply -> Crossfade::step -> Adjustments::limit
//! ```
//!
//! [`Solver`] runs these stages. A stage that gets values it cannot use, such as landmarks that are not finite or do
//! not form a face, returns an error, and the whole frame is rejected.

pub(crate) mod affine;
mod correction;
mod features;
mod filter;
mod formulas;
mod gaze;
mod halves;
pub(crate) mod identity;
mod neutral_estimate;
mod output;
mod plausible;
mod pose;
mod regression;
mod smoothing;
mod solver;
mod turned;
mod usual;
mod view;

use crate::model::Model;
use crate::track::LANDMARKS;

pub use affine::{FaceMean, Normalised, normalise};
pub use correction::{GAINS, MAX_REST, correct};
pub(crate) use facewire_packet::{BLENDSHAPE_COUNT as COEFFS, BLENDSHAPES};
pub use features::{Features, Neutral, Reference};
pub use filter::{Filter, FilterKind};
pub use gaze::Gaze;
pub use neutral_estimate::NeutralMode;
pub use output::{Adjustment, Adjustments, MIRRORED};
pub use plausible::Rules;
pub use pose::{Camera, HeadPose, mirror_image};
pub use regression::Method;
pub use smoothing::{Filters, FiltersState, Group};
pub use solver::{Profile, Shaping, Solution, SolveError, Solver, Wears};
pub use view::keep_in_view;

/// One number for each blendshape, in the order of [`BLENDSHAPES`]. Results of the regression are finite; after the
/// correction they are within `0..=1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coefficients(pub [f32; COEFFS]);

impl Coefficients {
    /// Adds what the look of the face contributes.
    pub fn plus(mut self, residual: &Self) -> Self {
        self.0.iter_mut().zip(&residual.0).for_each(|(value, residual)| *value += residual);
        self
    }
}
