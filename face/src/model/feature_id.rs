//! The features of a face and their names.
//!
//! A feature is a coordinate of a landmark, the distance of two landmarks, or how far the head is turned. Its name says
//! which: `x159`, `y159` and `z159` are coordinates of landmark 159, and `d159-145` is a distance, in eye distances.
//! `yaw`, `pitch` and `roll` are about the sines of these angles.

use core::fmt;

use serde::{Deserialize, Serialize};

use crate::LANDMARKS;

/// Pairs of landmarks whose distance, unlike their coordinates, survives errors of the head's rotation: lid gaps,
/// irises to the corners and lids of their eyes, mouth, brows to lids, cheeks and chin.
#[rustfmt::skip]
pub(crate) const DISTANCES: [(usize, usize); 35] = [
    (159, 145), (158, 153), (160, 144), (386, 374), (385, 380), (387, 373), (468, 33), (468, 133), (473, 362),
    (473, 263), (468, 159), (468, 145), (473, 386), (473, 374), (13, 14), (61, 291), (0, 17), (78, 308), (82, 87),
    (312, 317), (37, 84), (267, 314), (164, 0), (61, 33), (291, 263), (61, 1), (291, 1), (105, 159), (334, 386),
    (55, 285), (152, 1), (152, 17), (205, 50), (50, 4), (280, 4),
];

/// Names of the features that tell how far the head is turned.
const TURNS: [&str; 3] = ["yaw", "pitch", "roll"];

/// Number of coordinates, which come first.
pub(crate) const COORDINATES: usize = 3 * LANDMARKS;
/// Number of features that are measured on the face: coordinates, then distances.
pub const MEASURES: usize = COORDINATES + DISTANCES.len();
/// Number of features of a face.
pub const FEATURES: usize = MEASURES + TURNS.len();

/// Index of a feature, below [`FEATURES`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct FeatureId(u16);

impl FeatureId {
    /// The feature with this index, or `None` if it is not below [`FEATURES`].
    pub fn from_index(index: usize) -> Option<Self> {
        (index < FEATURES).then(|| u16::try_from(index).ok().map(Self))?
    }

    /// The feature's index.
    pub fn index(self) -> usize {
        usize::from(self.0)
    }

    /// Reads a name as [`FeatureId`] displays it.
    pub fn from_name(name: &str) -> Option<Self> {
        if let Some(turn) = TURNS.iter().position(|known| *known == name) {
            return Self::from_index(MEASURES + turn);
        }
        let (kind, rest) = name.split_at_checked(1)?;
        if kind == "d" {
            let (a, b) = rest.split_once('-')?;
            let pair = (a.parse().ok()?, b.parse().ok()?);
            let distance = DISTANCES.iter().position(|known| *known == pair)?;
            return Self::from_index(COORDINATES + distance);
        }
        let axis = ["x", "y", "z"].iter().position(|known| *known == kind)?;
        let landmark = rest.parse::<usize>().ok().filter(|landmark| *landmark < LANDMARKS)?;
        Self::from_index(3 * landmark + axis)
    }
}

impl fmt::Display for FeatureId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let index = self.index();
        if let Some(turn) = index.checked_sub(MEASURES).and_then(|turn| TURNS.get(turn)) {
            return f.write_str(turn);
        }
        match index.checked_sub(COORDINATES).and_then(|distance| DISTANCES.get(distance)) {
            Some((a, b)) => write!(f, "d{a}-{b}"),
            None => write!(f, "{}{}", ['x', 'y', 'z'].get(index % 3).unwrap_or(&'x'), index / 3),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_feature_is_found_by_its_name() {
        for index in 0..FEATURES {
            let id = FeatureId::from_index(index).expect("below the count");
            assert_eq!(FeatureId::from_name(&id.to_string()), Some(id));
        }
        assert_eq!(FeatureId::from_index(FEATURES), None);
    }

    #[test]
    fn unknown_names_are_refused() {
        for name in ["", "x", "x478", "y-1", "w3", "d1-2", "d159", "é1"] {
            assert_eq!(FeatureId::from_name(name), None, "{name}");
        }
    }
}
