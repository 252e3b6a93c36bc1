//! Writes the rows of all subjects as one archive in the layout that `train` and `judge` read.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use facewire_face::model::{APPEARANCE_CHANNELS, APPEARANCE_LANDMARKS};
use facewire_face::{BLENDSHAPES, COEFFS, LANDMARKS};
use half::f16;
use npyz::WriterBuilder;
use npyz::npz::NpzWriter;
use npyz::zip::{CompressionMethod, DateTime, write::FileOptions};

use super::worker::{META, ROW};
use crate::dataset;

/// An array of the archive: its position in a row, and its shape for one picture.
struct Column {
    name: &'static str,
    first: usize,
    shape: &'static [usize],
}

/// The file beside an archive that names the columns of `weights`.
const NAMES: &str = "names.json";
const POINTS: usize = 3 * LANDMARKS;
const COLUMNS: [Column; 4] = [
    Column { name: "landmarks", first: 0, shape: &[LANDMARKS, 3] },
    Column { name: "weights", first: POINTS, shape: &[COEFFS] },
    Column { name: "pose", first: POINTS + COEFFS, shape: &[3] },
    Column { name: "meta", first: POINTS + COEFFS + 3, shape: &[META] },
];

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

/// Writes the archive. `subjects` holds the numbers of each subject. `appearance` returns the values of the feature map in
/// the pictures of a subject, which are not all in memory at the same time.
pub fn write(out: &Path, subjects: &[Vec<f32>], appearance: impl Fn(usize) -> Result<Vec<f16>>) -> Result<()> {
    let failed = || format!("cannot write {}", out.display());
    let unfinished = out.with_extension("unfinished");
    let mut npz = NpzWriter::new(BufWriter::new(File::create(&unfinished).with_context(failed)?));
    for column in &COLUMNS {
        write_column(&mut npz, column, subjects).with_context(failed)?;
    }
    write_subjects(&mut npz, subjects).with_context(failed)?;
    write_appearance(&mut npz, subjects, appearance).with_context(failed)?;
    npz.zip_writer().finish().with_context(failed)?;
    let names = serde_json::to_string(&BLENDSHAPES.as_slice())?;
    fs::write(out.with_file_name(NAMES), names).context("cannot write names.json")?;
    fs::rename(&unfinished, out).with_context(failed)
}

/// Returns file options without a time stamp, so that the same pictures give the same file.
fn options() -> FileOptions {
    FileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default())
        .large_file(true)
}

fn pictures(subjects: &[Vec<f32>]) -> u64 {
    subjects.iter().map(|rows| (rows.len() / ROW) as u64).sum()
}

fn write_column(npz: &mut NpzWriter<BufWriter<File>>, column: &Column, subjects: &[Vec<f32>]) -> Result<()> {
    let sides = column.shape.iter().map(|side| *side as u64);
    let shape: Vec<u64> = core::iter::once(pictures(subjects)).chain(sides).collect();
    let width: usize = column.shape.iter().product();
    let mut array = npz.array::<f32>(column.name, options())?.default_dtype().shape(&shape).begin_nd()?;
    for row in subjects.iter().flat_map(|rows| rows.chunks_exact(ROW)) {
        array.extend(row[column.first..column.first + width].iter().copied())?;
    }
    Ok(array.finish()?)
}

fn write_subjects(npz: &mut NpzWriter<BufWriter<File>>, subjects: &[Vec<f32>]) -> Result<()> {
    let shape = [pictures(subjects)];
    let mut array = npz.array::<i32>("subject", options())?.default_dtype().shape(&shape).begin_nd()?;
    for (number, rows) in (0_i32..).zip(subjects) {
        array.extend(core::iter::repeat_n(number, rows.len() / ROW))?;
    }
    Ok(array.finish()?)
}

fn write_appearance(
    npz: &mut NpzWriter<BufWriter<File>>,
    subjects: &[Vec<f32>],
    appearance: impl Fn(usize) -> Result<Vec<f16>>,
) -> Result<()> {
    let shape = [pictures(subjects), APPEARANCE_LANDMARKS.len() as u64, APPEARANCE_CHANNELS as u64];
    let mut array = npz.array::<f16>(dataset::FEATURES, options())?.default_dtype().shape(&shape).begin_nd()?;
    for number in 0..subjects.len() {
        array.extend(appearance(number)?)?;
    }
    Ok(array.finish()?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::worker::APPEARANCE;

    #[test]
    fn another_datasets_names_and_outputs_other_than_npz_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().join("faces.npz");
        check(&out).expect("an empty folder");
        assert!(check(&folder.path().join("out.txt")).is_err_and(|error| error.to_string().contains(".npz")));
        let names = folder.path().join(NAMES);
        let mut columns = BLENDSHAPES;
        fs::write(&names, serde_json::to_string_pretty(&columns.as_slice()).expect("JSON")).expect("written");
        check(&out).expect("the same names");
        columns.swap(15, 16);
        let other = serde_json::to_string(&columns.as_slice()).expect("JSON");
        fs::write(&names, &other).expect("written");
        assert!(check(&out).is_err_and(|error| error.to_string().contains("another folder")));
        assert_eq!(fs::read_to_string(&names).expect("still there"), other);
    }

    #[test]
    fn an_archive_reads_back_as_a_dataset() {
        let folder = std::env::temp_dir().join(format!("facewire-fit-{}-archive", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let out = folder.join("faces.npz");
        let row = |start: u16| (0..ROW).map(move |index| f32::from(start) + index as f32 / 4096.0);
        let subjects = vec![row(0).chain(row(1)).collect(), vec![], row(2).collect::<Vec<f32>>()];
        let appearance =
            |number: usize| Ok(vec![f16::from_f32(number as f32); subjects[number].len() / ROW * APPEARANCE]);
        write(&out, &subjects, appearance).expect("written");
        let samples = dataset::load(&out).expect("read");
        assert_eq!(samples.iter().map(|sample| sample.subject).collect::<Vec<_>>(), [0, 0, 1]);
        assert_eq!(samples[1].landmarks.0[1][0], 1.0 + 3.0 / 4096.0);
        assert_eq!(samples[2].truth[2], f64::from(2.0 + 1436.0_f32 / 4096.0));
        assert_eq!(samples[0].pose_deg[1], -f64::from(1487.0_f32 / 4096.0), "pitch nods down in the file");
        let appearances = dataset::load_appearances(&[&out], samples.len()).expect("read").expect("features");
        assert_eq!([0, 1, 2].map(|row| appearances.of(row).0[179][31]), [0.0, 0.0, 2.0]);
        fs::remove_dir_all(folder).expect("removed");
    }
}
