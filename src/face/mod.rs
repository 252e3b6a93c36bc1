//! Finding the face and its landmarks.

mod landmarks;

pub use landmarks::{LANDMARKS, Landmarks};
