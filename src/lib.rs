//! facewire: camera frames in, blendshape packets out. `ARCHITECTURE.md` shows a frame's way.

pub mod calibration;
pub mod capture;
pub mod cli;
pub mod clock;
pub mod config;
pub mod link;
mod listener;
pub mod pipeline;
pub mod playback;
pub mod recording;
mod retry;
pub mod service;
pub mod watch;

#[cfg(test)]
#[path = "../tests/common/skip.rs"]
mod skip;
