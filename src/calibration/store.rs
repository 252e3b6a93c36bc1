//! The folder of the wearers' profiles: `NAME.toml` for each wearer.
//!
//! A file is replaced whole or not at all: the new one is written beside it, brought to the disk, and renamed. Only the
//! user of the service may read the folder, because a profile holds the shape of a face.

use std::fmt;
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _, fchown};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use facewire_face::Wears;
use facewire_packet::control::{KeptProfile, Listed};
use thiserror::Error;

use super::guide::Calibration;
use super::{MAX_PROFILE_BYTES, ProfileFile};
use crate::clock::seconds_since_1970;

/// Where the service manager puts the state of services.
const SYSTEM_FOLDER: &str = "/var/lib/facewire";

/// The name of a wearer, which is also that of a file: 1 to 32 letters, digits, `-` and `_` of ASCII.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct WearerName(String);

impl WearerName {
    pub const EXPECTED: &'static str = "1 to 32 letters, digits, - or _";

    pub fn new(text: &str) -> Option<Self> {
        let is_sane = text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_' || byte == b'-');
        // A name that begins with - would be taken for an option.
        (is_sane && (1..=32).contains(&text.len()) && !text.starts_with('-')).then(|| Self(text.to_owned()))
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

/// Why a profile cannot be used or kept: one sentence that names the file and the remedy.
#[derive(Debug, Error)]
pub enum StoreError {
    #[error("{0}")]
    Unreadable(String),
    #[error("{0}")]
    Bad(String),
    #[error("{0}")]
    Unwritable(String),
}

fn unreadable(path: &Path, error: &io::Error) -> StoreError {
    let wearer = path.file_stem().unwrap_or_default().display();
    let path = path.display();
    StoreError::Unreadable(match error.kind() {
        ErrorKind::NotFound => format!("there is no profile {path}: run `facewire calibrate --wearer {wearer}`"),
        _ => format!("cannot read {path}: {error}; {}", remedy(error)),
    })
}

fn unwritable(path: &Path, error: &io::Error) -> StoreError {
    let path = path.display();
    let remedy = remedy(error);
    StoreError::Unwritable(format!("cannot write {path}: {error}; {remedy}; any former profile stays"))
}

fn remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge => "free some space",
        ErrorKind::PermissionDenied => "try again with sudo, or set wearer.folder to a folder of your own",
        ErrorKind::ReadOnlyFilesystem => "set wearer.folder to a folder that can be written",
        _ => "check wearer.folder and the disk",
    }
}

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
        let bytes = read(&path).map_err(|error| unreadable(&path, &error))?;
        let text = str::from_utf8(&bytes).map_err(|_| "it is damaged: it is not UTF-8".to_owned());
        text.and_then(ProfileFile::parse).map_err(|error| {
            let path = path.display();
            StoreError::Bad(format!("{path}: {error}; run `facewire calibrate --wearer {name}` to replace it"))
        })
    }

    /// Keeps the profile of a wearer, in place of the former one. Returns the path of the file, and a warning if a power
    /// cut could bring the former profile back.
    pub fn save(&self, name: &WearerName, file: &ProfileFile) -> Result<(PathBuf, Option<String>), StoreError> {
        let create = DirBuilder::new().recursive(true).mode(0o700).create(&self.folder);
        create.map_err(|error| unwritable(&self.folder, &error))?;
        let path = self.path(name);
        replace_file(&path, file.text().as_bytes()).map_err(|error| unwritable(&path, &error))?;
        let warning = |error| {
            let folder = self.folder.display();
            format!("the new profile is in use, but the disk did not confirm it ({folder}: {error}): check the disk")
        };
        Ok((path, (self.sync_folder)(&self.folder).err().map(warning)))
    }

    /// Why a calibration of this wearer, with `wears` on, would replace a profile that was made with something else on; `None` if
    /// it would not.
    pub fn why_not_replace(&self, name: &WearerName, wears: Wears) -> Option<String> {
        let made = self.load(name).ok()?.profile.wears;
        if made == wears {
            return None;
        }
        let [made, now] = [made, wears].map(Wears::name);
        let stem = ["-headset", "-mask"].into_iter().fold(name.as_str(), |stem, ending| stem.trim_end_matches(ending));
        let other = if wears == Wears::Nothing { stem.to_owned() } else { format!("{stem}-{now}") };
        let example = WearerName::new(&other).filter(|other| other != name);
        let example = example.map_or_else(String::new, |other| format!(", such as {other}"));
        Some(format!(
            "the profile of {name} was made with wearer.wears = \"{made}\", but the setting is now \"{now}\": to keep that profile, \
             choose another name{example}; otherwise delete it first"
        ))
    }

    pub fn keep(&self, name: &WearerName, calibration: Calibration) -> Result<KeptProfile, StoreError> {
        let Calibration { profile, model, taken, left_out, refused } = calibration;
        if let Some(why) = self.why_not_replace(name, profile.wears) {
            return Err(StoreError::Unwritable(why));
        }
        let made_at_unix_s = seconds_since_1970(SystemTime::now());
        let file = ProfileFile { profile, model: Some(model), takes: taken.clone(), made_at_unix_s };
        let (path, warning) = self.save(name, &file)?;
        let wearer = name.to_string();
        let path = path.display().to_string();
        Ok(KeptProfile { wearer, path, taken, left_out, refused, warning })
    }

    pub fn delete(&self, name: &WearerName) -> Result<(), StoreError> {
        let path = self.path(name);
        // A power cut may have left this.
        let _ = fs::remove_file(new_file(&path));
        fs::remove_file(&path).map_err(|error| match error.kind() {
            ErrorKind::NotFound => unreadable(&path, &error),
            _ => unwritable(&path, &error),
        })
    }

    /// The wearers who have a profile, in alphabetical order. A folder that does not exist yet holds none.
    pub fn list(&self) -> Result<Vec<Listed>, StoreError> {
        let entries = match fs::read_dir(&self.folder) {
            Ok(entries) => entries,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(unreadable(&self.folder, &error)),
        };
        let listed = |entry: fs::DirEntry| {
            let name = WearerName::new(entry.file_name().to_str()?.strip_suffix(".toml")?)?;
            let profile = self.load(&name).map(|file| (file.made_at_unix_s, file.takes.len()));
            Some(Listed { wearer: name.0, profile: profile.map_err(|error| error.to_string()) })
        };
        let mut listed: Vec<_> = entries.filter_map(|entry| listed(entry.ok()?)).collect();
        listed.sort_by(|one, other| one.wearer.cmp(&other.wearer));
        Ok(listed)
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

/// Writes a file whole, in place of the former one, or leaves that as it is.
pub(crate) fn replace_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let new = new_file(path);
    let written = write(&new, bytes).and_then(|()| fs::rename(&new, path));
    // What is left of it is of no use; the next attempt writes it anew.
    written.inspect_err(|_| drop(fs::remove_file(&new)))
}

/// The hidden file that is written before it takes the place of this one.
fn new_file(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{stem}.new"))
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
    // The service manager may give several folders.
    let of_manager = || variable("STATE_DIRECTORY")?.split(':').next().map(PathBuf::from);
    let of_user = || path("XDG_STATE_HOME").or_else(|| path("HOME").map(|home| home.join(".local/state")));
    let is_system = is_readable(SYSTEM_FOLDER.as_ref());
    match Some(setting).filter(|setting| !setting.is_empty()).map(PathBuf::from).or_else(of_manager) {
        Some(folder) => folder,
        None => of_user().filter(|_| !is_system).map_or_else(|| SYSTEM_FOLDER.into(), |state| state.join("facewire")),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use std::{os::unix::fs::PermissionsExt as _, process::Command};

    use facewire_face::stages::normalise;
    use facewire_face::testing::face;
    use facewire_face::{Neutral, Profile};

    use super::super::Take;
    use super::*;

    /// A profile of a face of few points, which was made at this time.
    pub(crate) fn file(made_at_unix_s: u64) -> ProfileFile {
        let face = normalise(&face([0.0; 3], 80.0, [320.0, 240.0])).unwrap();
        let mut profile = Profile::from(Neutral::from_points(&face.points).unwrap());
        profile.rest.fill(-0.2125);
        profile.gain.fill(1.25);
        let takes = vec![Take::Neutral, Take::EyesShut];
        let file = ProfileFile { profile, model: Some(0xA1), takes, made_at_unix_s };
        // Rounded once, it stays the same.
        ProfileFile::parse(&file.text()).unwrap()
    }

    fn store() -> (tempfile::TempDir, Store, [WearerName; 2]) {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::new(folder.path().join("facewire").to_str().unwrap());
        (folder, store, ["anna", "bert"].map(|name| WearerName::new(name).unwrap()))
    }

    /// What the folder holds, hidden files included.
    fn content(store: &Store) -> Vec<String> {
        let entries = fs::read_dir(store.folder()).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn profiles_of_two_wearers_are_kept_apart_listed_and_deleted_and_nobody_else_can_read_them() {
        let (_folder, store, [anna, bert]) = store();
        assert_eq!(store.list().unwrap(), []);
        store.save(&bert, &file(1)).unwrap();
        // An interrupted attempt has left this.
        fs::write(store.folder().join(".anna.new"), "half a prof").unwrap();
        store.save(&anna, &file(2)).unwrap();
        let path = store.save(&anna, &file(3)).unwrap().0;
        let listed = |wearer: &str, made_s| Listed { wearer: wearer.to_owned(), profile: Ok((made_s, 2)) };
        assert_eq!(store.list().unwrap(), [listed("anna", 3), listed("bert", 1)]);
        assert_eq!([&anna, &bert].map(|name| store.load(name).unwrap()), [file(3), file(1)]);
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!([mode(store.folder()), mode(&path)], [0o700, 0o600]);
        store.delete(&anna).unwrap();
        let missing =
            [store.load(&anna).map(drop), store.delete(&anna)].map(|outcome| outcome.unwrap_err().to_string());
        assert!(missing.iter().all(|error| error.contains("there is no profile")), "{missing:?}");
        assert_eq!(content(&store), ["bert.toml"]);
    }

    #[test]
    fn a_profile_made_with_something_else_on_is_not_replaced() {
        let (_folder, store, [anna, bert]) = store();
        store.save(&anna, &file(1)).unwrap();
        let why = store.why_not_replace(&anna, Wears::Headset).unwrap();
        assert!(why.contains("\"nothing\"") && why.contains("such as anna-headset;"), "{why}");
        assert!(store.why_not_replace(&anna, Wears::Mask).is_some());
        assert_eq!([&anna, &bert].map(|name| store.why_not_replace(name, Wears::Nothing)), [None, None]);
        assert_eq!(store.why_not_replace(&bert, Wears::Headset), None, "bert has no profile to lose");
        let mut headset = file(2);
        headset.profile.wears = Wears::Headset;
        let anna_headset = WearerName::new("anna-headset").unwrap();
        store.save(&anna_headset, &headset).unwrap();
        assert!(store.why_not_replace(&anna_headset, Wears::Nothing).unwrap().contains("such as anna;"));
        assert!(store.why_not_replace(&anna_headset, Wears::Mask).unwrap().contains("such as anna-mask;"));
        let long = WearerName::new("a-name-of-twenty-nine-letters").unwrap();
        store.save(&long, &file(3)).unwrap();
        assert!(store.why_not_replace(&long, Wears::Headset).unwrap().contains("choose another name; otherwise"));
        let kept = store.keep(&anna, Calibration { profile: headset.profile, ..Calibration::default() });
        assert!(kept.unwrap_err().to_string().contains("to keep that profile"));
        assert_eq!(store.load(&anna).unwrap(), file(1));
    }

    #[test]
    fn what_is_no_profile_is_told_with_its_file_and_the_remedy() {
        let (_folder, store, [anna, bert]) = store();
        let path = store.save(&anna, &file(1)).unwrap().0;
        for damaged in [&b"format = 1"[..], b"\xff\xfe", &b" ".repeat(1 << 20)] {
            fs::write(&path, damaged).unwrap();
            let error = store.load(&anna).unwrap_err().to_string();
            assert!(error.starts_with(path.to_str().unwrap()), "{error}");
            assert!(error.contains("facewire calibrate --wearer anna"), "{error}");
        }
        fs::remove_file(&path).unwrap();
        fs::create_dir_all(&path).unwrap();
        assert!(matches!(store.load(&anna), Err(StoreError::Unreadable(_))));
        assert!(matches!(store.save(&anna, &file(1)), Err(StoreError::Unwritable(_))));
        assert_eq!(content(&store), ["anna.toml"], "nothing is left behind");
        assert!(Command::new("mkfifo").arg(store.folder().join("bert.toml")).status().unwrap().success());
        assert!(matches!(store.load(&bert), Err(StoreError::Bad(_))), "a pipe");
    }

    #[test]
    fn folder_that_cannot_be_synced_does_not_hide_that_the_new_profile_is_in_place() {
        let (_folder, mut store, [anna, _]) = store();
        store.save(&anna, &file(1)).unwrap();
        store.sync_folder = |_| Err(io::Error::other("no answer"));
        let (path, warning) = store.save(&anna, &file(2)).unwrap();
        assert!(warning.is_some_and(|warning| warning.contains("no answer") && warning.contains("check the disk")));
        assert!(path.exists());
        assert_eq!(store.load(&anna).unwrap(), file(2));
    }

    /// The folder in which `full_disk_leaves_the_former_profile` lets a process with a limit on the size of files write.
    const LIMITED: &str = "FACEWIRE_TEST_LIMITED_FOLDER";

    #[test]
    fn full_disk_leaves_the_former_profile() {
        if let Ok(folder) = std::env::var(LIMITED) {
            let error = Store::new(&folder).save(&WearerName::new("anna").unwrap(), &file(2)).unwrap_err().to_string();
            assert!(error.contains("anna.toml") && error.contains("free some space"), "{error}");
            return;
        }
        let (_folder, store, [anna, _]) = store();
        store.save(&anna, &file(1)).unwrap();
        // A write beyond the limit fails like one to a full disk, and after some of it has been written.
        let test = "calibration::store::tests::full_disk_leaves_the_former_profile";
        let script = format!("trap '' XFSZ; ulimit -f 8; exec \"$0\" --exact {test} --nocapture");
        let mut child = Command::new("sh");
        child.args(["-c", &script]).arg(std::env::current_exe().unwrap()).env(LIMITED, store.folder());
        let output = child.output().unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && said.contains("1 passed"), "{output:?}");
        assert_eq!(store.load(&anna).unwrap(), file(1));
        assert_eq!(content(&store), ["anna.toml"]);
    }

    #[test]
    fn folder_is_that_of_the_settings_the_manager_the_system_or_the_user() {
        let home = ("HOME", "/home/a");
        let cases: [(_, &[(&str, &str)], _, _); 5] = [
            ("/data", &[("STATE_DIRECTORY", "/var/lib/x")], true, "/data"),
            ("", &[("STATE_DIRECTORY", "/var/lib/x:/var/lib/y"), home], true, "/var/lib/x"),
            ("", &[home], true, "/var/lib/facewire"),
            ("", &[home, ("XDG_STATE_HOME", "/state")], false, "/state/facewire"),
            ("", &[home, ("XDG_STATE_HOME", "relative")], false, "/home/a/.local/state/facewire"),
        ];
        for (setting, variables, is_readable, want) in cases {
            let variable =
                |name: &str| variables.iter().find(|(known, _)| *known == name).map(|(_, v)| (*v).to_owned());
            assert_eq!(folder(setting, variable, |_| is_readable), Path::new(want), "{variables:?}");
        }
    }

    #[test]
    fn names_that_could_be_paths_options_or_hidden_files_are_refused() {
        for bad in ["", ".", "..", "a/b", "../a", ".a", "-a", "a b", "a\n", "a\0", "é", "a.toml", &"a".repeat(33)] {
            assert_eq!(WearerName::new(bad), None, "{bad:?}");
        }
        assert!(["anna", "Anna-2", "_", "7", &"a".repeat(32)].iter().all(|good| WearerName::new(good).is_some()));
    }
}
