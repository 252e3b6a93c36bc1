//! The folder of the wearers' profiles: `NAME.toml` for each wearer.
//!
//! A file is replaced whole or not at all: the new one is written beside it, brought to the disk, and renamed. Only the
//! user of the service may read the folder, because a profile holds the shape of a face.

use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _, fchown};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::name::WearerName;
use super::profile_file::{MAX_PROFILE_BYTES, ProfileError, ProfileFile};

/// Where the service manager puts the state of services.
const SYSTEM_FOLDER: &str = "/var/lib/facewire";

/// Why a profile cannot be used or kept. Displays as one sentence that names the file and the remedy.
#[derive(Debug, Error)]
pub enum StoreError {
    /// There is no profile of this wearer.
    #[error("there is no profile {}: run `facewire calibrate --wearer {name}`", path.display())]
    Missing {
        /// The file that was looked for.
        path: PathBuf,
        /// The wearer.
        name: WearerName,
    },
    /// The file or the folder cannot be read.
    #[error("cannot read {}: {source}; {}", path.display(), remedy(source))]
    Unreadable {
        /// The file or folder.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// The file is no profile.
    #[error("{}: {error}; run `facewire calibrate --wearer {name}` to replace it", path.display())]
    Bad {
        /// The file.
        path: PathBuf,
        /// The wearer.
        name: WearerName,
        /// What is wrong with it.
        error: ProfileError,
    },
    /// The profile cannot be written. The former one is unchanged.
    #[error("cannot write {}: {source}; {}; the former profile stays", path.display(), remedy(source))]
    Unwritable {
        /// The file or folder.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
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
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Store {
    folder: PathBuf,
}

impl Store {
    /// The folder of the settings, or if that is empty the usual one.
    #[must_use]
    pub fn new(setting: &str) -> Self {
        let is_readable = |path: &Path| fs::read_dir(path).is_ok();
        Self { folder: folder(setting, |name| std::env::var(name).ok(), is_readable) }
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn path(&self, name: &WearerName) -> PathBuf {
        self.folder.join(format!("{name}.toml"))
    }

    /// Reads the profile of a wearer.
    ///
    /// # Errors
    /// [`StoreError::Missing`], [`StoreError::Unreadable`] or [`StoreError::Bad`].
    pub fn load(&self, name: &WearerName) -> Result<ProfileFile, StoreError> {
        let path = self.path(name);
        let bad = |error| StoreError::Bad { path: path.clone(), name: name.clone(), error };
        let bytes = match read(&path) {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == ErrorKind::NotFound => {
                return Err(StoreError::Missing { path, name: name.clone() });
            }
            Err(source) => return Err(StoreError::Unreadable { path, source }),
        };
        let text = str::from_utf8(&bytes).map_err(|_| bad(ProfileError::Damaged("it is not UTF-8".to_owned())))?;
        ProfileFile::parse(text).map_err(bad)
    }

    /// Keeps the profile of a wearer, in place of the former one. Returns the path of the file.
    ///
    /// # Errors
    /// [`StoreError::Unwritable`]; the former profile is unchanged, unless only the folder could not be synchronised.
    pub fn save(&self, name: &WearerName, file: &ProfileFile) -> Result<PathBuf, StoreError> {
        let refuse = |path: &Path, source| StoreError::Unwritable { path: path.to_owned(), source };
        DirBuilder::new().recursive(true).mode(0o700).create(&self.folder).map_err(|e| refuse(&self.folder, e))?;
        let (path, new) = (self.path(name), self.folder.join(format!(".{name}.new")));
        let outcome = write(&new, file.text().as_bytes()).and_then(|()| fs::rename(&new, &path));
        if let Err(error) = outcome {
            // What is left of it is of no use; the next attempt writes it anew.
            let _ = fs::remove_file(&new);
            return Err(refuse(&path, error));
        }
        // Without this, a power cut could bring the former profile back.
        File::open(&self.folder).and_then(|folder| folder.sync_all()).map_err(|error| refuse(&self.folder, error))?;
        Ok(path)
    }

    /// Deletes the profile of a wearer.
    ///
    /// # Errors
    /// [`StoreError::Missing`] or [`StoreError::Unwritable`].
    pub fn delete(&self, name: &WearerName) -> Result<(), StoreError> {
        let path = self.path(name);
        // A power cut may have left this.
        let _ = fs::remove_file(self.folder.join(format!(".{name}.new")));
        fs::remove_file(&path).map_err(|source| match source.kind() {
            ErrorKind::NotFound => StoreError::Missing { path, name: name.clone() },
            _ => StoreError::Unwritable { path, source },
        })
    }

    /// The wearers who have a profile, in alphabetical order. A folder that does not exist yet holds none.
    ///
    /// # Errors
    /// [`StoreError::Unreadable`].
    pub fn wearers(&self) -> Result<Vec<WearerName>, StoreError> {
        let entries = match fs::read_dir(&self.folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            Err(source) => return Err(StoreError::Unreadable { path: self.folder.clone(), source }),
        };
        let name = |entry: fs::DirEntry| WearerName::new(entry.file_name().to_str()?.strip_suffix(".toml")?);
        let mut names: Vec<_> = entries.filter_map(|entry| name(entry.ok()?)).collect();
        names.sort();
        Ok(names)
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

/// Writes a new file to the disk.
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
#[allow(clippy::unwrap_used)]
mod tests;
