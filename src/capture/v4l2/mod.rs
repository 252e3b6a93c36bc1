//! Cameras of the kernel's `Video4Linux2` interface.
//!
//! `probe` lists the cameras, `select` decides which of them to try for a setting, `mode` chooses among the modes that a
//! camera offers, and `stream` waits for the newest buffer, whose pixels [`CameraSource`] checks and keeps.
//!
//! Contract: every error except a damaged frame ends the source, which must then be closed and opened again. Unplugged
//! cameras and faulty drivers cause errors, never panics.
//!
//! Limits: single-planar capture in YUYV, NV12, GREY and Motion-JPEG.

mod camera;
mod layout;
mod mode;
mod probe;
mod select;
mod stream;

pub use camera::CameraSource;
pub use layout::{Layout, Store};
pub use mode::{PixelFormat, Wish};
pub use probe::{Camera, Found, cameras};
