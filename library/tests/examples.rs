//! The examples `film` and `pictures` run, and print what their descriptions say.
#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use std::fs;
use std::path::Path;
use std::process::Command;

const CLIP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../src/capture/demo.avi");

/// Runs an example, which cargo builds with the tests, and returns what it prints.
fn run(example: &str, argument: &Path) -> String {
    let target = std::env::current_exe().unwrap().parent().unwrap().parent().unwrap().to_owned();
    let ran = Command::new(target.join("examples").join(example)).arg(argument).output().unwrap();
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    String::from_utf8(ran.stdout).unwrap()
}

#[test]
fn a_film_becomes_a_table_with_a_row_for_each_frame() {
    let table = run("film", Path::new(CLIP));
    let mut lines = table.lines();
    let columns = lines.next().unwrap().split(',').count();
    assert_eq!(columns, 1 + 52 + 3);
    let rows: Vec<Vec<f32>> = lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect();
    assert!(rows.len() > 200 && rows.iter().all(|row| row.len() == columns), "{} rows", rows.len());
}

#[test]
fn the_faces_in_the_jpeg_pictures_of_a_folder_are_found_and_other_files_left_out() {
    let (clip, folder) = (fs::read(CLIP).unwrap(), tempfile::tempdir().unwrap());
    let begin = clip.windows(2).position(|bytes| bytes == [0xff, 0xd8]).unwrap();
    let length = clip[begin..].windows(2).position(|bytes| bytes == [0xff, 0xd9]).unwrap() + 2;
    fs::write(folder.path().join("face.jpg"), &clip[begin..begin + length]).unwrap();
    fs::write(folder.path().join("notes.txt"), "no picture").unwrap();
    let printed = run("pictures", folder.path());
    assert!(printed.lines().count() == 1 && printed.contains("face.jpg: "), "{printed}");
}
