//! The 478 points of a face.

/// Points of a face: 468 of the mesh, then 5 of the iris beside point 33 and 5 of the one beside point 263.
pub const LANDMARKS: usize = 478;

/// Landmarks of one face in MediaPipe's order: x to the right and y down in pixels of the picture, z away from
/// the camera at the same scale.
#[derive(Debug, Clone, PartialEq)]
pub struct Landmarks(pub [[f32; 3]; LANDMARKS]);
