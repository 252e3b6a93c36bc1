//! The two halves of a face: eyes with brows, and everything else. Each rests by itself, so that each is learned by itself.

use super::plausible::index_of;
use crate::model::{COORDINATES, DISTANCES, MEASURES};
use crate::track::refinement::{LEFT_EYE, LEFT_IRIS, RIGHT_EYE, RIGHT_IRIS};

/// A half of a face.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Half {
    /// Eyes and brows.
    Upper,
    /// Mouth, jaw, cheeks, nose, and all else.
    Lower,
}

/// A value for each half.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Halves<T> {
    pub upper: T,
    pub lower: T,
}

impl<T: Copy> Halves<T> {
    pub fn both(value: T) -> Self {
        Self { upper: value, lower: value }
    }

    pub fn of(self, half: Half) -> T {
        match half {
            Half::Upper => self.upper,
            Half::Lower => self.lower,
        }
    }
}

impl Halves<f32> {
    pub fn mean(self) -> f32 {
        0.5 * (self.upper + self.lower)
    }
}

const FIRST_OF_EYES: usize = index_of("eyeBlinkLeft");
const LAST_OF_EYES: usize = index_of("eyeWideRight");
const FIRST_OF_BROWS: usize = index_of("browDownLeft");
const LAST_OF_BROWS: usize = index_of("browOuterUpRight");

/// The half of each measure, in the order of [`measure`](super::features::measure). A distance is one of the upper half if both
/// its ends are.
#[expect(clippy::indexing_slicing, reason = "the compiler computes it")]
pub(super) static HALF_OF_MEASURE: [Half; MEASURES] = {
    let mut halves = [Half::Lower; MEASURES];
    let lists: [&[u16]; 4] = [&LEFT_EYE, &RIGHT_EYE, &LEFT_IRIS, &RIGHT_IRIS];
    let mut list = 0;
    while list < lists.len() {
        let mut place = 0;
        while place < lists[list].len() {
            let first = 3 * lists[list][place] as usize;
            halves[first] = Half::Upper;
            halves[first + 1] = Half::Upper;
            halves[first + 2] = Half::Upper;
            place += 1;
        }
        list += 1;
    }
    let mut distance = 0;
    while distance < DISTANCES.len() {
        let (one, other) = DISTANCES[distance];
        if matches!((halves[3 * one], halves[3 * other]), (Half::Upper, Half::Upper)) {
            halves[COORDINATES + distance] = Half::Upper;
        }
        distance += 1;
    }
    halves
};

/// The half of the coefficient at this place of [`BLENDSHAPES`](crate::BLENDSHAPES).
pub fn half_of(place: usize) -> Half {
    let is_upper = (FIRST_OF_EYES..=LAST_OF_EYES).contains(&place) || (FIRST_OF_BROWS..=LAST_OF_BROWS).contains(&place);
    if is_upper { Half::Upper } else { Half::Lower }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BLENDSHAPES;
    use crate::model::FeatureId;

    #[test]
    fn eyes_and_brows_are_the_upper_half() {
        for (place, name) in BLENDSHAPES.iter().enumerate() {
            let is_upper = name.starts_with("eye") || name.starts_with("brow");
            assert_eq!(half_of(place) == Half::Upper, is_upper, "{name}");
        }
        // A brow, a lid and an iris; the tip of the nose, a corner of the mouth and the chin.
        for (names, half) in [(["x105", "y159", "z473"], Half::Upper), (["x1", "y61", "z152"], Half::Lower)] {
            let index = |name: &str| FeatureId::from_name(name).expect("known").index();
            assert!(names.iter().all(|name| HALF_OF_MEASURE[index(name)] == half), "{names:?}");
        }
    }
}
