//! Commands of `facewire-fit` on a small synthetic dataset. Two correlated blendshapes each move a landmark of their
//! own, and the other 49 do not move.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing, clippy::cast_possible_truncation)]

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::LazyLock;

use facewire_face::{BLENDSHAPES, LANDMARKS};
use npyz::{NpyFile, WriterBuilder, npz::NpzWriter, zip::write::FileOptions};
use tempfile::TempDir;

const SUBJECTS: usize = 16;
/// Pictures of each subject. The first one is neutral.
const PICTURES: usize = 12;
/// A blendshape, the landmark that it moves down, and the displacement in pixels at coefficient 1.
const MOVES: [(&str, usize, f32); 2] = [("jawOpen", 17, 20.0), ("mouthShrugLower", 200, 10.0)];
/// Number of features that are coordinates or distances.
const FEATURES: usize = 3 * LANDMARKS + 35;

/// Returns a pseudo-random number from 0 to 1.
fn noise(index: usize) -> f32 {
    (index as f32 * 0.618_034 + (index / 97) as f32 * 0.377).fract()
}

/// The face at rest in pixels: the first frame of the built-in clip, which the file stores in 1/32 pixel.
static FACE: LazyLock<Vec<f32>> = LazyLock::new(|| {
    let file = File::open(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/demo-landmarks.npy")).unwrap();
    let values = NpyFile::new(BufReader::new(file)).unwrap().data::<i16>().unwrap();
    values.take(3 * LANDMARKS).map(|value| f32::from(value.unwrap()) / 32.0).collect()
});

/// Returns the coefficients of [`MOVES`] in a picture. The second coefficient is 0.9 of the first plus noise.
fn coefficients(picture: usize) -> [f32; 2] {
    if picture.is_multiple_of(PICTURES) {
        return [0.0, 0.0];
    }
    let first = noise(picture * 13 + 5);
    [first, 0.9 * first + 0.1 * noise(picture * 29 + 1)]
}

fn landmarks(picture: usize) -> Vec<f32> {
    let moved = coefficients(picture);
    let point = |landmark: usize| {
        let mut point: [f32; 3] = core::array::from_fn(|axis| FACE[3 * landmark + axis]);
        for ((_, own, far), coefficient) in MOVES.iter().zip(moved) {
            point[1] += if *own == landmark { far * coefficient } else { 0.0 };
        }
        let jitter = |axis: usize| noise(picture * 1009 + landmark * 31 + axis * 7) - 0.5;
        core::array::from_fn::<f32, 3, _>(|axis| point[axis] + 0.3 * jitter(axis))
    };
    (0..LANDMARKS).flat_map(point).collect()
}

fn weights(picture: usize) -> Vec<f32> {
    let moved: BTreeMap<&str, f32> = MOVES.iter().map(|own| own.0).zip(coefficients(picture)).collect();
    BLENDSHAPES.iter().map(|name| moved.get(name).copied().unwrap_or(0.0)).collect()
}

/// Writes `faces.npz` and `names.json` with a number of subjects, and returns the path of the dataset.
fn write_dataset(folder: &Path, subjects: usize) -> String {
    let pictures = subjects * PICTURES;
    let path = folder.join("faces.npz");
    let mut npz = NpzWriter::create(&path).unwrap();
    let mut array = |name: &str, shape: &[u64], row: &dyn Fn(usize) -> Vec<f32>| {
        let shape: Vec<u64> = [pictures as u64].iter().chain(shape).copied().collect();
        let mut array =
            npz.array(name, FileOptions::default()).unwrap().default_dtype().shape(&shape).begin_nd().unwrap();
        array.extend((0..pictures).flat_map(row)).unwrap();
        array.finish().unwrap();
    };
    array("landmarks", &[LANDMARKS as u64, 3], &landmarks);
    array("weights", &[BLENDSHAPES.len() as u64], &weights);
    array("pose", &[3], &|picture| vec![noise(picture * 3), noise(picture * 5), noise(picture * 11)]);
    array("meta", &[5], &|picture| vec![0.0, 0.0, 0.0, 0.0, f32::from(u8::from(picture.is_multiple_of(PICTURES)))]);
    let shape = [pictures as u64];
    let mut numbers =
        npz.array("subject", FileOptions::default()).unwrap().default_dtype().shape(&shape).begin_nd().unwrap();
    numbers.extend((0..pictures).map(|picture| i32::try_from(picture / PICTURES).unwrap())).unwrap();
    numbers.finish().unwrap();
    npz.zip_writer().finish().unwrap();
    fs::write(folder.join("names.json"), serde_json::to_string(&BLENDSHAPES.as_slice()).unwrap()).unwrap();
    path.to_str().unwrap().to_owned()
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_facewire-fit")).current_dir(folder).args(arguments).output().unwrap()
}

/// Runs a command that must succeed and returns its standard output.
fn printed(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a command that must fail and returns its standard error.
fn refusal(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && !said.contains("panicked"), "{arguments:?}: {said}");
    said
}

/// Parses a CSV file to one map per row, from column name to value.
fn rows(csv: &str) -> Vec<BTreeMap<&str, &str>> {
    let mut lines = csv.lines().map(|line| line.split(','));
    let heads: Vec<&str> = lines.next().unwrap().collect();
    lines.map(|cells| heads.iter().copied().zip(cells).collect()).collect()
}

#[test]
fn each_blendshapes_own_landmark_is_found_and_partial_f_separates_correlated_blendshapes() {
    let folder = TempDir::new().unwrap();
    let dataset = write_dataset(folder.path(), SUBJECTS);
    let options = ["select", &dataset, "--svr-rows", "40", "--csv", "ranks.csv", "--out", "page.html"];
    let printed = self::printed(folder.path(), &options);
    let csv = fs::read_to_string(folder.path().join("ranks.csv")).unwrap();
    let rows = rows(&csv);
    assert_eq!(rows.len(), MOVES.len() * FEATURES, "blendshapes that do not move are left out");
    for (name, landmark, _) in MOVES {
        assert!(printed.lines().any(|line| line.contains(name)), "{printed}");
        let own = || rows.iter().filter(|row| row["blendshape"] == name);
        assert_eq!(own().filter(|row| row["kept"] == "1").count(), 30);
        let rank = |feature: &str, by: &str| own().find(|row| row["feature"] == feature).unwrap()[by].to_owned();
        let (right, wrong) = (format!("y{landmark}"), format!("y{}", MOVES.iter().find(|m| m.0 != name).unwrap().1));
        assert_eq!(rank(&right, "rank_f"), "1", "{name}");
        assert!(rank(&right, "rank_r").parse::<u32>().unwrap() <= 5, "{name}");
        let [by_r, by_f] = ["rank_r", "rank_f"].map(|by| rank(&wrong, by).parse::<u32>().unwrap());
        assert!(by_r <= 6 && by_f > 10, "{name}: {wrong} has rank {by_r} by r, {by_f} by F");
    }
    let page = fs::read_to_string(folder.path().join("page.html")).unwrap();
    assert_eq!(page.matches("<svg").count(), MOVES.len() * 6);
    assert!(!page.contains("src=") && !page.contains("<script") && !page.contains("<link"), "no external resources");

    self::printed(folder.path(), &["select", "--csv", "again.csv", &dataset, "--svr-rows", "40"]);
    assert!(fs::read_to_string(folder.path().join("again.csv")).unwrap() == csv, "the same data give the same table");
}

#[test]
fn blendshapes_and_percentile_can_be_chosen_and_invalid_ones_are_refused() {
    let folder = TempDir::new().unwrap();
    let dataset = write_dataset(folder.path(), SUBJECTS);
    let printed = printed(
        folder.path(),
        &["select", &dataset, "--blendshape", "jawOpen", "--percentile", "1", "--svr-rows", "20", "--csv", "ranks.csv"],
    );
    let is_kept = |line: &str| line.starts_with("| jawOpen ") && line.contains(" |   15 | ");
    assert!(printed.lines().any(is_kept) && !printed.contains("mouthShrugLower"), "{printed}");
    let refusal = |arguments: &[&str]| refusal(folder.path(), &[&["select", &dataset], arguments].concat());
    assert!(refusal(&["--blendshape", "jawOpened"]).contains("not a blendshape that landmarks show"));
    assert!(refusal(&["--blendshape", "jawLeft"]).contains("none of these blendshapes moves"));
    assert!(refusal(&["--percentile", "0"]).contains("from 0.1 to 50"));
}

#[test]
fn blendshapes_that_do_not_move_are_left_out_of_fit_and_report_and_named() {
    let folder = TempDir::new().unwrap();
    let dataset = write_dataset(folder.path(), SUBJECTS);
    for arguments in [["fit", &dataset, "--kinds", "pls,log-exp"], ["report", &dataset, "--kinds", "pls,log-exp"]] {
        let output = run(folder.path(), &arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        assert!(said.contains("do not move in the pictures: eyeBlinkLeft") && !said.contains("jawOpen"), "{said}");
        let printed = String::from_utf8(output.stdout).unwrap();
        assert!(arguments[0] == "report" || printed.lines().any(|line| line.starts_with("| jawOpen ")), "{printed}");
    }
}

#[test]
fn every_kind_of_formula_stores_the_same_numbers_for_a_feature() {
    let folder = TempDir::new().unwrap();
    let dataset = write_dataset(folder.path(), SUBJECTS);
    let options = ["--kinds", "exp,log-exp", "--blendshapes", "jawOpen", "--json", "figures.json"];
    printed(folder.path(), &[&["fit", &dataset], &options[..]].concat());
    let figures = fs::read_to_string(folder.path().join("figures.json")).unwrap();
    let figures: serde_json::Value = serde_json::from_str(&figures).unwrap();
    let trials = figures["blendshapes"][0]["trials"].as_array().unwrap();
    assert_eq!(trials.len(), 2);
    for trial in trials {
        // A weight and an index for every feature, and the offset.
        assert_eq!(trial["bytes"].as_u64().unwrap(), trial["features"].as_u64().unwrap() * 6 + 4);
        assert!(trial["nanoseconds"].as_f64().unwrap() > 0.0);
    }
}

/// Returns two numbers of the first table in `text` that has a line for `name`, by their columns.
fn numbers_of(text: &str, name: &str, columns: [usize; 2]) -> [f64; 2] {
    let line = text.lines().find(|line| line.starts_with(&format!("| {name} "))).unwrap();
    let cells: Vec<&str> = line.split('|').collect();
    columns.map(|column| cells[column].trim().parse().unwrap())
}

#[test]
fn judge_finds_in_an_exported_model_what_fit_stated() {
    let folder = TempDir::new().unwrap();
    let dataset = write_dataset(folder.path(), SUBJECTS);
    let cases = |text: &str| {
        let (known, unknown) = text.split_once("neutral face not known").unwrap();
        [known, unknown].map(str::to_owned)
    };
    for kinds in [&[][..], &["--kinds", "exp,log-exp"], &["--kinds", "poly"]] {
        // No limit of time, because a loaded machine may exceed any.
        let fit = ["fit", &dataset, "--nanoseconds", "1000000000", "--export", "model.toml"];
        let fitted = cases(&printed(folder.path(), &[&fit, kinds].concat()));
        let judged = cases(&printed(folder.path(), &["judge", &dataset, "--model", "model.toml"]));
        for (name, _, _) in MOVES {
            for (fitted, judged) in fitted.iter().zip(&judged) {
                let stated = numbers_of(fitted, name, [3, 4]);
                let found = numbers_of(judged, name, [2, 4]);
                let near = stated.iter().zip(found).all(|(one, other)| (one - other).abs() < 0.0015);
                assert!(near && found[0] > 0.8, "{kinds:?} {name}: {stated:?} {found:?}");
            }
        }
    }
    let refused = refusal(folder.path(), &["fit", &dataset, "--export", "model.toml", "--kinds", "knn"]);
    assert!(refused.contains("no formula was chosen"), "{refused}");
}

#[test]
fn fewer_than_eight_subjects_are_refused_if_some_must_be_held_out() {
    let folder = TempDir::new().unwrap();
    let dataset = write_dataset(folder.path(), 7);
    for command in ["judge", "train", "report", "select", "fit"] {
        let options = if command == "train" { &["--out", "model.toml"][..] } else { &[] };
        let said = refusal(folder.path(), &[&[command, &dataset], options].concat());
        assert!(said.contains("7 subjects are too few") && said.contains("--all-subjects"), "{command}: {said}");
    }
    let said = printed(folder.path(), &["judge", &dataset, "--all-subjects", "--resamples", "40"]);
    assert!(said.contains("7 people, 84 pictures; 2 blendshapes move"), "{said}");
}

#[test]
fn a_model_that_is_compared_with_itself_differs_by_nothing_in_text_and_files() {
    let folder = TempDir::new().unwrap();
    let dataset = write_dataset(folder.path(), 8);
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/../models/blendshapes.toml");
    let options = ["--all-subjects", "--resamples", "40", "--against", model, "--json", "a.json", "--csv", "a.csv"];
    let options = [&options[..], &["--page", "a.html"]].concat();
    let said = printed(folder.path(), &[&["judge", &dataset, "--model", model], &options[..]].concat());
    assert!(said.contains("+0.000 .. +0.000") && !said.contains("| * |"), "{said}");

    let page = fs::read_to_string(folder.path().join("a.html")).unwrap();
    assert!(
        page.contains("faces.npz, neutral face known") && page.contains("jawOpen") && !page.contains("eyeBlinkLeft")
    );
    assert!(!page.contains(">better<") && !page.contains("src=") && !page.contains("<script"));

    let json: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(folder.path().join("a.json")).unwrap()).unwrap();
    let state = &json["sets"][0]["neutral"]["neutral_face_known"];
    let jaw = |side: &str| state[side]["figures"]["jawOpen"]["all"]["mse"]["value"].as_f64().unwrap();
    assert!(jaw("model") > 0.0 && (jaw("model") - jaw("against")).abs() < 1e-12);
    let parts = ["mse_of_bias", "mse_of_gain", "mse_of_rest"];
    let parts = parts.map(|part| state["model"]["figures"]["jawOpen"]["all"][part]["value"].as_f64().unwrap());
    assert!((parts.iter().sum::<f64>() - jaw("model")).abs() < 1e-9, "the parts of the error add up");
    assert_eq!(state["difference"]["mean_of_blendshapes"]["all"]["r"]["certain"], false);

    let csv = fs::read_to_string(folder.path().join("a.csv")).unwrap();
    let rows = rows(&csv);
    assert_eq!(rows.len(), 2 * 2 * 8 * BLENDSHAPES.len() * 3);
    let own = |row: &&BTreeMap<&str, &str>| {
        row["model"] == "model"
            && row["neutral"] == "known"
            && row["blendshape"] == "jawOpen"
            && row["pictures"] == "all"
    };
    let mse: Vec<f64> = rows.iter().filter(own).map(|row| row["mse"].parse().unwrap()).collect();
    assert!((mse.iter().sum::<f64>() / 8.0 - jaw("model")).abs() < 1e-5, "people with equally many pictures");
}

#[test]
fn an_output_path_that_cannot_be_written_is_refused_before_the_dataset_is_read() {
    let folder = TempDir::new().unwrap();
    for arguments in [
        ["train", "absent.npz", "--out", "no/model.toml"],
        ["fit", "absent.npz", "--json", "no/figures.json"],
        ["judge", "absent.npz", "--json", "no/figures.json"],
        ["judge", "absent.npz", "--csv", "no/people.csv"],
        ["fit", "absent.npz", "--export", "no/model.toml"],
        ["report", "absent.npz", "--out", "no/report.html"],
        ["select", "absent.npz", "--out", "no/page.html"],
        ["select", "absent.npz", "--csv", "no/ranks.csv"],
    ] {
        assert!(refusal(folder.path(), &arguments).contains("cannot write no/"), "{arguments:?}");
    }
    assert!(refusal(folder.path(), &["train", "absent.npz", "--epochs", "0"]).contains("--epochs"));
}

#[test]
fn the_truth_of_a_clip_must_have_a_row_for_every_frame() {
    let folder = TempDir::new().unwrap();
    let dataset = write_dataset(folder.path(), 1);
    let row = ["0.1"; 56].join(",");
    let heads = format!("frame,yaw_deg,pitch_deg,roll_deg,{}", BLENDSHAPES.join(","));
    let write = |name: &str, rows: usize| {
        let rows = vec![row.as_str(); rows].join("\n");
        fs::write(folder.path().join(name), format!("{heads}\n{rows}\n")).unwrap();
    };
    write("whole.csv", PICTURES);
    write("short.csv", PICTURES - 1);
    let whole = printed(folder.path(), &["clip", &dataset, "--truth", "whole.csv"]);
    assert!(whole.contains("head pose"), "{whole}");
    assert!(refusal(folder.path(), &["clip", &dataset, "--truth", "short.csv"]).contains("short.csv has 11 rows"));
}
