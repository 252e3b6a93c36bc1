//! Shards: one file of rows per subject, in a folder beside the archive, from which an interrupted run is resumed.
//!
//! A shard is written atomically. The folder stores the settings that it was made with, and refuses other settings.

use std::{
    fs::{self, File},
    io::{BufReader, BufWriter},
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, ensure};
use npyz::{NpyFile, WriteOptions, WriterBuilder};

use super::worker::ROW;

/// The file that stores the settings.
const SETTINGS: &str = "settings.txt";

/// The folder of an archive's shards.
pub struct Shards {
    folder: PathBuf,
}

impl Shards {
    /// Opens or creates the folder beside `out`. `settings` are all settings that determine the pictures.
    pub fn open(out: &Path, settings: &str) -> Result<Self> {
        let mut name = out.file_name().context("the output has no file name")?.to_owned();
        name.push(".parts");
        let folder = out.with_file_name(name);
        fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let known = folder.join(SETTINGS);
        match fs::read_to_string(&known) {
            Ok(text) => ensure!(
                text == settings,
                "{} was made with other settings:\n{text}remove the folder, or use these settings again",
                folder.display()
            ),
            Err(_) => fs::write(&known, settings).with_context(|| format!("cannot write {}", known.display()))?,
        }
        Ok(Self { folder })
    }

    fn path(&self, subject: u64) -> PathBuf {
        self.folder.join(format!("subject-{subject:06}.npy"))
    }

    /// Returns the rows of a subject, or `None` if it has not been rendered.
    pub fn read(&self, subject: u64) -> Result<Option<Vec<f32>>> {
        let path = self.path(subject);
        if !path.exists() {
            return Ok(None);
        }
        let damaged = || format!("{} is damaged: remove it", path.display());
        let npy = NpyFile::new(BufReader::new(File::open(&path)?)).with_context(damaged)?;
        let rows = npy.into_vec::<f32>().with_context(damaged)?;
        ensure!(rows.len().is_multiple_of(ROW), damaged());
        Ok(Some(rows))
    }

    /// Stores the rows of a subject.
    pub fn write(&self, subject: u64, rows: &[f32]) -> Result<()> {
        let path = self.path(subject);
        let unfinished = path.with_extension("unfinished");
        let failed = || format!("cannot write {}", path.display());
        let file = BufWriter::new(File::create(&unfinished).with_context(failed)?);
        let shape = [(rows.len() / ROW) as u64, ROW as u64];
        let mut npy = WriteOptions::new().default_dtype().shape(&shape).writer(file).begin_nd()?;
        npy.extend(rows.iter().copied()).with_context(failed)?;
        npy.finish().with_context(failed)?;
        fs::rename(&unfinished, &path).with_context(failed)
    }

    /// Removes the folder with all shards.
    pub fn remove(self) -> Result<()> {
        fs::remove_dir_all(&self.folder).with_context(|| format!("cannot remove {}", self.folder.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("facewire-fit-{}-{name}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        folder
    }

    #[test]
    fn rows_are_read_back_unchanged_and_missing_subjects_are_none() {
        let out = folder("rows").join("out.npz");
        let shards = Shards::open(&out, "seed 1\n").expect("a folder");
        let rows: Vec<f32> = (0..2 * ROW).map(|index| index as f32 / 7.0).collect();
        shards.write(3, &rows).expect("written");
        shards.write(4, &[]).expect("written");
        assert_eq!(shards.read(3).expect("read"), Some(rows));
        assert_eq!(shards.read(4).expect("read"), Some(vec![]));
        assert_eq!(shards.read(5).expect("read"), None);
        shards.remove().expect("removed");
    }

    #[test]
    fn other_settings_are_refused() {
        let out = folder("settings").join("out.npz");
        Shards::open(&out, "seed 1\n").expect("a folder");
        let shards = Shards::open(&out, "seed 1\n").expect("the same");
        assert!(Shards::open(&out, "seed 2\n").err().is_some_and(|error| error.to_string().contains("seed 1")));
        shards.remove().expect("removed");
    }
}
