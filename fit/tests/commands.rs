//! Commands of `facewire-fit` on a small synthetic dataset, in which two correlated blendshapes each move a landmark of
//! their own, and the other 49 do not move; and `evaluate` and `judge` on the built-in clip as `facewire track` tracks it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing, clippy::cast_possible_truncation)]

#[path = "../../tests/common/skip.rs"]
mod skip;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::BufReader;
use std::process::{Command, Output};
use std::sync::LazyLock;

use facewire_face::stages::Mesh;
use facewire_face::{BLENDSHAPES, LANDMARKS};
use npyz::{NpyFile, WriterBuilder, npz::NpzWriter, zip::write::FileOptions};
use serde_json::Value;
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

/// Writes `faces.npz` and `names.json` with a number of subjects to a new folder.
fn with_dataset(subjects: usize) -> TempDir {
    let (folder, pictures) = (TempDir::new().unwrap(), subjects * PICTURES);
    let mut npz = NpzWriter::create(folder.path().join("faces.npz")).unwrap();
    let mut array = |name: &str, shape: &[u64], row: &dyn Fn(usize) -> Vec<f32>| {
        let shape: Vec<u64> = [pictures as u64].iter().chain(shape).copied().collect();
        let array = npz.array(name, FileOptions::default()).unwrap();
        let mut array = array.default_dtype().shape(&shape).begin_nd().unwrap();
        array.extend((0..pictures).flat_map(row)).unwrap();
        array.finish().unwrap();
    };
    array("landmarks", &[LANDMARKS as u64, 3], &landmarks);
    array("weights", &[BLENDSHAPES.len() as u64], &weights);
    array("pose", &[3], &|picture| vec![noise(picture * 3), noise(picture * 5), noise(picture * 11)]);
    array("meta", &[5], &|picture| vec![0.0, 0.0, 0.0, 0.0, f32::from(u8::from(picture.is_multiple_of(PICTURES)))]);
    let numbers = npz.array("subject", FileOptions::default()).unwrap();
    let mut numbers = numbers.default_dtype().shape(&[pictures as u64]).begin_nd().unwrap();
    numbers.extend((0..pictures).map(|picture| (picture / PICTURES) as i32)).unwrap();
    numbers.finish().unwrap();
    npz.zip_writer().finish().unwrap();
    write(&folder, "names.json", serde_json::to_string(&BLENDSHAPES.as_slice()).unwrap());
    folder
}

fn write(folder: &TempDir, name: &str, content: impl AsRef<[u8]>) {
    fs::write(folder.path().join(name), content).unwrap();
}

fn read(folder: &TempDir, name: &str) -> String {
    fs::read_to_string(folder.path().join(name)).unwrap()
}

fn run(folder: &TempDir, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_facewire-fit")).current_dir(folder.path()).args(arguments).output().unwrap()
}

/// Runs a command that must succeed and returns its standard output.
fn printed(folder: &TempDir, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a command that must fail and returns its standard error.
fn refusal(folder: &TempDir, arguments: &[&str]) -> String {
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
    let folder = with_dataset(SUBJECTS);
    let options = ["select", "faces.npz", "--svr-rows", "40", "--csv", "ranks.csv", "--out", "page.html"];
    let printed = self::printed(&folder, &options);
    let csv = read(&folder, "ranks.csv");
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
    let page = read(&folder, "page.html");
    assert_eq!(page.matches("<svg").count(), MOVES.len() * 6);
    assert!(!page.contains("src=") && !page.contains("<script") && !page.contains("<link"), "no external resources");

    self::printed(&folder, &["select", "--csv", "again.csv", "faces.npz", "--svr-rows", "40"]);
    assert!(read(&folder, "again.csv") == csv, "the same data give the same table");
}

#[test]
fn blendshapes_and_percentile_can_be_chosen_and_invalid_ones_are_refused() {
    let folder = with_dataset(SUBJECTS);
    let options = ["--blendshape", "jawOpen", "--percentile", "1", "--svr-rows", "20"];
    let printed = printed(&folder, &[&["select", "faces.npz"], &options[..]].concat());
    let is_kept = |line: &str| line.starts_with("| jawOpen ") && line.contains(" |   15 | ");
    assert!(printed.lines().any(is_kept) && !printed.contains("mouthShrugLower"), "{printed}");
    let refusal = |arguments: &[&str]| refusal(&folder, &[&["select", "faces.npz"], arguments].concat());
    assert!(refusal(&["--blendshape", "jawOpened"]).contains("not a blendshape that landmarks show"));
    assert!(refusal(&["--blendshape", "jawLeft"]).contains("none of these blendshapes moves"));
    assert!(refusal(&["--percentile", "0"]).contains("from 0.1 to 50"));
}

#[test]
fn blendshapes_that_do_not_move_are_left_out_of_fit_and_report_and_named() {
    let folder = with_dataset(SUBJECTS);
    for arguments in [["fit", "faces.npz", "--kinds", "pls,log-exp"], ["report", "faces.npz", "--kinds", "pls,log-exp"]]
    {
        let output = run(&folder, &arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        assert!(said.contains("do not move in the pictures: eyeBlinkLeft") && !said.contains("jawOpen"), "{said}");
        let printed = String::from_utf8(output.stdout).unwrap();
        assert!(arguments[0] == "report" || printed.lines().any(|line| line.starts_with("| jawOpen ")), "{printed}");
    }
    let options = ["fit", "faces.npz", "--kinds", "exp,log-exp", "--blendshapes", "jawOpen", "--json", "figures.json"];
    printed(&folder, &options);
    let figures: Value = serde_json::from_str(&read(&folder, "figures.json")).unwrap();
    for trial in figures["blendshapes"][0]["trials"].as_array().unwrap() {
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
    let folder = with_dataset(SUBJECTS);
    let cases = |text: &str| {
        let (known, unknown) = text.split_once("neutral face not known").unwrap();
        [known, unknown].map(str::to_owned)
    };
    for kinds in [&[][..], &["--kinds", "exp,log-exp"], &["--kinds", "poly"]] {
        // No limit of time, because a loaded machine may exceed any.
        let fit = ["fit", "faces.npz", "--nanoseconds", "1000000000", "--export", "model.toml"];
        let fitted = cases(&printed(&folder, &[&fit, kinds].concat()));
        let judged = cases(&printed(&folder, &["judge", "faces.npz", "--model", "model.toml"]));
        for (name, _, _) in MOVES {
            for (fitted, judged) in fitted.iter().zip(&judged) {
                let stated = numbers_of(fitted, name, [3, 4]);
                let found = numbers_of(judged, name, [2, 4]);
                let near = stated.iter().zip(found).all(|(one, other)| (one - other).abs() < 0.0015);
                assert!(near && found[0] > 0.8, "{kinds:?} {name}: {stated:?} {found:?}");
            }
        }
    }
    let refused = refusal(&folder, &["fit", "faces.npz", "--export", "model.toml", "--kinds", "knn"]);
    assert!(refused.contains("no formula was chosen"), "{refused}");
}

#[test]
fn fewer_than_eight_subjects_are_refused_if_some_must_be_held_out() {
    let folder = with_dataset(7);
    for command in ["judge", "train", "report", "select", "fit"] {
        let options = if command == "train" { &["--out", "model.toml"][..] } else { &[] };
        let said = refusal(&folder, &[&[command, "faces.npz"], options].concat());
        assert!(said.contains("7 subjects are too few") && said.contains("--all-subjects"), "{command}: {said}");
    }
    let said = printed(&folder, &["judge", "faces.npz", "--all-subjects", "--resamples", "40"]);
    assert!(said.contains("7 people, 84 pictures; 2 blendshapes move"), "{said}");
}

#[test]
fn a_model_that_is_compared_with_itself_differs_by_nothing_in_text_and_files() {
    let folder = with_dataset(8);
    let model = concat!(env!("CARGO_MANIFEST_DIR"), "/../models/blendshapes.toml");
    let options = ["--all-subjects", "--resamples", "40", "--against", model, "--json", "a.json", "--csv", "a.csv"];
    let options = [&options[..], &["--page", "a.html"]].concat();
    let said = printed(&folder, &[&["judge", "faces.npz", "--model", model], &options[..]].concat());
    assert!(said.contains("+0.000 .. +0.000") && !said.contains("| * |"), "{said}");

    let page = read(&folder, "a.html");
    assert!(["faces.npz, neutral face known", "jawOpen"].iter().all(|text| page.contains(text)));
    assert!(!["eyeBlinkLeft", ">better<", "src=", "<script"].iter().any(|text| page.contains(text)));

    let json: Value = serde_json::from_str(&read(&folder, "a.json")).unwrap();
    let state = &json["sets"][0]["neutral"]["neutral_face_known"];
    let jaw = |side: &str| state[side]["figures"]["jawOpen"]["all"]["mse"]["value"].as_f64().unwrap();
    assert!(jaw("model") > 0.0 && (jaw("model") - jaw("against")).abs() < 1e-12);
    let parts = ["mse_of_bias", "mse_of_gain", "mse_of_rest"];
    let parts = parts.map(|part| state["model"]["figures"]["jawOpen"]["all"][part]["value"].as_f64().unwrap());
    assert!((parts.iter().sum::<f64>() - jaw("model")).abs() < 1e-9, "the parts of the error add up");
    assert_eq!(state["difference"]["mean_of_blendshapes"]["all"]["r"]["certain"], false);

    let csv = read(&folder, "a.csv");
    let rows = rows(&csv);
    assert_eq!(rows.len(), 2 * 2 * 8 * BLENDSHAPES.len() * 3);
    let own = |row: &&BTreeMap<&str, &str>| {
        let wanted = [("model", "model"), ("neutral", "known"), ("blendshape", "jawOpen"), ("pictures", "all")];
        wanted.iter().all(|(column, value)| row[column] == *value)
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
        ["paper", "absent.npz", "--out", "no/paper.html"],
    ] {
        assert!(refusal(&folder, &arguments).contains("cannot write no/"), "{arguments:?}");
    }
    assert!(refusal(&folder, &["train", "absent.npz", "--epochs", "0"]).contains("--epochs"));
}

/// The curves that the built-in clip was rendered from.
const DEMO_TRUTH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/demo-truth.csv");

/// The built-in clip, tracked once for all tests. The table is empty if no networks can be run.
static DEMO: LazyLock<TempDir> = LazyLock::new(|| {
    let folder = TempDir::new().unwrap();
    let csv = folder.path().join("demo.csv");
    let _ = facewire_tools::run(["facewire", "track", "demo", "--out", csv.to_str().unwrap()].map(OsString::from));
    folder
});

/// Returns the tracked clip. If the networks cannot be run, notes why and returns `None`.
fn demo() -> Option<String> {
    let engine = facewire_face::engine(facewire_face::EngineChoice::Auto, "", 1);
    if let Err(error) = engine.and_then(|engine| Mesh::load(engine.as_ref())) {
        skip::skip(&error.to_string());
        return None;
    }
    assert!(read(&DEMO, "demo.csv").lines().count() > 1, "track writes the clip");
    Some(DEMO.path().join("demo.csv").to_str().unwrap().to_owned())
}

fn evaluated(track: &str, options: &[&str]) -> Value {
    let folder = TempDir::new().unwrap();
    printed(&folder, &[&["evaluate", track, DEMO_TRUTH, "--json", "figures.json"], options].concat());
    serde_json::from_str(&read(&folder, "figures.json")).unwrap()
}

#[test]
fn jaw_and_blinks_of_the_built_in_clip_follow_the_truth_and_all_curves_correlate_above_0_7_on_average() {
    let Some(track) = demo() else { return };
    let found = evaluated(&track, &[]);
    assert_eq!(found["frames"], 240);
    for name in ["jawOpen", "eyeBlinkLeft", "eyeBlinkRight"] {
        let own = &found["blendshapes"][name]["figures"];
        let bounds = [("pearson", 0.8), ("spearman", 0.7), ("xi", 0.45), ("accuracy", 0.8), ("f1", 0.7)];
        for (figure, least) in bounds {
            assert!(own[figure].as_f64().unwrap() >= least, "{name}, {figure}: {own}");
        }
        assert!(own["msd"].as_f64().unwrap() < 0.04, "{name}: {own}");
    }
    let found = evaluated(&track, &["--shift", "auto"]);
    assert!(found["mean_of_moving"]["pearson"].as_f64().unwrap() > 0.7, "{}", found["mean_of_moving"]);
    assert!(found["shift_frames"].as_i64().unwrap().abs() <= 3);
}

/// Writes curves of 60 seconds in which every blendshape rises and falls in its own time.
fn write_curves(folder: &TempDir) {
    let wave = |frame: usize, shape: usize| (0.07 * (frame * (1 + shape % 5) + 14 * shape) as f64).sin();
    let row = |frame| (0..BLENDSHAPES.len()).map(move |shape| format!("{:.3}", wave(frame, shape).max(0.0) / 2.0));
    let rows = (0..1800).map(|frame| row(frame).collect::<Vec<_>>().join(",")).collect::<Vec<_>>();
    write(folder, "curves.csv", format!("{}\n{}\n", BLENDSHAPES.join(","), rows.join("\n")));
}

#[test]
fn the_page_of_the_paper_has_every_section_with_figures_of_what_is_rendered() {
    if demo().is_none() {
        return;
    }
    let folder = with_dataset(SUBJECTS);
    write_curves(&folder);
    let rig = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/rig");
    let textures = ["--skins", "young_lightskinned_male2", "--brows", "eyebrow001", "--eyes", "brown_eye"];
    let sources = [&["--rig", rig, "--curves", "curves.csv"], &textures[..]].concat();
    let printed =
        self::printed(&folder, &[&["paper", "faces.npz", "--quick", "--out", "page.html"], &sources[..]].concat());
    let page = read(&folder, "page.html");
    let sections =
        ["summary", "flow", "basis", "segmentation", "transformation", "regression", "correction", "smoothing"];
    for section in sections.into_iter().chain(["sine", "comparison", "pictures", "hardware", "ambiguous"]) {
        assert!(page.contains(&format!("id=\"{section}\"")), "{section}");
    }
    assert!(
        !["src=", "<script", "<link", ">NaN", "&gt;NaN"].iter().any(|text| page.contains(text)),
        "no external resources"
    );
    assert!(page.matches("<svg").count() >= 35, "{}", page.matches("<svg").count());
    let line = |name: &str| printed.lines().find(|line| line.starts_with(&format!("| {name}"))).expect(name).to_owned();
    let figure =
        |name: &str| line(name).split('|').nth(2).and_then(|cell| cell.trim().parse::<f64>().ok()).expect(name);
    assert!(figure("sine of JawOpen, as sent: r") > 0.9, "{printed}");
    assert!((0.2..1.6).contains(&figure("same: amplitude")), "{printed}");
    assert!(figure("OLS, SmileLeft of one avatar: R2") > 0.8, "{printed}");
    assert!(
        figure("gated average, N = 5: same value after, ms") > 0.0 && figure("memory, median, MB") > 10.0,
        "{printed}"
    );
}

#[test]
fn judge_gives_a_clip_the_figures_that_track_and_evaluate_give_it() {
    let Some(track) = demo() else { return };
    let wanted = evaluated(&track, &[]);
    let folder = TempDir::new().unwrap();
    let film = concat!(env!("CARGO_MANIFEST_DIR"), "/../src/capture/demo.avi");
    fs::copy(film, folder.path().join("demo.avi")).unwrap();
    fs::copy(DEMO_TRUTH, folder.path().join("demo.csv")).unwrap();
    printed(&folder, &["judge", ".", "--resamples", "40", "--json", "figures.json"]);
    let found: Value = serde_json::from_str(&read(&folder, "figures.json")).unwrap();
    let state = |name: &str| &found["sets"][0]["neutral"][name]["model"]["figures"]["mean_of_people"]["all"];
    let value = |state: &Value, figure: &str| state[figure]["value"].as_f64().unwrap();
    for (figure, name) in [("r", "pearson"), ("mse", "msd")] {
        let own = value(state("neutral_face_not_known"), figure);
        let wanted = wanted["mean_of_moving"][name].as_f64().unwrap();
        assert!((own - wanted).abs() < 2e-4, "{figure}: {own} instead of {wanted}");
    }
    assert!(value(state("neutral_face_known"), "mse") < value(state("neutral_face_not_known"), "mse"));
}
