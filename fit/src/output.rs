//! Writing output files.

use std::{
    fs::{self, File},
    path::Path,
};

use anyhow::{Context, Result};

/// Checks that a file can be written before the work for it begins. An existing file is left unchanged.
pub fn check(path: &Path) -> Result<()> {
    let failed = || format!("cannot write {}", path.display());
    let is_new = !path.exists();
    File::options().append(true).create(true).open(path).with_context(failed)?;
    if is_new { fs::remove_file(path).with_context(failed) } else { Ok(()) }
}

/// Writes a file.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    fs::write(path, content).with_context(|| format!("cannot write {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checking_a_path_leaves_no_trace() {
        let folder = tempfile::tempdir().expect("a folder");
        let [new, old] = ["new", "old"].map(|name| folder.path().join(name));
        fs::write(&old, "kept").expect("written");
        check(&new).expect("can be written");
        check(&old).expect("can be written");
        assert!(!new.exists() && fs::read(&old).expect("still there") == b"kept");
        let refusal = check(&folder.path().join("absent/new")).expect_err("no such folder").to_string();
        assert!(refusal.contains("cannot write") && refusal.contains("absent/new"), "{refusal}");
        assert!(check(folder.path()).is_err(), "a folder");
    }
}
