//! What is known of the wearer. It outlives changes of camera, model and filters.

use super::{COEFFS, neutral::Neutral};

/// What is known of the wearer. The default is a wearer of whom nothing is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// The neutral face, from which displacements are measured; `None` measures from the mean of many people.
    pub neutral: Option<Neutral>,
    /// The output of the regression, plus the model's shift, for the face at rest, per blendshape in the order of
    /// [`super::BLENDSHAPES`]; 0 where unknown.
    pub rest: [f32; COEFFS],
    /// The factor that brings the wearer's full expression to the full range, in the same order; 1 where unknown.
    pub gain: [f32; COEFFS],
}

impl Default for Profile {
    fn default() -> Self {
        Self { neutral: None, rest: [0.0; COEFFS], gain: [1.0; COEFFS] }
    }
}
