//! Reads arrays of `float32`, `float16` and `int32` from `NumPy` files, with one row per picture or frame.
//!
//! An array is refused if its type or shape is wrong, if it is in Fortran order (which would exchange rows and
//! columns), if it has no rows, or if it holds numbers that are not finite. The error names the file, the array and,
//! for a number that is not finite, the row.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use half::f16;
use npyz::npz::{NpzArchive, NpzWriter};
use npyz::zip::{CompressionMethod, DateTime, write::FileOptions};
use npyz::{AutoSerialize, Deserialize, NpyFile, Order, WriterBuilder};

pub struct Arrays {
    path: PathBuf,
    archive: NpzArchive<BufReader<File>>,
}

impl Arrays {
    pub fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).with_context(|| format!("cannot open {}", path.display()))?;
        let archive = NpzArchive::new(BufReader::new(file));
        let archive = archive.with_context(|| format!("{} is not a NumPy archive (.npz)", path.display()))?;
        Ok(Self { path: path.to_owned(), archive })
    }

    /// Reads a float32 array and returns its values row by row. `shape` is the shape of one row.
    pub fn floats(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let (label, values) = self.values(name, shape, "float32")?;
        finite(values, shape, &label)
    }

    pub fn halves(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f16>> {
        let (label, values) = self.values(name, shape, "float16")?;
        finite(values, shape, &label)
    }

    pub fn integers(&mut self, name: &str, shape: &[usize]) -> Result<Vec<i32>> {
        Ok(self.values(name, shape, "int32")?.1)
    }

    fn values<T: Deserialize>(&mut self, name: &str, shape: &[usize], kind: &str) -> Result<(String, Vec<T>)> {
        let label = format!("{}: {name}", self.path.display());
        let array = self.archive.by_name(name).with_context(|| format!("{label} is damaged"))?;
        let array = array.with_context(|| format!("{} has no array {name}", self.path.display()))?;
        let values = values(array, shape, kind, &label)?;
        Ok((label, values))
    }

    pub fn has(&self, name: &str) -> bool {
        self.archive.array_names().any(|other| other == name)
    }
}

fn values<T: Deserialize>(array: NpyFile<impl Read>, row: &[usize], kind: &str, label: &str) -> Result<Vec<T>> {
    let wanted = row.iter().map(|side| *side as u64);
    let shape = array.shape().to_vec();
    let fits = shape.first().is_some_and(|rows| *rows > 0) && shape.iter().skip(1).copied().eq(wanted);
    ensure!(fits, "{label} has shape {shape:?}, but must have at least one row, each of shape {row:?}");
    let row_major = array.order() == Order::C || shape.len() == 1;
    ensure!(row_major, "{label} is in Fortran order: convert it by numpy.ascontiguousarray and save it again");
    let Ok(numbers) = array.data::<T>() else { bail!("{label} is not {kind}") };
    numbers.collect::<Result<_, _>>().with_context(|| format!("{label} is cut short"))
}

fn finite<T: Copy + Into<f32>>(values: Vec<T>, row: &[usize], label: &str) -> Result<Vec<T>> {
    match values.iter().position(|value| !(*value).into().is_finite()) {
        None => Ok(values),
        Some(index) => {
            let row = index / row.iter().product::<usize>();
            bail!("{label}: row {row} (counted from 0) holds {}: leave out rows without a face", values[index].into())
        }
    }
}

pub type Archive = NpzWriter<BufWriter<File>>;

pub fn create(path: &Path) -> Result<Archive> {
    Ok(NpzWriter::new(BufWriter::new(File::create(path)?)))
}

/// Writes an array without compression and without a time stamp, so that the same values give the same file.
pub fn write_array<T: AutoSerialize, Chunk: IntoIterator<Item = T>>(
    archive: &mut Archive,
    name: &str,
    shape: &[u64],
    chunks: impl IntoIterator<Item = Result<Chunk>>,
) -> Result<()> {
    let options = FileOptions::default().compression_method(CompressionMethod::Stored);
    let options = options.last_modified_time(DateTime::default()).large_file(true);
    let mut array = archive.array::<T>(name, options)?.default_dtype().shape(shape).begin_nd()?;
    for chunk in chunks {
        array.extend(chunk?)?;
    }
    Ok(array.finish()?)
}
