//! The region of interest: the rotated square of the picture that the mesh network receives.
//!
//! The geometry is that of MediaPipe's face landmark graph. The eyes are level in the square, and a side of the square
//! is 1.5 times the long side of the box around the face.

use super::landmarks::{Landmarks, MESH};

/// Side of the region divided by the longer side of the box around the face.
const MARGIN: f32 = 1.5;
/// Outer corners of the eyes: the person's right eye, which is on the left of an unmirrored picture, then the left eye.
const EYE_CORNERS: [usize; 2] = [33, 263];

/// A square of the picture, in pixels, rotated clockwise by `angle_rad`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceBox {
    /// Centre: x to the right, y down.
    pub centre: [f32; 2],
    /// Length of a side.
    pub size: f32,
    /// Angle from the picture's x axis to the line through the eyes.
    pub angle_rad: f32,
}

impl FaceBox {
    /// Returns the region of interest around an upright box, given by its least and greatest coordinates, in which the
    /// line from `eyes[0]` to `eyes[1]` is level. Returns `None` if the box is smaller than a pixel or a number is not
    /// finite.
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

    /// Returns the region of interest for the next frame, from the landmarks of this frame. Returns `None` as
    /// [`FaceBox::around`] does.
    pub fn following(landmarks: &Landmarks) -> Option<Self> {
        let eyes = EYE_CORNERS.map(|index| landmarks.0.get(index).map_or([f32::NAN; 2], |[x, y, _]| [*x, *y]));
        Self::around(bounds(landmarks.0.iter().take(MESH).map(|[x, y, _]| [*x, *y])), eyes)
    }

    /// The map from the region to the picture.
    pub fn mapping(&self) -> Mapping {
        let (sin, cos) = self.angle_rad.sin_cos();
        Mapping { region: *self, across: [cos, sin] }
    }
}

/// Least and greatest coordinates of points.
pub fn bounds(points: impl Iterator<Item = [f32; 2]>) -> [[f32; 2]; 2] {
    points.fold([[f32::INFINITY; 2], [f32::NEG_INFINITY; 2]], |[min, max], [x, y]| {
        [[min[0].min(x), min[1].min(y)], [max[0].max(x), max[1].max(y)]]
    })
}

/// Maps positions in a region to the picture.
#[derive(Debug, Clone, Copy)]
pub struct Mapping {
    region: FaceBox,
    /// The direction of the region's x axis in the picture, of length 1.
    across: [f32; 2],
}

impl Mapping {
    /// The position in the picture of `(u, v)`, which run from 0 to 1 across the region.
    pub fn to_picture(self, u: f32, v: f32) -> [f32; 2] {
        let ([cos, sin], FaceBox { centre, size, .. }) = (self.across, self.region);
        let (x, y) = ((u - 0.5) * size, (v - 0.5) * size);
        [centre[0] + cos * x - sin * y, centre[1] + sin * x + cos * y]
    }

    /// The vector in the picture from one of `side` samples in a row of the region to the next.
    pub fn step(&self, side: usize) -> [f32; 2] {
        let pitch = 1.0 / side as f32;
        self.across.map(|along| along * self.region.size * pitch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn region_is_1_5_times_as_large_as_the_long_side() {
        let region = FaceBox::around([[10.0, 20.0], [50.0, 100.0]], [[20.0, 50.0], [40.0, 50.0]]).expect("a box");
        assert_eq!(region, FaceBox { centre: [30.0, 60.0], size: 120.0, angle_rad: 0.0 });
    }

    #[test]
    fn tilted_eyes_are_level_in_the_region() {
        let eyes = [[20.0, 40.0], [40.0, 60.0]];
        let region = FaceBox::around([[0.0, 0.0], [60.0, 100.0]], eyes).expect("a box");
        let [left, right] = [0.0, 1.0].map(|u| region.mapping().to_picture(u, 0.5));
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
