use std::path::Path;

use anyhow::Result;
use facewire_fit::arrays::*;
use npyz::zip::write::FileOptions;
use npyz::{Order, WriterBuilder};

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
