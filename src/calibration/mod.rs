//! Calibration: guides a wearer through some poses, learns from them what is particular about the wearer, and keeps that
//! in a file.
//!
//! ```text
//! Observation (one per frame) -> Guide -> Takes -> learn -> Profile -> Store
//! ```
//!
//! [`Guide`] and what it is made of are pure: time comes with the observations. [`Store`] is the folder of the profiles.

mod doubt;
mod guide;
mod hold;
mod learn;
mod name;
mod observation;
mod profile_file;
mod progress;
mod refusal;
mod report;
mod store;
mod take;
#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing)]
pub(crate) mod test_wearer;
mod view;

pub use guide::{Calibration, Guide};
pub use name::WearerName;
pub use observation::{Observation, Seen, Sight};
pub use profile_file::{MAX_PROFILE_BYTES, ProfileError, ProfileFile};
pub use progress::{Phase, Progress};
pub use refusal::Refusal;
pub use report::{Listed, Report};
pub use store::{Store, StoreError};
pub use take::Take;
