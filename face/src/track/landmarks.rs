//! The 478 points of a face, which show where the skin is, and how it looks there: the mesh network's feature map, sampled
//! at some of them, shows what lies between them, such as folds, shadows and teeth.

use super::feature_map::FeatureMap;
use super::refinement::{FEATURE_SCALE, LEFT_IRIS, LEFT_IRIS_DEPTH, RIGHT_IRIS, RIGHT_IRIS_DEPTH};
use crate::model::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS};

/// Number of points of the mesh, which come first.
pub const MESH: usize = 468;
/// Number of points of a face: 468 of the mesh, 5 of the right eye's iris, 5 of the left eye's iris.
pub const LANDMARKS: usize = 478;

/// Landmarks of one face in MediaPipe's order, in pixels of the picture: x to the right, y down, z away from the camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmarks(pub [[f32; 3]; LANDMARKS]);

impl Landmarks {
    /// All points at the origin.
    pub const fn zero() -> Self {
        Self([[0.0; 3]; LANDMARKS])
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        // The loop does not stop early, so that the compiler uses vector instructions.
        self.0.as_flattened().iter().fold(true, |finite, value| finite & value.is_finite())
    }

    /// Moves each iris to the mean depth of the contour of its eye. [`super::Mesh`] does this to all landmarks it finds;
    /// the recordings of some other trackers have irises at depth 0.
    pub fn level_irises(&mut self) {
        self.level_iris(&RIGHT_IRIS, &RIGHT_IRIS_DEPTH);
        self.level_iris(&LEFT_IRIS, &LEFT_IRIS_DEPTH);
    }

    /// Moves the points of one iris to the mean depth of the contour of its eye.
    pub(super) fn level_iris(&mut self, iris: &[u16], contour: &[u16]) {
        let depth_of = |index: &u16| self.0.get(usize::from(*index)).map_or(0.0, |point| point[2]);
        let depth = contour.iter().map(depth_of).sum::<f32>() / contour.len() as f32;
        for &index in iris {
            if let Some(point) = self.0.get_mut(usize::from(index)) {
                point[2] = depth;
            }
        }
    }
}

/// A face in a picture.
#[derive(Debug, Clone, Copy)]
pub struct Face<'a> {
    /// Where the skin is.
    pub landmarks: &'a Landmarks,
    /// How it looks; `None` for landmarks from a file, which come without it.
    pub appearance: Option<&'a Appearance>,
}

impl<'a> From<&'a Landmarks> for Face<'a> {
    fn from(landmarks: &'a Landmarks) -> Self {
        Self { landmarks, appearance: None }
    }
}

/// The values of the feature map at [`APPEARANCE_LANDMARKS`], one row per landmark.
#[derive(Debug, Clone, PartialEq)]
pub struct Appearance(pub Box<[[f32; APPEARANCE_CHANNELS]]>);

impl Appearance {
    /// All values 0.
    pub fn zero() -> Self {
        Self(vec![[0.0; APPEARANCE_CHANNELS]; APPEARANCE_LANDMARKS.len()].into())
    }

    /// Samples the map of a network at landmarks whose coordinates count samples of the network's input.
    pub(super) fn sample(&mut self, map: FeatureMap, landmarks: &Landmarks) {
        for (values, &index) in self.0.iter_mut().zip(&APPEARANCE_LANDMARKS) {
            let [x, y, _] = landmarks.0.get(usize::from(index)).copied().unwrap_or_default();
            map.sample([x, y].map(|value| value * FEATURE_SCALE - 0.5), values);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::refinement::{FEATURE_CHANNELS, FEATURE_SIZE, LEFT_EYE, LIPS, RIGHT_EYE};
    use super::*;

    #[test]
    fn every_landmark_is_in_the_list_once_and_lips_and_lids_are_in_it() {
        assert!(APPEARANCE_LANDMARKS.is_sorted_by(|one, other| one < other));
        let contours = LIPS[..40].iter().chain(&RIGHT_EYE[..16]).chain(&LEFT_EYE[..16]);
        assert!(contours.into_iter().all(|index| APPEARANCE_LANDMARKS.contains(index)));
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
        for (values, index) in appearance.0.iter().zip(APPEARANCE_LANDMARKS) {
            // A cell of the map covers four samples of the picture, and its values are those of its centre.
            let [x, y, _] = landmarks.0[usize::from(index)].map(|value| (value - 2.0) / 4.0);
            for [column, row] in values.as_chunks().0 {
                assert!((column - x).abs() < 1e-3 && (row - y).abs() < 1e-3, "{index}: {column} {row} for {x} {y}");
            }
        }
    }
}
