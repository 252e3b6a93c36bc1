//! The points of a face, the region of the picture where the next frame's are expected, and how the skin looks.

use super::eyes::EyeValues;
use super::feature_map::{FeatureMap, bounds};
use super::mouth::{MOUTH_VALUES, MouthValues};
use super::refinement::{FEATURE_SCALE, LEFT_IRIS, LEFT_IRIS_DEPTH, RIGHT_IRIS, RIGHT_IRIS_DEPTH};
use super::visible::{InView, REGIONS};
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

    /// Moves each iris to the mean depth of the contour of its eye: some trackers record irises at depth 0.
    pub fn level_irises(&mut self) {
        self.level_iris(&RIGHT_IRIS, &RIGHT_IRIS_DEPTH);
        self.level_iris(&LEFT_IRIS, &LEFT_IRIS_DEPTH);
    }

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

/// The log-odds of a region that is in view beyond doubt.
const WHOLE: f32 = 10.0;

/// What facewire's own networks give for a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Looks {
    /// Values of the network of the eyes.
    pub eyes: EyeValues,
    /// Coefficients by the network of the mouth. They are read while the eyes are covered.
    pub mouth: MouthValues,
    /// The log-odds that each region is in view.
    pub in_view: InView,
}

impl Default for Looks {
    /// All values 0, of a face that is wholly in view.
    fn default() -> Self {
        Self { eyes: EyeValues::default(), mouth: [0.0; MOUTH_VALUES], in_view: [WHOLE; REGIONS] }
    }
}

/// How a face looks to the networks.
#[derive(Debug, Clone, PartialEq)]
pub struct Appearance {
    /// The values of the feature map at [`APPEARANCE_LANDMARKS`], one row per landmark.
    pub skin: Box<[[f32; APPEARANCE_CHANNELS]]>,
    /// What facewire's own networks give.
    pub looks: Looks,
    /// Log-odds, by the mesh network, that the region shows a face: at least 0. They are about 25 for a face in view, and
    /// mostly below 15 for one that is upside down or whose eyes are covered.
    pub score: f32,
}

impl Appearance {
    /// All values 0, of a face that is wholly in view.
    pub fn zero() -> Self {
        Self {
            skin: vec![[0.0; APPEARANCE_CHANNELS]; APPEARANCE_LANDMARKS.len()].into(),
            looks: Looks::default(),
            score: 0.0,
        }
    }

    /// Samples the map of a network at landmarks whose coordinates count samples of the network's input.
    pub(super) fn sample(&mut self, map: FeatureMap, landmarks: &Landmarks) {
        for (values, &index) in self.skin.iter_mut().zip(&APPEARANCE_LANDMARKS) {
            let [x, y, _] = landmarks.0.get(usize::from(index)).copied().unwrap_or_default();
            map.sample([x, y].map(|value| value * FEATURE_SCALE - 0.5), values);
        }
    }
}

/// Side of the region divided by the longer side of the box around the face.
pub(super) const MARGIN: f32 = 1.5;
/// Outer corners of the eyes: the person's right eye, which is on the left of an unmirrored picture, then the left eye.
const EYE_CORNERS: [usize; 2] = [33, 263];

/// The region of interest: the square of the picture, in pixels, that the mesh network receives, as in MediaPipe's graph.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceBox {
    /// Centre: x to the right, y down.
    pub centre: [f32; 2],
    /// Length of a side.
    pub size: f32,
    /// Clockwise angle from the picture's x axis to the line through the eyes.
    pub angle_rad: f32,
}

impl FaceBox {
    /// Returns the region around an upright box of least and greatest coordinates, in which the line between the eyes is
    /// level, or `None` if the box is smaller than a pixel or a number is not finite.
    pub fn around([min, max]: [[f32; 2]; 2], eyes: [[f32; 2]; 2]) -> Option<Self> {
        let side = (max[0] - min[0]).max(max[1] - min[1]);
        let region = Self {
            centre: [f32::midpoint(min[0], max[0]), f32::midpoint(min[1], max[1])],
            size: side * MARGIN,
            angle_rad: (eyes[1][1] - eyes[0][1]).atan2(eyes[1][0] - eyes[0][0]),
        };
        let finite = region.centre.iter().chain([&region.size, &region.angle_rad]).all(|value| value.is_finite());
        (finite && side >= 1.0).then_some(region)
    }

    /// Returns the region for the next frame, from the landmarks of this frame, like [`FaceBox::around`].
    pub fn following(landmarks: &Landmarks) -> Option<Self> {
        let eyes = EYE_CORNERS.map(|index| landmarks.0.get(index).map_or([f32::NAN; 2], |[x, y, _]| [*x, *y]));
        Self::around(bounds(landmarks.0.iter().take(MESH).map(|[x, y, _]| [*x, *y])), eyes)
    }

    /// Whether the centre of the other region lies in the face, so that both show the same one.
    pub fn is_same(&self, other: &Self) -> bool {
        let half = 0.5 * self.size / MARGIN;
        self.centre.iter().zip(other.centre).all(|(one, other)| (one - other).abs() < half)
    }

    /// The map from the region to the picture.
    pub fn mapping(&self) -> Mapping {
        let (sin, cos) = self.angle_rad.sin_cos();
        Mapping { region: *self, across: [cos, sin] }
    }
}

/// Maps positions in a region to the picture.
#[derive(Debug, Clone, Copy)]
pub struct Mapping {
    region: FaceBox,
    /// The direction in the picture of the region's rows.
    pub(super) across: [f32; 2],
}

impl Mapping {
    /// The position in the picture of `(u, v)`, which run from 0 to 1 across the region.
    pub fn to_picture(self, u: f32, v: f32) -> [f32; 2] {
        let [cos, sin] = self.across;
        let FaceBox { centre, size, .. } = self.region;
        let x = (u - 0.5) * size;
        let y = (v - 0.5) * size;
        [centre[0] + cos * x - sin * y, centre[1] + sin * x + cos * y]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::feature_map::tests::map;

    #[test]
    fn values_are_those_of_the_map_at_the_landmarks() {
        let mut landmarks = Landmarks::zero();
        for (index, point) in landmarks.0.iter_mut().enumerate() {
            *point = [8.0 + index as f32 / 4.0, 180.0 - index as f32 / 5.0, 3.0];
        }
        let mut appearance = Appearance::zero();
        appearance.sample(FeatureMap::new(&map()), &landmarks);
        for (values, index) in appearance.skin.iter().zip(APPEARANCE_LANDMARKS) {
            // A cell of the map covers four samples of the picture, and its values are those of its centre.
            let [x, y, _] = landmarks.0[usize::from(index)].map(|value| (value - 2.0) / 4.0);
            let is_near = values.iter().all(|value| (value - x - 100.0 * y).abs() < 1e-2);
            assert!(is_near, "{index}: {} at {x} {y}", values[0]);
        }
    }

    #[test]
    fn region_is_1_5_times_as_large_as_the_long_side_and_tilted_eyes_are_level_in_it() {
        let upright = FaceBox::around([[10.0, 20.0], [50.0, 100.0]], [[20.0, 50.0], [40.0, 50.0]]).expect("a box");
        assert_eq!(upright, FaceBox { centre: [30.0, 60.0], size: 120.0, angle_rad: 0.0 });
        let tilted = FaceBox::around([[0.0, 0.0], [60.0, 100.0]], [[20.0, 40.0], [40.0, 60.0]]).expect("a box");
        let [left, right] = [0.0, 1.0].map(|u| tilted.mapping().to_picture(u, 0.5));
        assert!(((right[1] - left[1]) / (right[0] - left[0]) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn box_without_extent_or_with_a_number_that_is_not_finite_is_refused() {
        let level = [[0.0; 2], [1.0, 0.0]];
        assert_eq!(FaceBox::around([[5.0, 5.0], [5.0, 5.0]], level), None);
        assert_eq!(FaceBox::around([[f32::NAN; 2], [9.0; 2]], level), None);
        assert_eq!(FaceBox::around([[0.0; 2], [9.0; 2]], [[0.0; 2], [f32::NAN; 2]]), None);
        assert_eq!(FaceBox::following(&Landmarks::zero()), None);
    }
}
