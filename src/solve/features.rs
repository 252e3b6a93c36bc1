//! `S` and `T_d` (eq. 4, 5): what the regression sees of a face.
//!
//! A feature is a coordinate of a landmark or the distance of two landmarks, as its displacement from the wearer's
//! neutral face where that is known; or how far the head is turned, which no neutral face changes. Selection (eq. 4) is
//! the model's list of indices into [`Features`]: on the board the matrix D would be nothing but zeros. Names: `x159`,
//! `y159`, `z159` are coordinates of landmark 159, `d159-145` is a distance; unit: eye distances. `yaw`, `pitch` and
//! `roll` are about the sines of these angles.

use core::fmt;

use super::{affine::Normalised, neutral::Neutral};
use crate::face::LANDMARKS;

/// Pairs of landmarks whose distance, unlike their coordinates, survives errors of the head's rotation:
/// lid gaps, irises to the corners and lids of their eyes, mouth, brows to lids, cheeks and chin.
const DISTANCES: [(usize, usize); 35] = [
    (159, 145),
    (158, 153),
    (160, 144),
    (386, 374),
    (385, 380),
    (387, 373),
    (468, 33),
    (468, 133),
    (473, 362),
    (473, 263),
    (468, 159),
    (468, 145),
    (473, 386),
    (473, 374),
    (13, 14),
    (61, 291),
    (0, 17),
    (78, 308),
    (82, 87),
    (312, 317),
    (37, 84),
    (267, 314),
    (164, 0),
    (61, 33),
    (291, 263),
    (61, 1),
    (291, 1),
    (105, 159),
    (334, 386),
    (55, 285),
    (152, 1),
    (152, 17),
    (205, 50),
    (50, 4),
    (280, 4),
];

/// Names of the features that say how far the head is turned.
const TURNS: [&str; 3] = ["yaw", "pitch", "roll"];

const COORDINATES: usize = 3 * LANDMARKS;
/// Features that are measured on the face: coordinates, then distances.
pub const MEASURES: usize = COORDINATES + DISTANCES.len();
/// Features of a face.
pub const FEATURES: usize = MEASURES + TURNS.len();

/// All features of one face, in the order of [`FeatureId`].
#[derive(Debug, Clone, PartialEq)]
pub struct Features {
    pub(super) values: [f32; FEATURES],
    /// Whether the values are displacements from the wearer's neutral face.
    pub(super) neutral_known: bool,
}

impl Features {
    /// Displacements from `neutral`, or the plain values if the wearer's neutral face is not known.
    #[must_use]
    pub fn new(face: &Normalised, neutral: Option<&Neutral>) -> Self {
        let mut measures = measure(&face.points);
        if let Some(neutral) = neutral {
            measures.iter_mut().zip(neutral.measures.iter()).for_each(|(value, rest)| *value -= rest);
        }
        let mut values = [0.0; FEATURES];
        let all = measures.into_iter().chain(turns(face));
        values.iter_mut().zip(all).for_each(|(slot, value)| *slot = value);
        Self { values, neutral_known: neutral.is_some() }
    }

    /// One of the values.
    pub(super) fn get(&self, id: FeatureId) -> f32 {
        self.values.get(id.index()).copied().unwrap_or(f32::NAN)
    }

    /// The values, in the order of [`FeatureId`].
    #[must_use]
    pub fn values(&self) -> &[f32; FEATURES] {
        &self.values
    }
}

/// Coordinates and distances of a face, without a reference.
pub(super) fn measure(points: &[[f32; 3]; LANDMARKS]) -> [f32; MEASURES] {
    let mut values = [0.0; MEASURES];
    let distances = DISTANCES.iter().map(|pair| distance(points, *pair));
    values.iter_mut().zip(points.iter().flatten().copied().chain(distances)).for_each(|(slot, value)| *slot = value);
    values
}

/// In the picture, where the face points to (right, up) and how high its left side is.
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

/// Index of a feature, below [`FEATURES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct FeatureId(u16);

impl FeatureId {
    /// The feature at `index` of [`Features::values`].
    #[must_use]
    pub fn from_index(index: usize) -> Option<Self> {
        (index < FEATURES).then(|| u16::try_from(index).ok().map(Self))?
    }

    /// Place in [`Features::values`].
    #[must_use]
    pub fn index(self) -> usize {
        usize::from(self.0)
    }

    /// Reads a name as [`FeatureId`] displays it.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        if let Some(turn) = TURNS.iter().position(|known| *known == name) {
            return Self::from_index(MEASURES + turn);
        }
        let (kind, rest) = name.split_at_checked(1)?;
        if kind == "d" {
            let (a, b) = rest.split_once('-')?;
            let pair = (a.parse().ok()?, b.parse().ok()?);
            let place = DISTANCES.iter().position(|known| *known == pair)?;
            return Self::from_index(COORDINATES + place);
        }
        let axis = ["x", "y", "z"].iter().position(|known| *known == kind)?;
        let landmark = rest.parse::<usize>().ok().filter(|landmark| *landmark < LANDMARKS)?;
        Self::from_index(3 * landmark + axis)
    }
}

impl fmt::Display for FeatureId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let index = self.index();
        if let Some(turn) = index.checked_sub(MEASURES).and_then(|place| TURNS.get(place)) {
            return f.write_str(turn);
        }
        match index.checked_sub(COORDINATES).and_then(|place| DISTANCES.get(place)) {
            Some((a, b)) => write!(f, "d{a}-{b}"),
            None => write!(f, "{}{}", ['x', 'y', 'z'].get(index % 3).unwrap_or(&'x'), index / 3),
        }
    }
}

#[cfg(test)]
#[allow(clippy::expect_used, clippy::indexing_slicing)]
mod tests {
    use super::*;
    use crate::solve::{NeutralMean, normalise, test_face::face};

    #[test]
    fn every_feature_is_found_again_by_its_name() {
        for index in 0..FEATURES {
            let id = FeatureId::from_index(index).expect("below the count");
            assert_eq!(FeatureId::from_name(&id.to_string()), Some(id));
        }
        assert_eq!(FeatureId::from_index(FEATURES), None);
    }

    #[test]
    fn names_of_no_feature_are_refused() {
        for name in ["", "x", "x478", "y-1", "w3", "d1-2", "d159", "é1"] {
            assert_eq!(FeatureId::from_name(name), None, "{name}");
        }
    }

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
    fn a_turned_head_is_felt_by_sine_whatever_the_neutral_face() {
        for (axis, name) in TURNS.iter().enumerate() {
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
