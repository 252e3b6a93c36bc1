//! Finds a face in a picture, follows it from frame to frame and returns its landmarks.

mod block;
mod crop;
mod detector;
mod feature_map;
mod landmarks;
mod mesh;
mod planes;
pub(crate) mod refinement;
mod region;
mod tracker;

pub use block::Block;
pub use crop::{Border, CropShape, Rows, crop};
pub use detector::Detector;
#[cfg(any(test, feature = "testing"))]
pub(crate) use feature_map::Transform;
pub use landmarks::{Appearance, Face, LANDMARKS, Landmarks, MESH};
pub use mesh::Mesh;
pub use region::FaceBox;
pub use region::bounds;
pub use tracker::Tracker;
