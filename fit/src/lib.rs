//! The workbench: renders faces with known coefficients, and fits and judges the blendshape models. It runs on a
//! desktop computer, never on the board.
//!
//! The program `facewire-fit` runs [`cli::main`]. Everything else is public for `tests/unit/`, so that the tests need no second
//! build of it.

#![allow(clippy::len_without_is_empty, reason = "nobody asks whether a fit has no face")]
#![allow(clippy::indexing_slicing, reason = "an index out of range is a bug, and a panic shows where")]

pub mod appearance;
pub mod arrays;
pub mod cli;
pub mod compare;
pub mod curves;
pub mod dataset;
pub mod design;
pub mod drawing;
pub mod evaluate;
pub mod faces;
pub mod gaze;
pub mod judge;
pub mod kinds;
pub mod network;
pub mod output;
pub mod paper;
pub mod recording;
pub mod report;
pub mod segments;
pub mod shapes;
pub mod statistics;
pub mod synth;
pub mod train;
pub mod tune;
pub mod wearers;
