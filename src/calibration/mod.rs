//! Calibration: guides a wearer through some poses, learns from them what is particular about the wearer, and keeps that
//! in a file: `Observation` (one per frame) -> [`Guide`] -> `Takes` -> `learn` -> `Profile` -> [`Store`]. All but the store
//! is pure: time comes with the observations.

mod guide;
mod observation;
mod profile_file;
mod store;
mod take;

pub use facewire_packet::control::Take;
#[cfg(test)]
pub(crate) use guide::tests as test_wearer;
pub use guide::{Calibration, Guide};
pub use observation::Observation;
#[cfg(test)]
pub(crate) use profile_file::tests::file as test_profile;
pub use profile_file::{MAX_PROFILE_BYTES, ProfileFile, model_hash};
pub(crate) use store::replace_file;
pub use store::{Store, StoreError, WearerName};
pub use take::Seen;
