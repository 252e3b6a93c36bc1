use std::path::Path;

use facewire_face::COEFFS;
use facewire_face::{BLENDSHAPES, Landmarks};
use facewire_fit::curves::*;
use facewire_fit::dataset::{LANDMARK_VALUES, landmarks_of};
use facewire_fit::recording::CsvTable;
use npyz::NpyFile;

/// Returns MediaPipe's landmarks of every 8th frame of the built-in clip, which the file stores in 1/32 pixel.
pub fn test_clip() -> Vec<Landmarks> {
    let file = include_bytes!("../../../tests/golden/demo-landmarks.npy");
    let values: Vec<i16> = NpyFile::new(&file[..]).expect("an array").into_vec().expect("16 bits");
    let values: Vec<f32> = values.into_iter().map(|value| f32::from(value) / 32.0).collect();
    values.chunks_exact(LANDMARK_VALUES).map(landmarks_of).collect()
}

#[test]
fn truth_of_another_length_or_without_numbers_is_refused() {
    let header = format!("frame,yaw_deg,pitch_deg,roll_deg,{}", BLENDSHAPES.join(","));
    let row = |value: &str| ["0.5"; COEFFS + 3].join(",") + "," + value;
    let read = |last: &str| {
        let text = [&header, &row("0.1"), &row(last)].map(String::as_str).join("\n");
        Truth::of(&CsvTable::read(text.as_bytes())?)
    };
    let truth = read("0.2").expect("a table");
    assert!(truth.fits(Path::new("clip.csv"), 2).is_ok());
    let refusal = truth.fits(Path::new("clip.csv"), 3).expect_err("a row is missing").to_string();
    assert!(refusal.contains("clip.csv has 2 rows") && refusal.contains("3 frames"), "{refusal}");
    assert!(read("NaN").is_err_and(|error| error.to_string().contains("line 3")));
}

#[test]
fn shut_lids_are_found_as_ranges() {
    let truth = [0.0, 0.95, 1.0, 0.2, 0.0, 1.0].map(|value| [value; COEFFS]);
    assert_eq!(shut(&truth, LIDS[1]), [1..3, 5..6]);
}

#[test]
fn table_of_parts_is_read_and_another_file_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("01.parts.csv");
    std::fs::write(&path, "part,first_frame,frames\nstill-bright,0,75\nblinks,75,195\n").expect("written");
    let parts = Parts::load(&path).expect("a table");
    assert_eq!(parts.0, [("still-bright".to_owned(), 0..75), ("blinks".to_owned(), 75..270)]);
    assert_eq!((parts.of("blinks"), parts.of("winks")), (75..270, 0..0));
    assert!(parts.starting_with(&["still"]).eq(std::iter::once(0..75)));
    std::fs::write(&path, "frame,yaw_deg\n1,2\n").expect("written");
    assert!(Parts::load(&path).expect_err("refused").to_string().contains("no table of parts"));
}
