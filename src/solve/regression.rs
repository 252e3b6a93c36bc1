//! `R`: the fitted regression from features to coefficients.
//!
//! A model holds one of two kinds of regression: the hidden layer that facewire ships, or one formula for each
//! blendshape as in the paper. Both serve faces with and without a known neutral face.
//!
//! Limits: `tongueOut` is always 0, because no landmark lies on the tongue.

mod formulas;
mod hidden_layer;

use thiserror::Error;

use super::{
    COEFFS,
    affine::Normalised,
    appearance::Residual,
    features::{Features, Reference, mix},
    model::{Model, Regression},
};

/// The shipped model, as the build script wrote it.
const EMBEDDED: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/blendshapes.bin"));
/// Largest result of a face. On rendered and real faces, results stay between -0.5 and 1.5.
const MAX_RESULT: f32 = 5.0;

/// A result that cannot be a coefficient. The frame is rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the blendshape model gave a value that no face has; leave solver.model empty for the built-in model")]
pub struct AbsurdResult;

/// Results of the regression, in the order of [`super::BLENDSHAPES`]: finite, not yet clamped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawCoeffs(pub [f32; COEFFS]);

impl RawCoeffs {
    /// Adds what the look of the face contributes.
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

    /// Computes the coefficients of a face, measured from `reference`. Does not allocate.
    ///
    /// # Errors
    /// As [`Self::process`].
    pub(super) fn solve(&self, face: &Normalised, reference: Reference) -> Result<RawCoeffs, AbsurdResult> {
        match (&self.regression, reference.ends()) {
            (Regression::Formulas(_), Some(ends)) => {
                let [unknown, known] = ends.map(|end| self.process(&Features::new(face, end)));
                Ok(RawCoeffs(mix(&unknown?.0, &known?.0, reference.known())))
            }
            _ => self.process(&Features::new(face, reference)),
        }
    }

    /// Computes the coefficients of a face from its features alone. Does not allocate.
    ///
    /// Formulas are for features of a neutral face that is either known or not: for a share in between, they take the
    /// nearer case.
    ///
    /// # Errors
    /// [`AbsurdResult`] if a result is not a number or far outside a coefficient's range.
    pub fn process(&self, features: &Features) -> Result<RawCoeffs, AbsurdResult> {
        let raw = match &self.regression {
            Regression::HiddenLayer(layer) => layer.process(features),
            Regression::Formulas(formulas) => formulas.process(features),
        };
        if are_sane(&raw) { Ok(RawCoeffs(raw)) } else { Err(AbsurdResult) }
    }
}

#[cfg(test)]
#[allow(clippy::expect_used, clippy::indexing_slicing)]
mod tests {
    use super::*;
    use crate::solve::{NeutralMean, model_file::ModelFile, normalise, test_face::face};

    #[test]
    fn embedded_numbers_are_those_of_the_readable_file_bit_for_bit() {
        let file = ModelFile::parse(include_str!("../../models/blendshapes.toml")).expect("the shipped model is sound");
        let read = file.to_model().expect("the shipped model is sound");
        assert_eq!(read.to_bytes().as_deref(), Some(EMBEDDED));
        assert_eq!(Model::embedded().to_bytes().as_deref(), Some(EMBEDDED));
        assert_eq!(Model::embedded(), read);
    }

    #[test]
    fn embedded_model_moves_smoothly_from_the_mean_of_many_people_to_the_neutral_face() {
        let model = Model::embedded();
        let face = normalise(&face([3.0, 0.0, 0.0], 80.0, [320.0, 240.0])).expect("a face");
        let mut mean = NeutralMean::default();
        mean.add(&face);
        let neutral = mean.finish().expect("one frame");
        let ends = [None, Some(&neutral)].map(|neutral| model.process(&Features::new(&face, neutral)).ok());
        // This face has few points, so that its values measured from the mean are absurd: only shares near 1 count.
        let at = |known| model.solve(&face, Reference::between(&neutral, known)).ok();
        assert_eq!([at(0.0), at(1.0)], ends);
        let near: Vec<RawCoeffs> = (980_u16..=1000).filter_map(|share| at(f32::from(share) / 1000.0)).collect();
        assert_eq!(near.len(), 21);
        let steps = near.windows(2).flat_map(|pair| pair[0].0.iter().zip(&pair[1].0).map(|(a, b)| (a - b).abs()));
        assert!(steps.clone().any(|step| step > 1e-4) && steps.fold(0.0, f32::max) < 0.05);
    }

    #[test]
    fn bytes_that_are_not_a_model_are_refused() {
        assert_eq!(Model::from_bytes(&EMBEDDED[..EMBEDDED.len() - 4]), None, "cut short");
        assert_eq!(Model::from_bytes(&EMBEDDED[4..]), None, "no length");
        assert_eq!(Model::from_bytes(&[]), None);
    }

    #[test]
    fn shipped_model_takes_at_most_1_mib() {
        assert!(Model::embedded().size_bytes() <= 1 << 20, "{}", Model::embedded().size_bytes());
    }
}
