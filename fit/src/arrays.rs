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

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Writes an archive of float32 arrays, given by name, shape and the value at each index, and the int32 array `subject`.
    pub fn write(path: &Path, floats: &[(&str, &[u64])], value: impl Fn(usize) -> f32, order: Order, subjects: &[i32]) {
        let mut npz = create(path).expect("a file");
        for (name, shape) in floats {
            let array = npz.array::<f32>(name, FileOptions::default()).expect("an array");
            let mut array = array.default_dtype().shape(shape).order(order).begin_nd().expect("begun");
            array.extend((0..shape.iter().product::<u64>() as usize).map(&value)).expect("written");
            array.finish().expect("written");
        }
        write_array(&mut npz, "subject", &[subjects.len() as u64], [Ok(subjects.to_vec())]).expect("written");
        npz.zip_writer().finish().expect("written");
    }

    fn refusal(shape: &[u64], order: Order, value: f32) -> String {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("faces.npz");
        write(&path, &[("pose", shape)], |index| if index == 4 { value } else { 0.5 }, order, &[1, 2]);
        let mut arrays = Arrays::open(&path).expect("an archive");
        assert_eq!(arrays.integers("subject", &[]).expect("int32"), [1, 2]);
        arrays.floats("pose", &[3]).map_or_else(|error| format!("{error:#}"), |_| String::new())
    }

    #[test]
    fn arrays_that_would_be_misread_are_refused_with_file_array_and_row() {
        assert_eq!(refusal(&[2, 3], Order::C, 0.1), "");
        let wrong = [
            (refusal(&[2, 3], Order::Fortran, 0.1), "Fortran order"),
            (refusal(&[2, 4], Order::C, 0.1), "shape [2, 4]"),
            (refusal(&[2, 1, 3], Order::C, 0.1), "shape [2, 1, 3]"),
            (refusal(&[0, 3], Order::C, 0.1), "must have at least one row"),
            (refusal(&[2, 3], Order::C, f32::NAN), "row 1 (counted from 0) holds NaN"),
            (refusal(&[2, 3], Order::C, f32::INFINITY), "row 1 (counted from 0) holds inf"),
        ];
        for (refusal, words) in wrong {
            assert!(refusal.contains("faces.npz: pose") && refusal.contains(words), "{refusal}");
        }
    }

    #[test]
    fn missing_arrays_wrong_types_and_other_files_are_refused_by_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("faces.npz");
        write(&path, &[], |_| 0.0, Order::C, &[1]);
        let refusal = |result: Result<Vec<f32>>| format!("{:#}", result.expect_err("refused"));
        let mut arrays = Arrays::open(&path).expect("an archive");
        assert!(refusal(arrays.floats("pose", &[3])).contains("faces.npz has no array pose"));
        assert!(refusal(arrays.floats("subject", &[])).contains("faces.npz: subject is not float32"));
        std::fs::write(&path, "text").expect("written");
        assert!(Arrays::open(&path).is_err_and(|error| format!("{error:#}").contains("faces.npz is not a NumPy")));
    }
}
