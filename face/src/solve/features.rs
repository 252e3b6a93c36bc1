//! `S` and `T_d` (eq. 4, 5): the features of a face that the regression reads, and what they are measured from.
//!
//! The selection (eq. 4) is the model's list of indices into [`Features`]: the matrix D of the paper would hold almost
//! nothing but zeros.

use super::affine::{MAX_COORDINATE, MAX_MISFIT, RIGID};
use super::halves::{HALF_OF_MEASURE, Half, Halves};
use super::{LANDMARKS, Normalised, SolveError};
use crate::model::{COORDINATES, DISTANCES, FEATURES, FeatureId, MEASURES};

/// The neutral face of a wearer: the mean normalised face at rest.
#[derive(Debug, Clone, PartialEq)]
pub struct Neutral {
    pub(super) measures: Box<[f32; MEASURES]>,
}

impl Neutral {
    /// Measures a face whose points are in the basis of [`Normalised::points`]. A coordinate that no face has is
    /// [`SolveError::NoMean`].
    pub fn from_points(points: &[[f32; 3]; LANDMARKS]) -> Result<Self, SolveError> {
        if !points.iter().flatten().all(|value| value.abs() < MAX_COORDINATE) {
            return Err(SolveError::NoMean);
        }
        Ok(Self { measures: Box::new(measure(points)) })
    }

    /// Like [`Neutral::from_points`], for points whose source is not trusted: they must form a normalised face.
    pub fn of_face(points: &[[f32; 3]; LANDMARKS]) -> Result<Self, SolveError> {
        let squared = |(index, canonical): &(usize, [f64; 3])| {
            let point = points.get(*index).copied().unwrap_or_default();
            point.iter().zip(canonical).map(|(seen, want)| (f64::from(*seen) - want).powi(2)).sum::<f64>()
        };
        let misfit = RIGID.iter().map(squared).sum::<f64>() / RIGID.len() as f64;
        if misfit.sqrt() <= MAX_MISFIT { Self::from_points(points) } else { Err(SolveError::NoMean) }
    }

    /// The points of the face, in the basis of [`Normalised::points`].
    pub fn points(&self) -> impl Iterator<Item = [f32; 3]> {
        self.measures.as_chunks().0.iter().take(LANDMARKS).copied()
    }
}

/// What displacements are measured from: `mean + known * (neutral - mean)`, with the model's mean of many people.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reference<'a> {
    pub(super) neutral: Option<&'a Neutral>,
    /// How far each half is known. The upper half may be known further than the lower one, but not the other way round.
    pub(super) known: Halves<f32>,
}

impl<'a> Reference<'a> {
    /// The mean of many people.
    pub const MEAN: Self = Self { neutral: None, known: Halves { upper: 0.0, lower: 0.0 } };

    /// A face that is the wearer's neutral face by a share of `known`, from 0 to 1. A share of 0 is [`Self::MEAN`].
    pub fn between(neutral: &'a Neutral, known: f32) -> Self {
        if known > 0.0 { Self { neutral: Some(neutral), known: Halves::both(known.min(1.0)) } } else { Self::MEAN }
    }

    /// The same neutral face, both halves of which are known as far as the lower one.
    pub(super) fn of_lower_half(self) -> Self {
        self.neutral.map_or(Self::MEAN, |neutral| Self::between(neutral, self.known.lower))
    }
}

/// The neutral face if there is one, else the mean of many people.
impl<'a> From<Option<&'a Neutral>> for Reference<'a> {
    fn from(neutral: Option<&'a Neutral>) -> Self {
        neutral.map_or(Self::MEAN, |neutral| Self::between(neutral, 1.0))
    }
}

/// All features of one face, in the order of [`FeatureId`].
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    pub(super) values: [f32; FEATURES],
    /// How far each half of the wearer's neutral face is known, as in [`Reference`].
    pub(super) known: Halves<f32>,
}

impl Features {
    /// The measures of a face minus those of the wearer's neutral face. The model subtracts the remaining share of the mean.
    pub fn new<'a>(face: &Normalised, reference: impl Into<Reference<'a>>) -> Self {
        Self::from_mean(face).measured_from(reference.into())
    }

    /// The features of a face whose neutral face is not known.
    pub(super) fn from_mean(face: &Normalised) -> Self {
        // They are written where they stay: copying all measures would take longer than measuring.
        let mut features = Self { values: [0.0; FEATURES], known: Reference::MEAN.known };
        let (measures, turns) = features.values.split_at_mut(MEASURES);
        write_measures(&face.points, measures);
        // The direction of the face in the picture (right, up), and how much higher its left side is than its right.
        let [yaw, pitch] = face.turns();
        turns.copy_from_slice(&[yaw, pitch, face.rotation.m21]);
        features
    }

    /// These features of [`Self::from_mean`], measured from another reference.
    pub(super) fn measured_from(mut self, Reference { neutral, known }: Reference) -> Self {
        if let Some(neutral) = neutral {
            for ((value, rest), half) in self.values.iter_mut().zip(neutral.measures.iter()).zip(&HALF_OF_MEASURE) {
                *value -= known.of(*half) * rest;
            }
        }
        self.known = known;
        self
    }

    /// The measures of a face that looks straight ahead, measured from the mean of many people.
    pub(super) fn at_rest(measures: &[f32; MEASURES]) -> Self {
        let mut values = [0.0; FEATURES];
        values.iter_mut().zip(measures).for_each(|(slot, value)| *slot = *value);
        Self { values, known: Halves::default() }
    }

    /// What is still to be subtracted from these features: a share of the mean of many people alone.
    pub(super) fn remaining(&self) -> Reference<'static> {
        Reference { neutral: None, known: self.known }
    }

    /// The feature minus what is still to be subtracted of the neutral face and of the feature's mean over neutral faces.
    pub(super) fn displacement(&self, id: FeatureId, neutral_mean: f32, reference: Reference) -> f32 {
        let index = id.index();
        let known = reference.known.of(HALF_OF_MEASURE.get(index).copied().unwrap_or(Half::Lower));
        let rest = reference.neutral.and_then(|neutral| neutral.measures.get(index)).copied().unwrap_or(0.0);
        self.get(id) - known * rest - (1.0 - known) * neutral_mean
    }

    pub(super) fn get(&self, id: FeatureId) -> f32 {
        self.values.get(id.index()).copied().unwrap_or(f32::NAN)
    }

    /// All values, in the order of [`FeatureId`].
    pub fn values(&self) -> &[f32; FEATURES] {
        &self.values
    }
}

pub(super) fn measure(points: &[[f32; 3]; LANDMARKS]) -> [f32; MEASURES] {
    let mut values = [0.0; MEASURES];
    write_measures(points, &mut values);
    values
}

/// Writes the [`MEASURES`] of a face.
fn write_measures(points: &[[f32; 3]; LANDMARKS], measures: &mut [f32]) {
    let (coordinates, distances) = measures.split_at_mut(COORDINATES);
    coordinates.copy_from_slice(points.as_flattened());
    for (value, (a, b)) in distances.iter_mut().zip(DISTANCES) {
        if let (Some(a), Some(b)) = (points.get(a), points.get(b)) {
            *value = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt();
        }
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)]
mod tests {
    use super::*;
    use crate::solve::normalise;
    use crate::testing::face;

    #[test]
    fn known_share_of_the_neutral_face_is_subtracted() {
        let face = normalise(&face([5.0, 0.0, 0.0], 80.0, [320.0, 240.0])).expect("a face");
        let neutral = Neutral::from_points(&face.points).expect("a neutral face");
        let at = |known| *Features::new(&face, Reference::between(&neutral, known)).values();
        assert_eq!(at(0.0), *Features::new(&face, None).values());
        assert_eq!(at(1.0), *Features::new(&face, Some(&neutral)).values());
        assert!(at(1.0)[..MEASURES].iter().all(|value| value.abs() < 1e-6), "the neutral face has no displacement");
        assert_eq!((at(f32::NAN), at(7.0)), (at(0.0), at(1.0)));
        let none = at(0.0);
        let quarter = at(0.25);
        assert!(none[..MEASURES].iter().zip(&quarter).all(|(none, quarter)| (0.75 * none - quarter).abs() < 1e-6));
        assert_eq!(none[MEASURES..], quarter[MEASURES..], "turns of the head do not depend on the neutral face");
    }

    #[test]
    fn turn_of_the_head_is_about_its_sine_and_an_opened_mouth_lengthens_its_distance() {
        let id = |name| FeatureId::from_name(name).expect("known");
        for (axis, name) in ["yaw", "pitch", "roll"].into_iter().enumerate() {
            let mut angles = [0.0_f32; 3];
            angles[axis] = 20.0;
            let face = normalise(&face(angles, 80.0, [320.0, 240.0])).expect("a face");
            let value = Features::new(&face, None).get(id(name));
            assert!((value - 20.0_f32.to_radians().sin()).abs() < 0.01, "{name}: {value}");
        }
        let mut points = [[0.0; 3]; LANDMARKS];
        points[14] = [0.0, -0.3, -0.4];
        assert!((measure(&points)[id("d13-14").index()] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn coordinate_that_no_face_has_is_refused() {
        for value in [f32::NAN, f32::INFINITY, 1e6] {
            assert_eq!(Neutral::from_points(&[[0.0, value, 0.0]; LANDMARKS]), Err(SolveError::NoMean));
        }
    }
}
