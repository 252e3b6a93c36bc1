//! The service: camera to links, unattended.

pub mod failsafe;
