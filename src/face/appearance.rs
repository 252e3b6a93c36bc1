//! How the face looks around its landmarks: the mesh network's feature map, sampled at some of them.
//!
//! Landmarks show where the skin is. The map also shows what lies between them, such as folds, shadows and teeth.

use super::feature_map::FeatureMap;
use super::landmarks::Landmarks;
use super::refinement::{FEATURE_CHANNELS, FEATURE_SCALE};

/// Number of landmarks at which the map is sampled.
pub const APPEARANCE_POINTS: usize = POINTS.len();
/// Number of values at each of these landmarks.
pub const APPEARANCE_CHANNELS: usize = FEATURE_CHANNELS;

/// The landmarks: lips, lids and irises, and the rest of the face without its outline, behind which the background lies.
/// With each landmark, its mirror image is in the list.
const POINTS: [u16; 180] = [
    0, 1, 2, 3, 5, 6, 7, 9, 13, 14, 17, 33, 34, 36, 37, 39, 40, 46, 49, 50, 55, 61, 63, 66, 68, 69, 71, 78, 79, 80, 81,
    82, 84, 87, 88, 91, 95, 98, 104, 105, 108, 116, 117, 119, 121, 123, 133, 134, 135, 137, 138, 139, 140, 143, 144,
    145, 146, 147, 151, 153, 154, 155, 156, 157, 158, 159, 160, 161, 163, 170, 173, 175, 177, 178, 181, 185, 187, 188,
    191, 192, 193, 194, 200, 205, 208, 210, 212, 213, 215, 216, 217, 221, 223, 227, 246, 248, 249, 263, 264, 266, 267,
    269, 270, 276, 279, 280, 285, 291, 293, 296, 298, 299, 301, 308, 309, 310, 311, 312, 314, 317, 318, 321, 324, 327,
    333, 334, 337, 345, 346, 348, 350, 352, 362, 363, 364, 366, 367, 368, 369, 372, 373, 374, 375, 376, 380, 381, 382,
    383, 384, 385, 386, 387, 388, 390, 395, 398, 401, 402, 405, 409, 411, 412, 415, 416, 417, 418, 425, 428, 430, 432,
    433, 435, 436, 437, 441, 443, 447, 466, 468, 473,
];

/// The values of the feature map at [`APPEARANCE_POINTS`] landmarks, one row per landmark.
#[derive(Debug, Clone, PartialEq)]
pub struct Appearance(pub Box<[[f32; APPEARANCE_CHANNELS]]>);

impl Appearance {
    /// All values 0.
    #[must_use]
    pub fn zero() -> Self {
        Self(vec![[0.0; APPEARANCE_CHANNELS]; APPEARANCE_POINTS].into())
    }

    /// Samples the map of a network at landmarks that are in samples of its input.
    pub(super) fn sample(&mut self, map: FeatureMap, landmarks: &Landmarks) {
        for (values, &index) in self.0.iter_mut().zip(&POINTS) {
            let [x, y, _] = landmarks.0.get(usize::from(index)).copied().unwrap_or_default();
            map.sample([x, y].map(|value| value * FEATURE_SCALE - 0.5), values);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::refinement::{FEATURE_SIZE, LEFT_EYE, LIPS, RIGHT_EYE};
    use super::*;

    #[test]
    fn every_landmark_is_in_the_list_once_and_lips_and_lids_are_in_it() {
        assert!(POINTS.is_sorted_by(|one, other| one < other));
        let contours = LIPS[..40].iter().chain(&RIGHT_EYE[..16]).chain(&LEFT_EYE[..16]);
        assert!(contours.into_iter().all(|index| POINTS.contains(index)));
    }

    #[test]
    fn values_are_those_of_the_map_at_the_landmarks() {
        let cell = |at: usize| [(at % FEATURE_SIZE) as f32, (at / FEATURE_SIZE) as f32].repeat(FEATURE_CHANNELS / 2);
        let map: Vec<f32> = (0..FEATURE_SIZE * FEATURE_SIZE).flat_map(cell).collect();
        let mut landmarks = Landmarks::zero();
        for (index, point) in landmarks.0.iter_mut().enumerate() {
            *point = [8.0 + index as f32 / 4.0, 180.0 - index as f32 / 5.0, 3.0];
        }
        let mut appearance = Appearance::zero();
        appearance.sample(FeatureMap::new(&map), &landmarks);
        for (values, index) in appearance.0.iter().zip(POINTS) {
            // A cell of the map covers four samples of the picture, and its values are those of its centre.
            let [x, y, _] = landmarks.0[usize::from(index)].map(|value| (value - 2.0) / 4.0);
            for [column, row] in values.as_chunks().0 {
                assert!((column - x).abs() < 1e-3 && (row - y).abs() < 1e-3, "{index}: {column} {row} for {x} {y}");
            }
        }
    }
}
