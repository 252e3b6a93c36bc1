//! facewire: camera frames in, blendshape packets out.
//!
//! ```text
//! Frame -> FaceBox -> Landmarks -> Normalised -> Features -> RawCoeffs -> Corrected -> Smoothed -> Packet
//! capture  detect      mesh         affine T_a    S, T_d      R    ^       eq. 7, 8     F           link
//!                       |                                          |
//!                       +-> Appearance -> Residual ----------------+
//! ```
//!
//! One stage, one module, one type out: a stage cannot be skipped, because the next does not accept its input.
//! Equation numbers are those of the method in `ARCHITECTURE.md`.

pub mod calibration;
pub mod capture;
pub mod cli;
pub mod config;
pub mod hardware;
pub mod impairment;
pub mod link;
mod listener;
pub mod pipeline;
pub mod playback;
pub mod preflight;
pub mod recording;
mod retry;
pub mod service;
pub mod servo;
pub mod watch;

#[cfg(test)]
#[path = "../tests/common/skip.rs"]
mod skip;
