//! What a calibration, or a look at the folder, tells the user.

use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::guide::Calibration;
use super::name::WearerName;
use super::profile_file::ProfileFile;
use super::refusal::Refusal;
use super::store::{Store, StoreError};
use super::take::Take;

/// A calibration whose profile was kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    /// The wearer.
    pub wearer: String,
    /// The file of the profile.
    pub path: String,
    /// The takes that were accepted.
    pub taken: Vec<Take>,
    /// The poses that were left out, and why.
    pub left_out: Vec<(Take, Refusal)>,
    /// Number of refused takes.
    pub refused: u32,
}

/// A wearer who has a profile.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Listed {
    /// The wearer.
    pub wearer: String,
    /// When the profile was made, seconds since 1970, and how many takes it holds; or why it cannot be used.
    pub profile: Result<(u64, usize), String>,
}

impl Store {
    /// Keeps what a calibration has found.
    ///
    /// # Errors
    /// Those of [`Store::save`].
    pub fn keep(&self, name: &WearerName, calibration: Calibration) -> Result<Report, StoreError> {
        let Calibration { profile, taken, left_out, refused } = calibration;
        let made_at_unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs());
        let path = self.save(name, &ProfileFile { profile, takes: taken.clone(), made_at_unix_s })?;
        Ok(Report { wearer: name.to_string(), path: path.display().to_string(), taken, left_out, refused })
    }

    /// The wearers who have a profile, and what is in it.
    ///
    /// # Errors
    /// Those of [`Store::wearers`].
    pub fn list(&self) -> Result<Vec<Listed>, StoreError> {
        let listed = |name: &WearerName| {
            let profile = self.load(name).map(|file| (file.made_at_unix_s, file.takes.len()));
            Listed { wearer: name.to_string(), profile: profile.map_err(|error| error.to_string()) }
        };
        Ok(self.wearers()?.iter().map(listed).collect())
    }
}
