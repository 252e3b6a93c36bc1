//! The 478 points of a face.

use super::refinement::{LEFT_IRIS, LEFT_IRIS_DEPTH, RIGHT_IRIS, RIGHT_IRIS_DEPTH};

/// Points of the mesh, which come first.
pub const MESH: usize = 468;
/// Points of a face: 468 of the mesh, then 5 of the iris beside point 33 and 5 of the one beside point 263.
pub const LANDMARKS: usize = 478;

/// Landmarks of one face in MediaPipe's order: x to the right and y down in pixels of the picture, z away from
/// the camera at the same scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmarks(pub [[f32; 3]; LANDMARKS]);

impl Landmarks {
    /// All points at the origin: room to be filled in.
    #[must_use]
    pub const fn zero() -> Self {
        Self([[0.0; 3]; LANDMARKS])
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.0.as_flattened().iter().all(|value| value.is_finite())
    }

    /// Puts both irises at the mean depth of their eye's rim. The mesh does so; some trackers leave them at depth 0.
    pub fn level_irises(&mut self) {
        self.level_iris(&RIGHT_IRIS, &RIGHT_IRIS_DEPTH);
        self.level_iris(&LEFT_IRIS, &LEFT_IRIS_DEPTH);
    }

    /// Puts one iris at the mean depth of its rim.
    pub(super) fn level_iris(&mut self, iris: &[u16], rim: &[u16]) {
        let depth_of = |index: &u16| self.0.get(usize::from(*index)).map_or(0.0, |point| point[2]);
        let depth = rim.iter().map(depth_of).sum::<f32>() / rim.len() as f32;
        for &index in iris {
            if let Some(point) = self.0.get_mut(usize::from(index)) {
                point[2] = depth;
            }
        }
    }
}
