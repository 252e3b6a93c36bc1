//! The promises that the fuzz targets check. Each target is one function, which takes any bytes and panics if the code that
//! reads them breaks its promise.
//!
//! cargo-fuzz calls the functions with bytes that it generates. `tests/fuzz_corpus.rs` calls them with the files of the
//! corpus.

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
mod profile_file;
mod receiver;
mod recording;
mod subscription;
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
pub use profile_file::profile_file;
pub use receiver::receiver;
pub use recording::recording;
pub use subscription::subscription;
pub use y4m::y4m;
