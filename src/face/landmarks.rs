//! The 478 points of a face.

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
}
