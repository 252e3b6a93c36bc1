//! `R`: from features to coefficients, as the fitted model says.
//!
//! One hidden layer, shared by all blendshapes and by faces whose neutral is known or not:
//! `h = max(0, W x + a)`, then `R = V h + b`, where `x` are the selected features. Where the wearer's neutral face is not
//! known, displacements are measured from the mean of many neutral faces, and `a` is another. What the hidden layer adds
//! to an affine map is that expressions which move the same points are told apart by all the others.
//!
//! Limits: `tongueOut` is always 0, because no landmark lies on the tongue.

use std::path::Path;

use thiserror::Error;

use super::{
    COEFFS,
    features::{FeatureId, Features},
    model_error::ModelError,
    model_file::ModelFile,
};

/// Most units of the hidden layer.
pub const MAX_HIDDEN: usize = 120;
/// Most features that are selected (eq. 4): with [`MAX_HIDDEN`] they make a model of 256 KiB.
pub const MAX_INPUTS: usize = 470;
/// Largest result of a face; on rendered and real ones they stay between -0.5 and 1.5.
const MAX_RESULT: f32 = 5.0;

/// The model gave something that is no coefficient. The frame is rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the blendshape model gave a value that no face has; leave solver.model empty for the built-in model")]
pub struct AbsurdResult;

/// Coefficients as the regression gives them, in the order of [`super::BLENDSHAPES`]: finite, not yet clamped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawCoeffs(pub [f32; COEFFS]);

/// One number for each hidden unit; those that a model does not use are 0.
pub(super) type Hidden = [f32; MAX_HIDDEN];

/// The fitted map. Fixed after loading; at most 256 KiB.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    pub(super) inputs: Box<[Input]>,
    /// `a` where the neutral face is known, and where it is not.
    pub(super) offsets: [Hidden; 2],
    pub(super) outputs: Box<[Output]>,
}

/// A selected feature: its column of `W`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Input {
    pub(super) feature: FeatureId,
    /// Its mean over neutral faces.
    pub(super) neutral: f32,
    pub(super) weights: Hidden,
}

/// A blendshape: its row of `V`, and of `b`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Output {
    pub(super) offset: f32,
    pub(super) weights: Hidden,
}

impl Output {
    /// Always 0.
    pub(super) const NOTHING: Self = Self { offset: 0.0, weights: [0.0; MAX_HIDDEN] };
}

impl Model {
    /// The model this program was shipped with.
    ///
    /// # Errors
    /// [`ModelError`] if it is damaged; a test keeps that from happening.
    pub fn embedded() -> Result<Self, ModelError> {
        ModelFile::parse(include_str!("../../models/blendshapes.toml"))?.to_model()
    }

    /// A model from a file.
    ///
    /// # Errors
    /// [`ModelError`] if the file is missing, damaged, of another version or holds numbers that are not finite.
    pub fn load(path: &Path) -> Result<Self, ModelError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| ModelError::Unreadable { path: path.to_owned(), source })?;
        ModelFile::parse(&text)?.to_model()
    }

    /// The coefficients of a face.
    ///
    /// # Errors
    /// [`AbsurdResult`] if a result is no number or far outside a coefficient's range.
    pub fn process(&self, features: &Features) -> Result<RawCoeffs, AbsurdResult> {
        let hidden = self.hidden(features);
        let mut raw = [0.0; COEFFS];
        raw.iter_mut().zip(&self.outputs).for_each(|(out, output)| *out = output.apply(&hidden));
        // A NaN is in no range.
        let is_sane = raw.iter().all(|value| (-MAX_RESULT..=MAX_RESULT).contains(value));
        if is_sane { Ok(RawCoeffs(raw)) } else { Err(AbsurdResult) }
    }

    fn hidden(&self, features: &Features) -> Hidden {
        let [known, unknown] = &self.offsets;
        let mut hidden = if features.neutral_known { *known } else { *unknown };
        for input in &self.inputs {
            let reference = if features.neutral_known { 0.0 } else { input.neutral };
            let value = features.get(input.feature) - reference;
            hidden.iter_mut().zip(&input.weights).for_each(|(sum, weight)| *sum += weight * value);
        }
        // Not `max`, which would make 0 of a NaN.
        hidden.map(|sum| if sum < 0.0 { 0.0 } else { sum })
    }

    /// Bytes of the model in memory.
    #[must_use]
    pub fn size_bytes(&self) -> usize {
        size_of_val(&*self.inputs) + size_of_val(&*self.outputs) + size_of::<Self>()
    }
}

impl Output {
    /// `V h + b` of one blendshape. Eight sums, so that the compiler may take them side by side.
    fn apply(&self, hidden: &Hidden) -> f32 {
        let (hidden, weights) = (hidden.as_chunks::<8>().0, self.weights.as_chunks::<8>().0);
        let mut sums = [0.0; 8];
        for (hidden, weights) in hidden.iter().zip(weights) {
            sums.iter_mut().zip(hidden.iter().zip(weights)).for_each(|(sum, (value, weight))| *sum += value * weight);
        }
        self.offset + sums.iter().sum::<f32>()
    }
}

#[cfg(test)]
#[allow(clippy::expect_used, clippy::indexing_slicing)]
mod tests {
    use super::*;
    use crate::solve::{normalise, test_face::face};

    const JAW_OPEN: usize = 17;
    const TONGUE_OUT: usize = 51;

    /// Two hidden units, `x - 0.5` and `0.5 - x` of the outer corner of the left eye, which `JAW_OPEN` weighs by 2
    /// and 3.
    fn model() -> Model {
        let row = |a: f32, b: f32| {
            let mut row = [0.0; MAX_HIDDEN];
            (row[0], row[MAX_HIDDEN - 1]) = (a, b);
            row
        };
        let feature = FeatureId::from_name("x263").expect("known");
        let mut outputs = vec![Output::NOTHING; COEFFS];
        outputs[JAW_OPEN] = Output { offset: 0.1, weights: row(2.0, 3.0) };
        Model {
            inputs: Box::new([Input { feature, neutral: 0.2, weights: row(1.0, -1.0) }]),
            offsets: [[0.0; MAX_HIDDEN], row(-0.5, 0.5)],
            outputs: outputs.into(),
        }
    }

    fn features() -> Features {
        Features::new(&normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).expect("a face"), None)
    }

    #[test]
    fn result_is_a_weighted_sum_of_what_is_positive_of_the_hidden_layer() {
        let raw = model().process(&features()).expect("finite");
        let x = 0.7218 - 0.2;
        assert!((raw.0[JAW_OPEN] - (0.1 + 2.0 * (x - 0.5))).abs() < 1e-3, "{}", raw.0[JAW_OPEN]);
        assert!(raw.0.iter().enumerate().all(|(index, value)| index == JAW_OPEN || *value == 0.0));
    }

    #[test]
    fn absurd_and_missing_numbers_reject_the_frame() {
        for wrong in [f32::NAN, f32::INFINITY, -7.0] {
            let mut model = model();
            model.outputs[JAW_OPEN].offset = wrong;
            assert_eq!(model.process(&features()), Err(AbsurdResult));
        }
        let mut model = model();
        model.offsets[1][0] = f32::NAN;
        assert_eq!(model.process(&features()), Err(AbsurdResult));
    }

    #[test]
    fn shipped_model_is_small_and_leaves_the_tongue_in() {
        let model = Model::embedded().expect("the shipped model loads");
        assert!(model.size_bytes() <= 256 * 1024, "{}", model.size_bytes());
        assert_eq!(model.outputs.len(), COEFFS);
        assert_eq!(model.outputs[TONGUE_OUT], Output::NOTHING);
    }

    #[test]
    fn the_largest_model_takes_256_kib() {
        let largest = MAX_INPUTS * size_of::<Input>() + COEFFS * size_of::<Output>() + size_of::<Model>();
        assert!(largest <= 256 * 1024, "{largest}");
    }
}
