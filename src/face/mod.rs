//! From a picture to the landmarks of the one face that is followed in it.

mod colour;
mod crop;
mod detector;
mod landmarks;
mod mesh;
mod planes;
mod refinement;
mod region;
#[cfg(test)]
pub(crate) mod test_face;
mod tracker;
mod transform;

pub use crop::{Border, CropShape, crop};
pub use detector::{Detection, Detector};
pub use landmarks::{LANDMARKS, Landmarks, MESH};
pub use mesh::Mesh;
pub use region::FaceBox;
pub use tracker::Tracker;
