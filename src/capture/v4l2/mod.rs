//! Cameras of the kernel's `Video4Linux2` interface.
//!
//! Flow: `probe` lists the cameras, `select` finds the one a setting means, `mode` picks from the camera's own
//! list, `stream` waits for the newest buffer, and [`CameraSource`] checks it and keeps its pixels.
//!
//! Contract: any error but a damaged frame ends the source; drop it and open it again. Nothing here panics when a
//! camera is pulled out or its driver gives nonsense (`guard`). Limits: single-planar capture in YUYV, NV12, GREY and Motion-JPEG.

mod camera;
mod guard;
mod layout;
mod mode;
mod probe;
mod select;
mod stream;

pub use camera::CameraSource;
pub use layout::{Layout, Store};
pub use mode::{Choice, Mode, PixelFormat, Rates, Steps, Wish, choose};
pub use probe::{Camera, Found, cameras};
