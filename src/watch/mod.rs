//! Watches picture and camera for what makes tracking poor.
//!
//! `look` measures light and face in a picture, [`Delivery`](crate::capture::Delivery) says what the camera delivers, and
//! `judge` decides from both which impairments are present. The service watches while it runs, and `facewire check` for
//! three seconds.

mod judge;
mod look;
mod steady;

pub use judge::Watch;
pub use look::{FaceLook, Light, Look};
