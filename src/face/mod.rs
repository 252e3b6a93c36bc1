//! Finds a face in a picture, follows it from frame to frame and returns its landmarks.

mod appearance;
mod appearance_landmarks;
mod block;
mod colour;
mod crop;
mod detector;
mod feature_map;
mod landmarks;
mod mesh;
mod planes;
mod refinement;
mod region;
#[cfg(test)]
pub(crate) mod test_face;
mod tracker;
mod transform;

pub use appearance::{Appearance, Face};
pub use appearance_landmarks::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS};
pub use block::Block;
pub use crop::{Border, CropShape, Rows, crop};
pub use detector::Detector;
pub use landmarks::{LANDMARKS, Landmarks, MESH};
pub use mesh::Mesh;
pub use region::FaceBox;
pub(crate) use region::bounds;
pub use tracker::Tracker;
