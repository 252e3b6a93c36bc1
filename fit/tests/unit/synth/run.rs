use std::path::Path;

use clap::Parser;
use facewire_face::BLENDSHAPES;
use facewire_fit::synth::run::*;
use facewire_fit::{dataset, faces};
use tempfile::TempDir;

use crate::reference;

#[derive(Parser)]
struct Cli {
    #[command(flatten)]
    options: Options,
}

fn options(folder: &Path, threads: &str) -> Options {
    let [out, curves] = ["faces.npz", "curves.csv"].map(|name| folder.join(name));
    let wave = |frame: usize, shape: usize| (0.07 * (frame * (1 + shape % 5) + 14 * shape) as f64).sin();
    let row = |frame| (0..BLENDSHAPES.len()).map(move |shape| format!("{:.3}", wave(frame, shape).max(0.0) / 2.0));
    let rows = (0..200).map(|frame| row(frame).collect::<Vec<_>>().join(",")).collect::<Vec<_>>();
    std::fs::write(&curves, format!("{}\n{}\n", BLENDSHAPES.join(","), rows.join("\n"))).expect("written");
    let [out, curves] = [out, curves].map(|path| path.display().to_string());
    let fixed = ["synth", "--pictures", "6", "--per-subject", "2", "--size", "256", "256", "--seed", "7"];
    let given = [out.as_str(), "--rig", reference::RIG, "--curves", &curves, "--threads", threads];
    Cli::parse_from(fixed.iter().chain(&given)).options
}

fn made(options: &Options) -> Vec<u8> {
    run(options).expect("an archive");
    std::fs::read(&options.out).expect("the archive")
}

#[test]
fn the_same_seed_gives_the_same_file_on_any_number_of_threads_and_after_an_interruption() {
    let folders = [(); 3].map(|()| tempfile::tempdir().expect("a folder"));
    let [one, two, cut] = folders.each_ref().map(TempDir::path);
    let whole = made(&options(one, "1"));
    let saved = two.join("pictures");
    let save_pictures = vec![saved.display().to_string(), "3".to_owned()];
    assert_eq!(whole, made(&Options { save_pictures, ..options(two, "2") }), "threads have no influence");
    assert_eq!(std::fs::read_dir(saved).expect("a folder").count(), 3, "as many are saved as requested");
    run_until(&Options { pictures: 2, ..options(cut, "1") }, false).expect("the first subject");
    assert_eq!(whole, made(&options(cut, "1")), "a resumed run gives the same file");
}

#[test]
fn the_solver_finds_the_true_pose_in_rendered_faces() {
    let folder = tempfile::tempdir().expect("a folder");
    let few = options(folder.path(), "2");
    let options = Options { pictures: 24, per_subject: 8, size: vec![400, 400], ..few };
    run(&options).expect("an archive");
    let samples = dataset::load(&options.out).expect("a dataset");
    assert_eq!(samples.len(), 24);
    let [yaw, pitch, roll] = faces::pose_error_deg(&samples).expect("poses");
    assert!(yaw < 3.0 && pitch < 6.0 && roll < 2.0, "{yaw} {pitch} {roll}");
    let mean_turn = samples.iter().map(|sample| sample.pose_deg[0].abs()).sum::<f64>() / 24.0;
    assert!(mean_turn > 6.0, "heads must turn, or a wrong sign would go unnoticed: {mean_turn}");
}
