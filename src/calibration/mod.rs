//! Calibration: guides a wearer through some poses, learns from them what is particular about the wearer, and keeps that
//! in a file: `Observation` (one per frame) -> [`Guide`] -> `Takes` -> `learn` -> `Profile` -> [`Store`]. All but the store
//! is pure: time comes with the observations.

use facewire_face::Model;
pub use facewire_face::stages::MAX_PROFILE_BYTES;
use flate2::Crc;

mod guide;
mod observation;
mod store;
mod take;

pub use facewire_packet::control::Take;
#[cfg(test)]
pub(crate) use guide::tests as test_wearer;
pub use guide::{Calibration, Guide};
pub use observation::Observation;
pub(crate) use store::replace_file;
#[cfg(test)]
pub(crate) use store::tests::file as test_profile;
pub use store::{Store, StoreError, WearerName};
pub use take::Seen;

/// A wearer's profile, and how it was made.
pub type ProfileFile = facewire_face::stages::ProfileFile<Take>;

/// The hash of all numbers of a model, which tells whether a profile was made with it.
pub fn model_hash(model: &Model) -> u32 {
    let mut crc = Crc::new();
    crc.update(&model.to_bytes());
    crc.sum()
}
