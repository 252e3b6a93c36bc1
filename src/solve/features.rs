//! `S` and `T_d` (eq. 4, 5): the features of a face that the regression reads.
//!
//! Where the wearer's neutral face is known, measures count as displacements from it. How far the head is turned does
//! not depend on the neutral face. The selection (eq. 4) is the model's list of indices into [`Features`]: the matrix D
//! of the paper would hold almost nothing but zeros.

use super::{
    LANDMARKS,
    affine::Normalised,
    feature_id::{COORDINATES, DISTANCES, FEATURES, FeatureId, MEASURES},
    neutral::Neutral,
};

/// All features of one face, in the order of [`FeatureId`].
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    pub(super) values: [f32; FEATURES],
    /// Whether the values are displacements from the wearer's neutral face.
    pub(super) neutral_known: bool,
}

impl Features {
    /// Displacements from `neutral`, or the values themselves if the wearer's neutral face is not known.
    #[must_use]
    pub fn new(face: &Normalised, neutral: Option<&Neutral>) -> Self {
        let mut measures = measure(&face.points);
        if let Some(neutral) = neutral {
            measures.iter_mut().zip(neutral.measures.iter()).for_each(|(value, rest)| *value -= rest);
        }
        let mut values = [0.0; FEATURES];
        copy(&mut values, measures);
        copy(values.iter_mut().skip(MEASURES), turns(face));
        Self { values, neutral_known: neutral.is_some() }
    }

    /// The value of one feature.
    pub(super) fn get(&self, id: FeatureId) -> f32 {
        self.values.get(id.index()).copied().unwrap_or(f32::NAN)
    }

    /// All values, in the order of [`FeatureId`].
    #[must_use]
    pub fn values(&self) -> &[f32; FEATURES] {
        &self.values
    }
}

/// Coordinates and distances of a face, without a reference.
pub(super) fn measure(points: &[[f32; 3]; LANDMARKS]) -> [f32; MEASURES] {
    let mut values = [0.0; MEASURES];
    copy(&mut values, points.as_flattened().iter().copied());
    copy(values.iter_mut().skip(COORDINATES), DISTANCES.iter().map(|pair| distance(points, *pair)));
    values
}

fn copy<'a>(slots: impl IntoIterator<Item = &'a mut f32>, values: impl IntoIterator<Item = f32>) {
    slots.into_iter().zip(values).for_each(|(slot, value)| *slot = value);
}

/// The direction of the face in the picture (right, up), and how much higher its left side is than its right.
fn turns(face: &Normalised) -> [f32; 3] {
    let m = &face.rotation;
    [m.m13, m.m23, m.m21]
}

fn distance(points: &[[f32; 3]; LANDMARKS], (a, b): (usize, usize)) -> f32 {
    let (Some(a), Some(b)) = (points.get(a), points.get(b)) else {
        return 0.0;
    };
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f32>().sqrt()
}

#[cfg(test)]
#[allow(clippy::expect_used, clippy::indexing_slicing)]
mod tests {
    use super::*;
    use crate::solve::{NeutralMean, normalise, test_face::face};

    #[test]
    fn neutral_face_has_no_displacement() {
        let face = normalise(&face([5.0, 0.0, 0.0], 80.0, [320.0, 240.0])).expect("a face");
        let mut mean = NeutralMean::default();
        mean.add(&face);
        let neutral = mean.finish().expect("one frame");
        let features = Features::new(&face, Some(&neutral));
        assert!(features.values[..MEASURES].iter().all(|value| value.abs() < 1e-6));
    }

    #[test]
    fn turn_of_the_head_is_about_its_sine() {
        for (axis, name) in ["yaw", "pitch", "roll"].into_iter().enumerate() {
            let mut angles = [0.0_f32; 3];
            angles[axis] = 20.0;
            let face = normalise(&face(angles, 80.0, [320.0, 240.0])).expect("a face");
            let value = Features::new(&face, None).get(FeatureId::from_name(name).expect("known"));
            assert!((value - 20.0_f32.to_radians().sin()).abs() < 0.01, "{name}: {value}");
        }
    }

    #[test]
    fn opened_mouth_lengthens_its_distance_by_as_much() {
        let id = FeatureId::from_name("d13-14").expect("known");
        let mut points = [[0.0; 3]; LANDMARKS];
        points[14] = [0.0, -0.3, -0.4];
        assert!((measure(&points)[id.index()] - 0.5).abs() < 1e-6);
    }
}
