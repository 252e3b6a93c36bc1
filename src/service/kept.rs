//! What a service keeps on the disk for its next start: whether an operator has released all servos, and the last settings that
//! were good.
//!
//! The files are in the folder of the state, which the settings do not name, so that settings with faults or with another folder
//! for profiles hide nothing. Each service has its own, which are named after its file of settings, so that several services of
//! one user do not obey each other's operators.

use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::calibration::{Store, replace_file};

const BOOT_ID: &str = "/proc/sys/kernel/random/boot_id";
/// The name of a service without a file of settings.
const DEFAULT_NAME: &str = "defaults";
/// Longest part of a path that names a file. A name on Linux has 255 bytes at most.
const LONGEST_NAME_BYTES: usize = 200;

#[derive(Debug, Clone)]
pub struct Kept {
    /// The folder, if it is not that of the state.
    folder: Option<PathBuf>,
    name: String,
}

impl Kept {
    /// What the service with this file of settings keeps.
    #[must_use]
    pub fn new(config: Option<&str>) -> Self {
        Self { folder: None, name: config.map_or(DEFAULT_NAME.to_owned(), name) }
    }

    #[cfg(test)]
    pub(super) fn inside(folder: PathBuf, config: Option<&str>) -> Self {
        Self { folder: Some(folder), ..Self::new(config) }
    }

    /// Where it is kept. This looks at the disk, which a service without servos never does.
    pub(super) fn folder(&self) -> PathBuf {
        self.folder.clone().unwrap_or_else(|| Store::new("").folder().to_owned())
    }

    /// When an operator has released all servos, if that was since the machine was started and nobody has undone it.
    #[must_use]
    pub fn released_since(&self) -> Option<SystemTime> {
        let path = self.released();
        let boot = fs::read(&path).ok()?;
        let is_of_this_boot = fs::read(BOOT_ID).is_ok_and(|now| now == boot);
        is_of_this_boot.then(|| fs::metadata(&path).and_then(|file| file.modified()).unwrap_or(UNIX_EPOCH))
    }

    /// Keeps whether an operator has released all servos, until the next start of the machine.
    pub fn keep_released(&self, is_released: bool) -> io::Result<()> {
        if is_released {
            return self.replace(&self.released(), &fs::read(BOOT_ID)?);
        }
        match fs::remove_file(self.released()) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
            _ => Ok(()),
        }
    }

    /// The text of the last settings with which this service has run.
    #[must_use]
    pub fn settings(&self) -> Option<String> {
        fs::read_to_string(self.good_settings()).ok()
    }

    /// Keeps the settings in this file, which are in force. A failure is logged.
    pub fn keep_settings_of(&self, config: &str) {
        let kept = fs::read_to_string(config).and_then(|text| self.keep_settings(&text));
        if let Err(error) = kept {
            tracing::warn!(
                "the settings are not kept ({error}): if later ones have faults, `facewire rest` cannot use these to release servos"
            );
        }
    }

    /// Keeps the text of settings that are in force, unless it is already kept.
    pub fn keep_settings(&self, text: &str) -> io::Result<()> {
        if self.settings().as_deref() == Some(text) {
            return Ok(());
        }
        self.replace(&self.good_settings(), text.as_bytes())
    }

    fn released(&self) -> PathBuf {
        self.folder().join(format!("released@{}", self.name))
    }

    fn good_settings(&self) -> PathBuf {
        self.folder().join(format!("settings@{}", self.name))
    }

    fn replace(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        DirBuilder::new().recursive(true).mode(0o700).create(self.folder())?;
        replace_file(path, bytes)
    }
}

/// The end of the absolute path, with a + in place of each slash. A link is not followed, because it may soon lead elsewhere.
fn name(config: &str) -> String {
    let path = std::path::absolute(config).unwrap_or_else(|_| config.into());
    let name = path.to_string_lossy().replace('/', "+");
    let start = name.len().saturating_sub(LONGEST_NAME_BYTES);
    let start = (start..name.len()).find(|at| name.is_char_boundary(*at)).unwrap_or(0);
    name.get(start..).unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::symlink;

    use super::*;

    #[test]
    fn each_service_keeps_its_own_release_and_settings_until_they_are_undone_or_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let [head, hand, none] = [Some("/etc/facewire/head.toml"), Some("/etc/facewire/hand.toml"), None]
            .map(|config| Kept::inside(folder.path().join("state"), config));
        for one in [&head, &none] {
            assert!(one.released_since().is_none());
            one.keep_released(true).unwrap();
            let age = one.released_since().unwrap().elapsed().unwrap_or_default();
            assert!(age.as_secs() < 60, "{age:?}");
            assert!(hand.released_since().is_none(), "another service");
            one.keep_released(false).unwrap();
            one.keep_released(false).unwrap();
            assert!(one.released_since().is_none());
        }
        head.keep_settings("log.level = \"info\"").unwrap();
        head.keep_settings("log.level = \"warn\"").unwrap();
        assert_eq!(head.settings().as_deref(), Some("log.level = \"warn\""));
        assert_eq!((hand.settings(), none.settings()), (None, None));
        let kept = fs::read_dir(folder.path().join("state")).unwrap();
        let names: Vec<_> = kept.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        assert_eq!(names, ["settings@+etc+facewire+head.toml"], "nothing else is left");
    }

    #[test]
    fn a_release_before_the_last_start_of_the_machine_is_forgotten_and_a_long_path_names_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let long = format!("/{}/ü.toml", "ä".repeat(300));
        let kept = Kept::inside(folder.path().join("state"), Some(&long));
        kept.keep_released(true).unwrap();
        assert!(kept.released_since().is_some() && kept.name.ends_with("+ü.toml"));
        fs::write(kept.released(), "another boot\n").unwrap();
        assert!(kept.released_since().is_none());
    }

    #[test]
    fn a_release_holds_although_the_file_of_the_settings_is_a_link_that_leads_elsewhere_later() {
        let folder = tempfile::tempdir().unwrap();
        let config = folder.path().join("facewire.toml");
        let kept = || Kept::inside(folder.path().join("state"), config.to_str());
        for version in ["1.toml", "2.toml"] {
            fs::write(folder.path().join(version), "").unwrap();
            let _ = fs::remove_file(&config);
            symlink(version, &config).unwrap();
            if version == "1.toml" {
                kept().keep_released(true).unwrap();
            }
            assert!(kept().released_since().is_some(), "{version}");
        }
    }
}
