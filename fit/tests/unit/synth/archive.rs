use std::fs;

use facewire_face::BLENDSHAPES;
use facewire_fit::dataset;
use facewire_fit::synth::archive::*;
use facewire_fit::synth::worker::{APPEARANCE, ROW, Rows};
use half::f16;

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
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("faces.npz");
    let row = |start: u16| (0..ROW).map(move |index| f32::from(start) + index as f32 / 4096.0);
    let subjects = vec![row(0).chain(row(1)).collect(), vec![], row(2).collect::<Vec<f32>>()];
    let appearance =
        |number: u64| Ok(vec![f16::from_f32(number as f32); subjects[number as usize].len() / ROW * APPEARANCE]);
    write(&out, &subjects, appearance).expect("written");
    let samples = dataset::load(&out).expect("read");
    assert_eq!(samples.iter().map(|sample| sample.subject).collect::<Vec<_>>(), [0, 0, 1]);
    assert_eq!(samples[1].landmarks.0[1][0], 1.0 + 3.0 / 4096.0);
    assert_eq!(samples[2].truth[2], f64::from(2.0 + 1436.0_f32 / 4096.0));
    assert_eq!(samples[0].pose_deg[1], -f64::from(1487.0_f32 / 4096.0), "pitch nods down in the file");
    let appearances = dataset::load_appearances(&[&out], samples.len()).expect("read").expect("features");
    assert_eq!([0, 1, 2].map(|row| appearances.of(row).skin[179][31]), [0.0, 0.0, 2.0]);
}

#[test]
fn shards_are_read_back_unchanged_and_other_settings_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("out.npz");
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
    Shards::open(&out, "seed 1\n").expect("the same settings");
    assert!(Shards::open(&out, "seed 2\n").err().is_some_and(|error| error.to_string().contains("seed 1")));
    shards.remove().expect("removed");
}
