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
    blendshapes::COEFFS,
    features::{FeatureId, Features},
    model_file::{ModelError, ModelFile},
};

/// Most features a blendshape may select (eq. 4).
pub(super) const MAX_SELECTED: usize = 96;
/// Most terms of a blendshape's polynomial.
pub(super) const MAX_TERMS: usize = 32;
/// Largest result that is still taken for a coefficient; on real faces they stay between -1 and 2.
const MAX_RESULT: f32 = 10.0;

/// The model gave something that is no coefficient. The frame is rejected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error(
    "the blendshape model gave an absurd value; check the model file and the recorded neutral face"
)]
pub struct NotFinite;

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
        let text = std::fs::read_to_string(path).map_err(|source| ModelError::Unreadable {
            path: path.to_owned(),
            source,
        })?;
        ModelFile::parse(&text)?.to_model()
    }

    /// The coefficients of a face. Takes the map that fits the features: neutral face known or not.
    ///
    /// # Errors
    /// [`NotFinite`] if a result is no number or far outside a coefficient's range.
    pub fn process(&self, features: &Features) -> Result<RawCoeffs, NotFinite> {
        let map = if features.neutral_known {
            &self.neutral_known
        } else {
            &self.neutral_unknown
        };
        let clipped = map.clipped_estimates(features);
        let mut raw = [0.0; COEFFS];
        raw.iter_mut()
            .zip(&map.0)
            .for_each(|(out, blendshape)| *out = blendshape.polynomial(&clipped));
        if raw.iter().all(|value| value.abs() < MAX_RESULT) {
            Ok(RawCoeffs(raw))
        } else {
            Err(NotFinite)
        }
    }

    /// Bytes of the model in memory.
    #[must_use]
    pub fn size_bytes(&self) -> usize {
        size_of_val(&*self.neutral_known.0)
            + size_of_val(&*self.neutral_unknown.0)
            + size_of::<Self>()
    }
}

impl Map {
    fn clipped_estimates(&self, features: &Features) -> Clipped {
        let mut clipped = [1.0; COEFFS + 1];
        clipped
            .iter_mut()
            .zip(&self.0)
            .for_each(|(out, blendshape)| *out = blendshape.estimate(features).clamp(0.0, 1.0));
        clipped
    }
}

impl Blendshape {
    fn estimate(&self, features: &Features) -> f32 {
        let value = |id: FeatureId| features.values.get(id.index()).copied().unwrap_or(f32::NAN);
        self.bias
            + self
                .linear
                .iter()
                .map(|(id, weight)| weight * value(*id))
                .sum::<f32>()
    }

    fn polynomial(&self, clipped: &Clipped) -> f32 {
        let value = |place: u8| clipped.get(usize::from(place)).copied().unwrap_or(f32::NAN);
        self.polynomial
            .iter()
            .map(|(Term(a, b), weight)| weight * value(*a) * value(*b))
            .sum()
    }
}
