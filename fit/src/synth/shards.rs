//! Shards: one archive of rows per subject, in a folder beside the archive, from which an interrupted run is resumed.
//!
//! A shard is written atomically. The folder stores the settings that it was made with, and refuses other settings.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use half::f16;
use npyz::npz::{NpzArchive, NpzWriter};
use npyz::zip::write::FileOptions;
use npyz::{AutoSerialize, Deserialize, WriterBuilder};

use super::worker::{APPEARANCE, ROW, Rows};

/// The arrays of a shard: the rows, and the values of the feature map.
const NUMBERS: &str = "numbers";
const FEATURES: &str = "features";
/// The file that stores the settings.
const SETTINGS: &str = "settings.txt";

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
        self.folder.join(format!("subject-{subject:06}.npz"))
    }

    pub fn has(&self, subject: u64) -> bool {
        self.path(subject).exists()
    }

    pub fn numbers(&self, subject: u64) -> Result<Vec<f32>> {
        self.read(subject, NUMBERS, ROW)
    }

    pub fn appearance(&self, subject: u64) -> Result<Vec<f16>> {
        self.read(subject, FEATURES, APPEARANCE)
    }

    fn read<T: Deserialize>(&self, subject: u64, name: &str, width: usize) -> Result<Vec<T>> {
        let path = self.path(subject);
        let damaged = || format!("{} is damaged or missing: remove it and start again", path.display());
        let mut archive = NpzArchive::open(&path).with_context(damaged)?;
        let array = archive.by_name(name).with_context(damaged)?.with_context(damaged)?;
        let values = array.into_vec::<T>().with_context(damaged)?;
        ensure!(values.len().is_multiple_of(width), damaged());
        Ok(values)
    }

    pub fn write(&self, subject: u64, rows: &Rows) -> Result<()> {
        let path = self.path(subject);
        let unfinished = path.with_extension("unfinished");
        let failed = || format!("cannot write {}", path.display());
        let mut npz = NpzWriter::new(BufWriter::new(File::create(&unfinished).with_context(failed)?));
        write_array(&mut npz, NUMBERS, &rows.numbers, ROW).with_context(failed)?;
        write_array(&mut npz, FEATURES, &rows.appearance, APPEARANCE).with_context(failed)?;
        npz.zip_writer().finish().with_context(failed)?;
        drop(npz);
        fs::rename(&unfinished, &path).with_context(failed)
    }

    pub fn remove(self) -> Result<()> {
        fs::remove_dir_all(&self.folder).with_context(|| format!("cannot remove {}", self.folder.display()))
    }
}

fn write_array<T: AutoSerialize + Copy>(
    npz: &mut NpzWriter<BufWriter<File>>,
    name: &str,
    values: &[T],
    width: usize,
) -> Result<()> {
    let shape = [(values.len() / width) as u64, width as u64];
    let mut array = npz.array::<T>(name, FileOptions::default())?.default_dtype().shape(&shape).begin_nd()?;
    array.extend(values.iter().copied())?;
    Ok(array.finish()?)
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
        let numbers: Vec<f32> = (0..2 * ROW).map(|index| index as f32 / 7.0).collect();
        let appearance: Vec<f16> = (0..2 * APPEARANCE).map(|index| f16::from_f32(index as f32 / 7.0)).collect();
        let rows = Rows { numbers, appearance };
        shards.write(3, &rows).expect("written");
        shards.write(4, &Rows::default()).expect("written");
        assert_eq!([3, 4, 5].map(|subject| shards.has(subject)), [true, true, false]);
        let read = |subject| Ok(Rows { numbers: shards.numbers(subject)?, appearance: shards.appearance(subject)? });
        assert_eq!(read(3).expect("read"), rows);
        assert_eq!(read(4).expect("read"), Rows::default());
        assert!(read(5).is_err_and(|error: anyhow::Error| format!("{error:#}").contains("subject-000005.npz")));
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
