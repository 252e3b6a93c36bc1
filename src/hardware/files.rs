//! Reads files of `/sys` and `/proc`.

use std::fs::{self, File};
use std::io::Read as _;
use std::path::{Path, PathBuf};

/// Names the folder in which `sys` and `proc` are looked for, instead of `/`. Tests use it.
const ROOT_VARIABLE: &str = "FACEWIRE_SYSROOT";
/// Longest text that [`read`] returns. Numbers and names of governors, drivers and sensors are shorter.
const LONGEST: usize = 64;

/// Returns the folder that contains `sys` and `proc`.
#[must_use]
pub fn root() -> PathBuf {
    std::env::var_os(ROOT_VARIABLE).map_or_else(|| PathBuf::from("/"), PathBuf::from)
}

/// Calls `judge` with the trimmed text of a short file. Allocates no memory, so that it can be called for months. Returns
/// `None` if the file cannot be read: sensors come and go, and some refuse a reading for a moment.
pub(super) fn read<T>(path: &Path, judge: impl FnOnce(&str) -> Option<T>) -> Option<T> {
    let mut bytes = [0; LONGEST];
    let count = File::open(path).and_then(|mut file| file.read(&mut bytes)).ok()?;
    judge(std::str::from_utf8(bytes.get(..count)?).ok()?.trim())
}

/// Reads a whole number.
pub(super) fn number(path: &Path) -> Option<i64> {
    read(path, |text| text.parse().ok())
}

/// Reads a text, without the zero byte that ends it in a device tree.
pub(super) fn text(path: &Path) -> Option<String> {
    let bytes = fs::read(path).ok()?;
    let text = String::from_utf8_lossy(&bytes);
    Some(text.trim_matches(|c: char| c == '\0' || c.is_whitespace()).to_owned())
}

/// Returns the entries of a folder whose names are `prefix` and a number, in the order of the numbers.
pub(super) fn numbered(folder: &Path, prefix: &str) -> Vec<PathBuf> {
    let number = |path: &PathBuf| path.file_name()?.to_str()?.strip_prefix(prefix)?.parse::<u32>().ok();
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<_> = entries.filter_map(|entry| Some((number(&entry.path())?, entry.path()))).collect();
    found.sort();
    found.into_iter().map(|(_, path)| path).collect()
}
