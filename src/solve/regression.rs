//! `R`: the fitted regression from features to coefficients.
//!
//! A network with one hidden layer, `h = max(0, W x + a)` and `R = V h + b`, where `x` are the selected features. All
//! blendshapes share the hidden layer. It serves faces with and without a known neutral face: without one,
//! displacements are measured from the mean of many neutral faces, and `a` differs. Against an affine map, the hidden
//! layer tells apart expressions that move the same points.
//!
//! Limits: `tongueOut` is always 0, because no landmark lies on the tongue.

use facewire_engine::kernels::rows::add_rows;
use thiserror::Error;

use super::{
    COEFFS,
    appearance::Residual,
    features::Features,
    model::{Hidden, Model},
};

/// The shipped model, as the build script wrote it.
const EMBEDDED: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/blendshapes.bin"));
/// Largest result of a face. On rendered and real faces, results stay between -0.5 and 1.5.
const MAX_RESULT: f32 = 5.0;
/// Number of inputs whose values are gathered before their weighted columns are added.
const BATCH: usize = 64;

/// A result that cannot be a coefficient. The frame is rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the blendshape model gave a value that no face has; leave solver.model empty for the built-in model")]
pub struct AbsurdResult;

/// Results of the regression, in the order of [`super::BLENDSHAPES`]: finite, not yet clamped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawCoeffs(pub [f32; COEFFS]);

impl RawCoeffs {
    /// Adds what the look of the face tells.
    #[must_use]
    pub fn plus(mut self, residual: &Residual) -> Self {
        self.0.iter_mut().zip(&residual.0).for_each(|(value, residual)| *value += residual);
        self
    }
}

/// Whether all results can be those of a face. No range contains a NaN.
pub(super) fn are_sane(results: &[f32; COEFFS]) -> bool {
    results.iter().all(|value| (-MAX_RESULT..=MAX_RESULT).contains(value))
}

impl Model {
    /// The model that is built into the program.
    ///
    /// # Panics
    /// Never: the build script has read these bytes back.
    #[must_use]
    #[expect(clippy::expect_used, reason = "see Panics")]
    pub fn embedded() -> Self {
        Self::from_bytes(EMBEDDED).expect("the embedded model is whole")
    }

    /// Computes the coefficients of a face from its features alone.
    ///
    /// # Errors
    /// [`AbsurdResult`] if a result is not a number or far outside a coefficient's range.
    pub fn process(&self, features: &Features) -> Result<RawCoeffs, AbsurdResult> {
        let hidden = self.hidden(features);
        let mut raw = self.output_offsets;
        add_rows(&mut raw, &self.output_weights, &hidden);
        if are_sane(&raw) { Ok(RawCoeffs(raw)) } else { Err(AbsurdResult) }
    }

    fn hidden(&self, features: &Features) -> Hidden {
        let [known, unknown] = &self.offsets;
        let mut hidden = if features.neutral_known { *known } else { *unknown };
        for (inputs, weights) in self.inputs.chunks(BATCH).zip(self.hidden_weights.chunks(BATCH)) {
            let mut values = [0.0; BATCH];
            for (value, input) in values.iter_mut().zip(inputs) {
                let reference = if features.neutral_known { 0.0 } else { input.neutral };
                *value = features.get(input.feature) - reference;
            }
            add_rows(&mut hidden, weights, &values);
        }
        // `f32::max` would turn a NaN into 0.
        hidden.map(|sum| if sum < 0.0 { 0.0 } else { sum })
    }
}

#[cfg(test)]
#[allow(clippy::expect_used, clippy::indexing_slicing)]
mod tests {
    use super::*;
    use crate::solve::{
        FeatureId, MAX_HIDDEN, MAX_INPUTS,
        model::{Input, Output},
        model_file::ModelFile,
        normalise,
        test_face::face,
    };

    const JAW_OPEN: usize = 17;
    const TONGUE_OUT: usize = 51;

    /// A model with two hidden units, `x - 0.5` and `0.5 - x`, where `x` is that of the outer corner of the left eye.
    /// `JAW_OPEN` weights them by 2 and 3.
    fn model() -> Model {
        let row = |a: f32, b: f32| {
            let mut row = [0.0; MAX_HIDDEN];
            (row[0], row[MAX_HIDDEN - 1]) = (a, b);
            row
        };
        let feature = FeatureId::from_name("x263").expect("known");
        let mut outputs = vec![Output { offset: 0.0, weights: [0.0; MAX_HIDDEN] }; COEFFS];
        outputs[JAW_OPEN] = Output { offset: 0.1, weights: row(2.0, 3.0) };
        let inputs = vec![(Input { feature, neutral: 0.2 }, row(1.0, -1.0))];
        Model::new(inputs, &[[0.0; MAX_HIDDEN], row(-0.5, 0.5)], &outputs)
    }

    fn features() -> Features {
        Features::new(&normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).expect("a face"), None)
    }

    #[test]
    fn result_is_the_weighted_sum_of_the_positive_hidden_units() {
        let raw = model().process(&features()).expect("finite");
        let x = 0.7218 - 0.2;
        assert!((raw.0[JAW_OPEN] - (0.1 + 2.0 * (x - 0.5))).abs() < 1e-3, "{}", raw.0[JAW_OPEN]);
        assert!(raw.0.iter().enumerate().all(|(index, value)| index == JAW_OPEN || *value == 0.0));
    }

    #[test]
    fn absurd_results_and_nans_reject_the_frame() {
        for wrong in [f32::NAN, f32::INFINITY, -7.0] {
            let mut model = model();
            model.output_offsets[JAW_OPEN] = wrong;
            assert_eq!(model.process(&features()), Err(AbsurdResult));
        }
        let mut model = model();
        model.offsets[1][0] = f32::NAN;
        assert_eq!(model.process(&features()), Err(AbsurdResult));
    }

    #[test]
    fn embedded_numbers_are_those_of_the_readable_file_bit_for_bit() {
        let file = ModelFile::parse(include_str!("../../models/blendshapes.toml")).expect("the shipped model is sound");
        let read = file.to_model().expect("the shipped model is sound");
        assert_eq!(read.to_bytes(), EMBEDDED);
        assert_eq!(Model::embedded().to_bytes(), EMBEDDED);
        assert_eq!(Model::embedded(), read);
    }

    #[test]
    fn bytes_that_are_not_a_model_are_refused() {
        assert_eq!(Model::from_bytes(&EMBEDDED[..EMBEDDED.len() - 4]), None, "cut short");
        assert_eq!(Model::from_bytes(&EMBEDDED[4..]), None, "no such feature");
        assert_eq!(Model::from_bytes(&[]), None);
    }

    #[test]
    fn shipped_model_is_small_and_never_puts_the_tongue_out() {
        let model = Model::embedded();
        assert!(model.size_bytes() <= 256 * 1024, "{}", model.size_bytes());
        let tongue = model.output_weights.iter().map(|weights| weights[TONGUE_OUT]);
        assert!(tongue.chain([model.output_offsets[TONGUE_OUT]]).all(|number| number == 0.0));
    }

    #[test]
    fn the_largest_model_takes_256_kib() {
        let feature = FeatureId::from_index(0).expect("known");
        let inputs = vec![(Input { feature, neutral: 0.0 }, [0.0; MAX_HIDDEN]); MAX_INPUTS];
        let largest = Model::new(inputs, &[[0.0; MAX_HIDDEN]; 2], &[]).size_bytes();
        assert!(largest <= 256 * 1024, "{largest}");
    }
}
