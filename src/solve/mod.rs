//! From landmarks to blendshape coefficients: pure arithmetic, no clock, no I/O, no log.
//!
//! ```text
//! normalise -> Features::new -> Model::process -> Correction::process -> GatedAverage::process
//! ```
//!
//! Every stage refuses what the next could not use (not finite, not a face), so that such a frame is rejected whole.

mod affine;
mod canonical;
mod correction;
mod features;
mod model_error;
pub mod model_file;
mod neutral;
mod pose;
mod regression;
mod smoothing;
#[cfg(test)]
#[allow(clippy::indexing_slicing)]
mod test_face;

pub use affine::{DegenerateFace, Normalised, normalise};
pub use correction::{Corrected, Correction, CorrectionState, MAX_REST};
pub use facewire_packet::{BLENDSHAPE_COUNT as COEFFS, BLENDSHAPES};
pub use features::{FEATURES, FeatureId, Features, MEASURES};
pub use model_error::ModelError;
pub use neutral::{Neutral, NeutralError, NeutralMean};
pub use pose::{Camera, HeadPose};
pub use regression::{AbsurdResult, MAX_HIDDEN, MAX_INPUTS, Model, RawCoeffs};
pub use smoothing::{GateEdge, GatedAverage, GatedAverageState, MAX_WINDOW, Smoothed};
