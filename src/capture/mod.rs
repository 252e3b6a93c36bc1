//! Where frames come from. The pixels stay in the camera's own format: the crop samples them directly.

mod picture;

pub use picture::{Picture, Pixels};
