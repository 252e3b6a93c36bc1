//! Runs facewire's landmark networks.

mod arena;
pub mod error;
pub mod file;
#[cfg(test)]
mod file_tests;
mod fusion;
pub mod graph;
#[allow(unsafe_code, reason = "the intrinsics of processors, and loops without checks")]
pub mod kernels;
mod network;
#[cfg(test)]
mod network_tests;
mod pack;
pub mod peak;
pub mod reference;
mod schedule;
#[allow(unsafe_code, reason = "threads that borrow the tasks of a call")]
mod team;
#[cfg(test)]
mod testing;
mod values;

pub use error::Error;
pub use graph::{Graph, Shape};
pub use kernels::Kernels;
pub use network::Network;
pub use team::Team;
pub use values::Values;
