use std::path::Path;
use std::path::PathBuf;

use anyhow::Result;
use facewire_face::{BLENDSHAPES, COEFFS, Landmarks};
use facewire_fit::dataset::*;
use npyz::{Order, npz::NpzArchive};

use crate::arrays::write;

/// A face of the first subject that is not neutral.
pub fn sample(landmarks: Landmarks, picture: usize) -> Sample {
    Sample { landmarks, truth: [0.0; COEFFS], pose_deg: [0.0; 3], picture, subject: 0, neutral: false, mirrored: false }
}

pub fn test_faces() -> Vec<Sample> {
    let mut archive = NpzArchive::open(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/faces.npz")).expect("faces");
    let mut read = |name: &str, unit: f32| -> Vec<f32> {
        let array = archive.by_name(name).expect("read").expect("an array");
        array.into_vec::<i16>().expect("16 bits").into_iter().map(|value| f32::from(value) / unit).collect()
    };
    let (landmarks, weights, pose) = (read("landmarks", 32.0), read("weights", 1000.0), read("pose", 64.0));
    let (subject, neutral) = (read("subject", 1.0), read("neutral", 1.0));
    let sample = |(row, points): (usize, &[f32])| Sample {
        truth: core::array::from_fn(|shape| f64::from(weights[row * COEFFS + shape])),
        pose_deg: pose_of(&pose[3 * row..][..3]),
        subject: subject[row] as usize,
        neutral: neutral[row] > 0.5,
        ..sample(landmarks_of(points), row)
    };
    landmarks.chunks_exact(LANDMARK_VALUES).enumerate().map(sample).collect()
}

fn loaded(rows: [u64; 4], subjects: &[i32], names: &[&str]) -> Result<Vec<Sample>> {
    let folder = tempfile::tempdir()?;
    load(&written(folder.path(), rows, subjects, names)?)
}

fn written(folder: &Path, rows: [u64; 4], subjects: &[i32], names: &[&str]) -> Result<PathBuf> {
    let path = folder.join("faces.npz");
    let shapes = [vec![rows[0], 478, 3], vec![rows[1], 52], vec![rows[2], 3], vec![rows[3], 5]];
    let names_of = ["landmarks", "weights", "pose", "meta"].into_iter();
    let arrays: Vec<(&str, &[u64])> = names_of.zip(shapes.iter().map(Vec::as_slice)).collect();
    write(&path, &arrays, |index| index as f32, Order::C, subjects);
    std::fs::write(folder.join("names.json"), serde_json::to_string(names)?)?;
    Ok(path)
}

fn refusal(rows: [u64; 4], subjects: &[i32], names: &[&str]) -> String {
    loaded(rows, subjects, names).err().map_or_else(String::new, |error| format!("{error:#}"))
}

#[test]
fn pictures_of_several_datasets_follow_one_another_and_subjects_of_the_same_number_are_one() {
    let folders = [tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder")];
    let write = |index: usize, subjects: &[i32]| {
        written(folders[index].path(), [subjects.len() as u64; 4], subjects, &BLENDSHAPES).expect("written")
    };
    let samples = load_all(&[write(0, &[7, 5]), write(1, &[9, 7, 6])]).expect("datasets");
    assert_eq!(samples.iter().map(|sample| sample.subject).collect::<Vec<_>>(), [2, 0, 3, 2, 1]);
    assert_eq!(samples.iter().map(|sample| sample.picture).collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
    assert_eq!(samples[0].truth, samples[2].truth);
}

#[test]
fn people_of_synth_are_told_apart_by_their_seed_and_each_seed_begins_at_a_multiple_of_eight() {
    let folders = [(); 4].map(|()| tempfile::tempdir().expect("a folder"));
    let paths =
        folders.each_ref().map(|folder| written(folder.path(), [2; 4], &[7, 6], &BLENDSHAPES).expect("written"));
    for (path, text) in paths.iter().zip(["seed 2, set Train, 9", "seed 1, set Train, 9", "seed 1, set Train, 6"]) {
        std::fs::write(provenance(path), format!("synth edition 11, {text} pictures")).expect("written");
    }
    let samples = load_all(&paths).expect("datasets");
    let subjects: Vec<usize> = samples.iter().map(|sample| sample.subject).collect();
    assert_eq!(subjects, [17, 16, 9, 8, 9, 8, 1, 0], "the people of the last one are not by synth");
}

#[test]
fn arrays_of_different_lengths_are_refused_with_both_lengths() {
    for (index, name) in ["weights", "pose", "meta"].into_iter().enumerate() {
        let mut rows = [3; 4];
        rows[index + 1] = 2;
        let refusal = refusal(rows, &[1, 1, 2], &BLENDSHAPES);
        assert!(refusal.contains(&format!("faces.npz: {name} has 2 rows, but landmarks has 3")), "{refusal}");
    }
    assert!(refusal([3; 4], &[1, 2], &BLENDSHAPES).contains("faces.npz: subject has 2 rows, but landmarks has 3"));
}

#[test]
fn columns_are_matched_by_name_and_names_that_do_not_match_are_refused() {
    let mut names = BLENDSHAPES;
    names.swap(0, 51);
    let sample = &loaded([3; 4], &[7, 5, 7], &names).expect("a dataset")[1];
    assert_eq!([sample.truth[0], sample.truth[51]], [103.0, 52.0]);
    let refusal = |names: &[&str]| refusal([1; 4], &[1], names);
    let twice = [&BLENDSHAPES[..51], &["jawOpen"]].concat();
    assert!(refusal(&BLENDSHAPES[..51]).contains("names.json has 51 names"));
    assert!(refusal(&[&BLENDSHAPES[..], &["noseUp"]].concat()).contains("names.json has 53 names"));
    assert!(refusal(&twice).contains("names.json lacks tongueOut"));
}
