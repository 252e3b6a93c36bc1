//! Runs facewire's landmark networks.

pub mod error;
pub mod file;
pub mod graph;
pub mod reference;

pub use error::Error;
pub use graph::Graph;
