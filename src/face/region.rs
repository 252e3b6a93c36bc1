//! The region of interest: the turned square of the picture that the mesh network looks at.
//!
//! Geometry as in MediaPipe's face landmark graph: the square is turned so that the eyes are level, and half again
//! as large as the box it is made from.

use super::landmarks::{Landmarks, MESH};

/// The region is this much larger than the box around the face.
const MARGIN: f32 = 1.5;
/// Outer corner of the person's right eye, which stands left in the picture.
const RIGHT_EYE_CORNER: usize = 33;
/// Outer corner of the person's left eye.
const LEFT_EYE_CORNER: usize = 263;

/// A square of the picture, in pixels, turned by `angle_rad` (clockwise in the picture, y being down).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceBox {
    /// Centre, x to the right and y down.
    pub centre: [f32; 2],
    /// Length of a side.
    pub size: f32,
    /// Angle from the picture's x axis to the line of the eyes.
    pub angle_rad: f32,
}

impl FaceBox {
    /// The region of interest around an upright box, turned so that the line from `eyes[0]` to `eyes[1]` is level.
    /// `None` for a box without extent or with a non-finite number.
    #[must_use]
    pub fn around(min: [f32; 2], max: [f32; 2], eyes: [[f32; 2]; 2]) -> Option<Self> {
        let side = (max[0] - min[0]).max(max[1] - min[1]);
        let region = Self {
            centre: [f32::midpoint(min[0], max[0]), f32::midpoint(min[1], max[1])],
            size: side * MARGIN,
            angle_rad: (eyes[1][1] - eyes[0][1]).atan2(eyes[1][0] - eyes[0][0]),
        };
        let finite = region.centre.iter().chain([&region.size, &region.angle_rad]).all(|value| value.is_finite());
        (finite && side >= 1.0).then_some(region)
    }

    /// The region of interest for the next frame, from this frame's landmarks. `None` as for [`FaceBox::around`].
    #[must_use]
    pub fn following(landmarks: &Landmarks) -> Option<Self> {
        let (mut min, mut max) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for [x, y, _] in landmarks.0.iter().take(MESH) {
            min = [min[0].min(*x), min[1].min(*y)];
            max = [max[0].max(*x), max[1].max(*y)];
        }
        let eyes = [landmarks.0[RIGHT_EYE_CORNER], landmarks.0[LEFT_EYE_CORNER]].map(|[x, y, _]| [x, y]);
        Self::around(min, max, eyes)
    }

    /// The way from the region to the picture, for many points.
    #[must_use]
    pub fn placement(&self) -> Placement {
        let (sin, cos) = self.angle_rad.sin_cos();
        Placement { region: *self, across: [cos, sin] }
    }
}

/// A region with its direction worked out.
#[derive(Debug, Clone, Copy)]
pub struct Placement {
    region: FaceBox,
    /// The region's x axis in the picture, of length 1.
    across: [f32; 2],
}

impl Placement {
    /// The picture position of `(u, v)`, both 0 to 1 across the region.
    #[must_use]
    pub fn to_picture(self, u: f32, v: f32) -> [f32; 2] {
        let ([cos, sin], FaceBox { centre, size, .. }) = (self.across, self.region);
        let (x, y) = ((u - 0.5) * size, (v - 0.5) * size);
        [centre[0] + cos * x - sin * y, centre[1] + sin * x + cos * y]
    }

    /// What one of `side` steps across the region is in the picture.
    #[must_use]
    pub fn step(&self, side: usize) -> [f32; 2] {
        let pitch = 1.0 / side as f32;
        self.across.map(|along| along * self.region.size * pitch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn region_is_half_again_as_large_as_the_long_side() {
        let region = FaceBox::around([10.0, 20.0], [50.0, 100.0], [[20.0, 50.0], [40.0, 50.0]]).expect("a box");
        assert_eq!(region, FaceBox { centre: [30.0, 60.0], size: 120.0, angle_rad: 0.0 });
    }

    #[test]
    fn tilted_eyes_lie_level_in_the_region() {
        let eyes = [[20.0, 40.0], [40.0, 60.0]];
        let region = FaceBox::around([0.0, 0.0], [60.0, 100.0], eyes).expect("a box");
        let [left, right] = [0.0, 1.0].map(|u| region.placement().to_picture(u, 0.5));
        assert!(((right[1] - left[1]) / (right[0] - left[0]) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn box_of_nothing_is_refused() {
        assert_eq!(FaceBox::around([5.0, 5.0], [5.0, 5.0], [[0.0; 2], [1.0, 0.0]]), None);
        assert_eq!(FaceBox::around([f32::NAN; 2], [9.0; 2], [[0.0; 2], [1.0, 0.0]]), None);
    }
}
