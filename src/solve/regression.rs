//! `R`: from features to coefficients, as the fitted model says.
//!
//! Two steps per blendshape, both linear in their weights (ordinary least squares with a little ridge):
//! 1. an estimate `l = w.f + b` from a few dozen selected features;
//! 2. a polynomial of degree 2 of all estimates, clipped to `0..=1`: `R = b' + sum v_ij c_i c_j`. It tells apart
//!    expressions that move the same points, and knows that no coefficient goes below zero.
//!
//! There are two maps, one for displacements from the wearer's neutral face, one for faces whose neutral is not known.
//! Limits: `tongueOut` is always 0, because no landmark lies on the tongue.

use std::path::Path;

use heapless::Vec;
use thiserror::Error;

use super::{
    COEFFS,
    features::{FeatureId, Features},
    model_error::ModelError,
    model_file::ModelFile,
};

/// Most features a blendshape may select (eq. 4).
pub(super) const MAX_SELECTED: usize = 96;
/// Most terms of a blendshape's polynomial.
pub(super) const MAX_TERMS: usize = 32;
/// Largest estimate of a face; on rendered and real ones they stay between -0.5 and 1.3.
const MAX_ESTIMATE: f32 = 5.0;

/// The model gave something that is no coefficient. The frame is rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("the blendshape model gave an absurd value; check the model file and the recorded neutral face")]
pub struct AbsurdResult;

/// Coefficients as the regression gives them, in the order of [`super::BLENDSHAPES`]: finite, not yet clamped.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RawCoeffs(pub [f32; COEFFS]);

/// The fitted maps. Fixed after loading; about 110 KiB.
#[derive(Debug, Clone, PartialEq)]
pub struct Model {
    pub(super) neutral_known: Map,
    pub(super) neutral_unknown: Map,
}

/// One entry for every blendshape.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Map(pub(super) Box<[Blendshape]>);

/// `l = bias + sum weight * feature`, then `R = sum weight * term`.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Blendshape {
    pub(super) bias: f32,
    pub(super) linear: Vec<(FeatureId, f32), MAX_SELECTED>,
    pub(super) polynomial: Vec<(Term, f32), MAX_TERMS>,
}

/// The product of two places in the clipped estimates, where place [`ONE`] holds 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Term(pub(super) u8, pub(super) u8);

/// The place after the estimates, which holds 1.
#[expect(clippy::cast_possible_truncation, reason = "52")]
pub(super) const ONE: u8 = COEFFS as u8;

/// Estimates clipped to `0..=1`, then 1.
pub(super) type Clipped = [f32; COEFFS + 1];

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

    /// The coefficients of a face. Takes the map that fits the features: neutral face known or not.
    ///
    /// # Errors
    /// [`AbsurdResult`] if a result is no number or far outside a coefficient's range.
    pub fn process(&self, features: &Features) -> Result<RawCoeffs, AbsurdResult> {
        let map = if features.neutral_known { &self.neutral_known } else { &self.neutral_unknown };
        let clipped = map.clipped_estimates(features)?;
        let mut raw = [0.0; COEFFS];
        raw.iter_mut().zip(&map.0).for_each(|(out, blendshape)| *out = blendshape.polynomial(&clipped));
        if raw.iter().all(|value| value.is_finite()) { Ok(RawCoeffs(raw)) } else { Err(AbsurdResult) }
    }

    /// Bytes of the model in memory.
    #[must_use]
    pub fn size_bytes(&self) -> usize {
        size_of_val(&*self.neutral_known.0) + size_of_val(&*self.neutral_unknown.0) + size_of::<Self>()
    }
}

impl Map {
    fn clipped_estimates(&self, features: &Features) -> Result<Clipped, AbsurdResult> {
        let mut clipped = [1.0; COEFFS + 1];
        for (out, blendshape) in clipped.iter_mut().zip(&self.0) {
            let estimate = blendshape.estimate(features);
            if estimate.is_nan() || estimate.abs() > MAX_ESTIMATE {
                return Err(AbsurdResult);
            }
            *out = estimate.clamp(0.0, 1.0);
        }
        Ok(clipped)
    }
}

impl Blendshape {
    fn estimate(&self, features: &Features) -> f32 {
        let value = |id: FeatureId| features.values.get(id.index()).copied().unwrap_or(f32::NAN);
        self.bias + self.linear.iter().map(|(id, weight)| weight * value(*id)).sum::<f32>()
    }

    fn polynomial(&self, clipped: &Clipped) -> f32 {
        let value = |place: u8| clipped.get(usize::from(place)).copied().unwrap_or(f32::NAN);
        self.polynomial.iter().map(|(Term(a, b), weight)| weight * value(*a) * value(*b)).sum()
    }
}

#[cfg(test)]
#[allow(clippy::expect_used, clippy::indexing_slicing)]
mod tests {
    use super::*;
    use crate::solve::{normalise, test_face::face};

    const JAW_OPEN: usize = 17;
    const FUNNEL: usize = 19;
    const TONGUE_OUT: usize = 51;

    fn blendshape(bias: f32, terms: &[(Term, f32)]) -> Blendshape {
        Blendshape { bias, linear: Vec::new(), polynomial: terms.iter().copied().collect() }
    }

    /// A model whose two maps hold `entry` at `index` and nothing elsewhere but a funnel of 0.5.
    fn model(index: usize, entry: &Blendshape) -> Model {
        let mut map = Map(vec![Blendshape::default(); COEFFS].into());
        map.0[FUNNEL] = blendshape(0.5, &[]);
        map.0[index] = entry.clone();
        Model { neutral_known: map.clone(), neutral_unknown: map }
    }

    fn features() -> Features {
        Features::new(&normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).expect("a face"), None)
    }

    #[test]
    fn result_is_the_polynomial_of_clipped_estimates() {
        let terms = [(Term(ONE, ONE), 0.1), (Term(17, ONE), 0.2), (Term(17, 19), 0.4)];
        let raw = model(JAW_OPEN, &blendshape(3.0, &terms)).process(&features()).expect("finite");
        assert!((raw.0[JAW_OPEN] - (0.1 + 0.2 + 0.4 * 0.5)).abs() < 1e-6, "the estimate of 3 counts as 1");
    }

    #[test]
    fn estimate_adds_weighted_features() {
        let id = FeatureId::from_name("x263").expect("known");
        let mut entry = blendshape(0.0, &[(Term(17, ONE), 1.0)]);
        entry.linear.push((id, 0.5)).expect("room");
        let raw = model(JAW_OPEN, &entry).process(&features()).expect("finite");
        assert!((raw.0[JAW_OPEN] - 0.5 * 0.7218).abs() < 1e-3);
    }

    #[test]
    fn absurd_and_missing_numbers_reject_the_frame() {
        for wrong in [f32::NAN, f32::INFINITY, -7.0] {
            assert_eq!(model(JAW_OPEN, &blendshape(wrong, &[])).process(&features()), Err(AbsurdResult));
        }
        let model = model(JAW_OPEN, &blendshape(0.0, &[(Term(ONE, ONE), f32::NAN)]));
        assert_eq!(model.process(&features()), Err(AbsurdResult));
    }

    #[test]
    fn shipped_model_is_small_and_leaves_the_tongue_in() {
        let model = Model::embedded().expect("the shipped model loads");
        assert!(model.size_bytes() <= 256 * 1024);
        for map in [&model.neutral_known, &model.neutral_unknown] {
            assert_eq!(map.0.len(), COEFFS);
            assert_eq!(map.0[TONGUE_OUT], Blendshape::default());
        }
    }
}
