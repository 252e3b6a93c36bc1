//! Calibration: guides a wearer through some poses, learns from them what is particular about the wearer, and keeps that
//! in a file.
//!
//! ```text
//! Observation (one per frame) -> Guide -> Takes -> learn -> Profile -> Store
//! ```
//!
//! [`Guide`] and what it is made of are pure: time comes with the observations. [`Store`] is the folder of the profiles.

mod guide;

mod learn;
mod observation;
mod profile_file;
mod store;
mod take;

#[cfg(test)]
pub(crate) use guide::tests as test_wearer;
pub use guide::{Calibration, Guide, Phase, Progress};
pub use observation::{Observation, Seen, Sight};
#[cfg(test)]
pub(crate) use profile_file::tests::file as test_profile;
pub use profile_file::{MAX_PROFILE_BYTES, ProfileFile, model_hash};
pub use store::{KeptProfile, Listed, Store, StoreError, WearerName};
pub use take::{Refusal, Take};
