//! Writes the rows of all subjects as one archive in the layout that `train` and `judge` read, and the shards of which it
//! is made: one archive of rows per subject, in a folder beside it, from which an interrupted run is resumed. The folder
//! stores the settings that it was made with, and refuses other settings.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use facewire_face::{BLENDSHAPES, COEFFS, LANDMARKS};
use half::f16;
use npyz::Deserialize;
use npyz::npz::NpzArchive;

use super::visible::REGIONS;
use super::worker::{APPEARANCE, META, ROW, Rows};
use crate::arrays::{Archive, create, write_array};
use crate::dataset;

pub const NAMES: &str = "names.json";
const POINTS: usize = 3 * LANDMARKS;
const COLUMNS: [(&str, usize, &[u64]); 5] = [
    ("landmarks", 0, &[LANDMARKS as u64, 3]),
    ("weights", POINTS, &[COEFFS as u64]),
    ("pose", POINTS + COEFFS, &[3]),
    ("meta", POINTS + COEFFS + 3, &[META as u64]),
    ("visible", POINTS + COEFFS + 3 + META, &[REGIONS as u64]),
];
/// The array of the rows in a shard, and the file that stores the settings of all shards.
const NUMBERS: &str = "numbers";
const SETTINGS: &str = "settings.txt";

/// Checks before the first picture is rendered that the output is an npz file, which its provenance file cannot
/// overwrite, and that `names.json` does not belong to another dataset.
pub fn check(out: &Path) -> Result<()> {
    let npz = out.extension().is_some_and(|extension| extension == "npz");
    ensure!(npz, "{} does not end in .npz: choose a name with this ending", out.display());
    let names = out.with_file_name(NAMES);
    let known = fs::read_to_string(&names).ok().and_then(|text| serde_json::from_str::<Vec<String>>(&text).ok());
    ensure!(
        !names.exists() || known.is_some_and(|known| known == BLENDSHAPES),
        "{} names the columns of another dataset in another order: write to another folder",
        names.display()
    );
    Ok(())
}

/// Writes the archive. `subjects` holds the numbers of each subject. `appearance` returns how those of a subject look,
/// which is not in memory for all at the same time.
pub fn write(out: &Path, subjects: &[Vec<f32>], appearance: impl Fn(u64) -> Result<Vec<f16>>) -> Result<()> {
    let rows = || subjects.iter().flat_map(|rows| rows.chunks_exact(ROW));
    let pictures = rows().count() as u64;
    fs::write(out.with_file_name(NAMES), serde_json::to_string(&BLENDSHAPES.as_slice())?)
        .context("cannot write names.json")?;
    write_whole(out, |archive| {
        for (name, first, shape) in COLUMNS {
            let width = shape.iter().product::<u64>() as usize;
            let values = rows().map(|row| Ok(row[first..first + width].iter().copied()));
            write_array(archive, name, &[&[pictures], shape].concat(), values)?;
        }
        let numbers = (0_i32..).zip(subjects);
        let numbers = numbers.map(|(number, rows)| Ok(core::iter::repeat_n(number, rows.len() / ROW)));
        write_array(archive, "subject", &[pictures], numbers)?;
        let shape = [pictures, APPEARANCE as u64];
        write_array(archive, dataset::FEATURES, &shape, (0..subjects.len() as u64).map(appearance))
    })
}

/// Writes an archive under another name first, so that it is whole or absent.
fn write_whole(path: &Path, write: impl FnOnce(&mut Archive) -> Result<()>) -> Result<()> {
    let unfinished = path.with_extension("unfinished");
    let written = || -> Result<()> {
        let mut archive = create(&unfinished)?;
        write(&mut archive)?;
        archive.zip_writer().finish()?;
        Ok(fs::rename(&unfinished, path)?)
    };
    written().with_context(|| format!("cannot write {}", path.display()))
}

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
        self.read(subject, dataset::FEATURES, APPEARANCE)
    }

    pub fn read<T: Deserialize>(&self, subject: u64, name: &str, width: usize) -> Result<Vec<T>> {
        let path = self.path(subject);
        let damaged = || format!("{} is damaged or missing: remove it and start again", path.display());
        let mut archive = NpzArchive::open(&path).with_context(damaged)?;
        let array = archive.by_name(name).with_context(damaged)?.with_context(damaged)?;
        let values = array.into_vec::<T>().with_context(damaged)?;
        ensure!(values.len().is_multiple_of(width), damaged());
        Ok(values)
    }

    pub fn write(&self, subject: u64, Rows { numbers, appearance }: &Rows) -> Result<()> {
        write_whole(&self.path(subject), |archive| {
            let shape = |values: usize, width: usize| [(values / width) as u64, width as u64];
            write_array(archive, NUMBERS, &shape(numbers.len(), ROW), [Ok(numbers.iter().copied())])?;
            let shape = shape(appearance.len(), APPEARANCE);
            write_array(archive, dataset::FEATURES, &shape, [Ok(appearance.iter().copied())])
        })
    }

    pub fn remove(self) -> Result<()> {
        fs::remove_dir_all(&self.folder).with_context(|| format!("cannot remove {}", self.folder.display()))
    }
}
