//! The folder of the wearers' profiles: `NAME.toml` for each wearer.
//!
//! A file is replaced whole or not at all: the new one is written beside it, brought to the disk, and renamed. Only the
//! user of the service may read the folder, because a profile holds the shape of a face.

use std::fmt;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _, fchown};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::guide::Calibration;
use super::profile_file::{MAX_PROFILE_BYTES, ProfileFile};
use super::take::{Refusal, Take};

/// Where the service manager puts the state of services.
const SYSTEM_FOLDER: &str = "/var/lib/facewire";

const MAX_LENGTH: usize = 32;

/// The name of a wearer, which is also that of a file: 1 to 32 letters, digits, `-` and `_` of ASCII.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct WearerName(String);

impl WearerName {
    /// What a name may be; the text follows "give".
    pub const EXPECTED: &'static str = "1 to 32 letters, digits, - or _";

    /// Reads a name. `None` if it is too long, or has characters that a name may not have.
    pub fn new(text: &str) -> Option<Self> {
        let is_sane = text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-');
        // A name that begins with - would be taken for an option.
        let is_good = is_sane && (1..=MAX_LENGTH).contains(&text.len()) && !text.starts_with('-');
        is_good.then(|| Self(text.to_owned()))
    }

    pub fn parse(text: &str) -> Result<Self, String> {
        Self::new(text).ok_or_else(|| format!("give {}", Self::EXPECTED))
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for WearerName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A calibration whose profile was kept.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Report {
    pub wearer: String,
    pub path: String,
    pub taken: Vec<Take>,
    /// The poses that were left out, and why.
    pub left_out: Vec<(Take, Refusal)>,
    pub refused: u32,
    /// What is not as it should be, although the profile is in place.
    #[serde(default)]
    pub warning: Option<String>,
}

/// A wearer who has a profile.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Listed {
    pub wearer: String,
    /// When the profile was made, seconds since 1970, and how many takes it holds; or why it cannot be used.
    pub profile: Result<(u64, usize), String>,
}

/// Why a profile cannot be used or kept: one sentence that names the file and the remedy.
#[derive(Debug, Error)]
pub enum StoreError {
    #[error("{0}")]
    Missing(String),
    #[error("{0}")]
    Unreadable(String),
    #[error("{0}")]
    Bad(String),
    /// The former profile is unchanged.
    #[error("{0}")]
    Unwritable(String),
}

impl StoreError {
    fn missing(path: &Path, name: &WearerName) -> Self {
        Self::Missing(format!("there is no profile {}: run `facewire calibrate --wearer {name}`", path.display()))
    }

    fn unreadable(path: &Path, error: &io::Error) -> Self {
        Self::Unreadable(format!("cannot read {}: {error}; {}", path.display(), remedy(error)))
    }

    fn unwritable(path: &Path, error: &io::Error) -> Self {
        let (path, remedy) = (path.display(), remedy(error));
        Self::Unwritable(format!("cannot write {path}: {error}; {remedy}; the former profile stays"))
    }
}

fn remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => "free some space",
        ErrorKind::PermissionDenied => "try again with sudo, or set wearer.folder to a folder of your own",
        ErrorKind::ReadOnlyFilesystem => "set wearer.folder to a folder that can be written",
        _ => "check wearer.folder and the disk",
    }
}

/// The folder of the profiles.
pub struct Store {
    folder: PathBuf,
    /// Brings the entries of the folder to the disk. Tests let it fail.
    sync_folder: fn(&Path) -> io::Result<()>,
}

impl Store {
    /// The folder of the settings, or if that is empty the usual one.
    pub fn new(setting: &str) -> Self {
        let is_readable = |path: &Path| fs::read_dir(path).is_ok();
        let folder = folder(setting, |name| std::env::var(name).ok(), is_readable);
        Self { folder, sync_folder: |folder| File::open(folder)?.sync_all() }
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn path(&self, name: &WearerName) -> PathBuf {
        self.folder.join(format!("{name}.toml"))
    }

    pub fn load(&self, name: &WearerName) -> Result<ProfileFile, StoreError> {
        let path = self.path(name);
        let bytes = read(&path).map_err(|error| match error.kind() {
            ErrorKind::NotFound => StoreError::missing(&path, name),
            _ => StoreError::unreadable(&path, &error),
        })?;
        let text = str::from_utf8(&bytes).map_err(|_| "it is damaged: it is not UTF-8".to_owned());
        text.and_then(ProfileFile::parse).map_err(|error| {
            let path = path.display();
            StoreError::Bad(format!("{path}: {error}; run `facewire calibrate --wearer {name}` to replace it"))
        })
    }

    /// Keeps the profile of a wearer, in place of the former one. Returns the path of the file, and a warning if a power cut
    /// could bring the former profile back.
    pub fn save(&self, name: &WearerName, file: &ProfileFile) -> Result<(PathBuf, Option<String>), StoreError> {
        let refuse = |error| StoreError::unwritable(&self.folder, &error);
        DirBuilder::new().recursive(true).mode(0o700).create(&self.folder).map_err(refuse)?;
        let (path, new) = (self.path(name), self.folder.join(format!(".{name}.new")));
        let outcome = write(&new, file.text().as_bytes()).and_then(|()| fs::rename(&new, &path));
        if let Err(error) = outcome {
            // What is left of it is of no use; the next attempt writes it anew.
            let _ = fs::remove_file(&new);
            return Err(StoreError::unwritable(&path, &error));
        }
        let warning = |error| {
            let folder = self.folder.display();
            format!("the new profile is in use, but the disk did not confirm it ({folder}: {error}): check the disk")
        };
        Ok((path, (self.sync_folder)(&self.folder).err().map(warning)))
    }

    pub fn keep(&self, name: &WearerName, calibration: Calibration) -> Result<Report, StoreError> {
        let Calibration { profile, model, taken, left_out, refused } = calibration;
        let made_at_unix_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs());
        let file = ProfileFile { profile, model: Some(model), takes: taken.clone(), made_at_unix_s };
        let (path, warning) = self.save(name, &file)?;
        Ok(Report { wearer: name.to_string(), path: path.display().to_string(), taken, left_out, refused, warning })
    }

    pub fn delete(&self, name: &WearerName) -> Result<(), StoreError> {
        let path = self.path(name);
        // A power cut may have left this.
        let _ = fs::remove_file(self.folder.join(format!(".{name}.new")));
        fs::remove_file(&path).map_err(|error| match error.kind() {
            ErrorKind::NotFound => StoreError::missing(&path, name),
            _ => StoreError::unwritable(&path, &error),
        })
    }

    /// The wearers who have a profile, in alphabetical order. A folder that does not exist yet holds none.
    pub fn wearers(&self) -> Result<Vec<WearerName>, StoreError> {
        let entries = match fs::read_dir(&self.folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(StoreError::unreadable(&self.folder, &error)),
        };
        let name = |entry: fs::DirEntry| WearerName::new(entry.file_name().to_str()?.strip_suffix(".toml")?);
        let mut names: Vec<_> = entries.filter_map(|entry| name(entry.ok()?)).collect();
        names.sort();
        Ok(names)
    }

    /// The wearers who have a profile, and what is in it.
    pub fn list(&self) -> Result<Vec<Listed>, StoreError> {
        let listed = |name: &WearerName| {
            let profile = self.load(name).map(|file| (file.made_at_unix_s, file.takes.len()));
            Listed { wearer: name.to_string(), profile: profile.map_err(|error| error.to_string()) }
        };
        Ok(self.wearers()?.iter().map(listed).collect())
    }
}

/// Reads a file, but not more than shows that it is too large.
fn read(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(MAX_PROFILE_BYTES + 1);
    // Another process may have put something there that is no file, such as a pipe, which would never end.
    let flags = rustix::fs::OFlags::NONBLOCK.bits().cast_signed();
    let file = OpenOptions::new().read(true).custom_flags(flags).open(path)?;
    file.take(MAX_PROFILE_BYTES as u64 + 1).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let _ = fs::remove_file(path);
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?;
    if let Some(folder) = path.parent() {
        let owner = fs::metadata(folder)?;
        // If root calibrates, the service must be able to read the file all the same. Others own their folder.
        let _ = fchown(&file, Some(owner.uid()), Some(owner.gid()));
    }
    file.write_all(bytes)?;
    file.sync_all()
}

/// The folder of the profiles, given the setting, the environment, and which folders can be read.
fn folder(setting: &str, variable: impl Fn(&str) -> Option<String>, is_readable: impl Fn(&Path) -> bool) -> PathBuf {
    let path = |name: &str| variable(name).filter(|path| path.starts_with('/')).map(PathBuf::from);
    if !setting.is_empty() {
        return setting.into();
    }
    // The service manager may give several folders.
    if let Some(state) = variable("STATE_DIRECTORY").and_then(|folders| folders.split(':').next().map(PathBuf::from)) {
        return state;
    }
    let of_user = path("XDG_STATE_HOME").or_else(|| path("HOME").map(|home| home.join(".local/state")));
    match of_user {
        Some(state) if !is_readable(SYSTEM_FOLDER.as_ref()) => state.join("facewire"),
        _ => SYSTEM_FOLDER.into(),
    }
}

#[cfg(test)]
mod tests;
