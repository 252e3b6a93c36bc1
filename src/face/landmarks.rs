//! The 478 points of a face.

use super::refinement::{LEFT_IRIS, LEFT_IRIS_DEPTH, RIGHT_IRIS, RIGHT_IRIS_DEPTH};

/// Number of points of the mesh, which come first.
pub const MESH: usize = 468;
/// Number of points of a face: 468 of the mesh, 5 of the right eye's iris, 5 of the left eye's iris.
pub const LANDMARKS: usize = 478;

/// Landmarks of one face in MediaPipe's order, in pixels of the picture: x to the right, y down, z away from the camera.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmarks(pub [[f32; 3]; LANDMARKS]);

impl Landmarks {
    /// All points at the origin.
    #[must_use]
    pub const fn zero() -> Self {
        Self([[0.0; 3]; LANDMARKS])
    }

    /// Whether every number is finite.
    #[must_use]
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
