//! What each fuzz target promises of any bytes: one function a target, which panics where the promise is broken.
//!
//! cargo-fuzz runs them on bytes it makes up; `tests/fuzz_corpus.rs` runs them on the kept ones.

mod avi;
mod cobs_stream;
mod configuration;
mod film;
mod frame_intake;
mod input;
mod model_file;
mod network;
mod network_file;
mod packet;
mod wire;
mod y4m;

pub use avi::avi;
pub use cobs_stream::cobs_stream;
pub use configuration::configuration;
pub use frame_intake::frame_intake;
pub use model_file::model_file;
pub use network::network;
pub use network_file::network_file;
pub use packet::packet;
pub use y4m::y4m;
