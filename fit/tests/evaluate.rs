//! `facewire-fit evaluate` on the output of `facewire track` for the built-in clip, and on invalid files; `judge` on that
//! clip.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::indexing_slicing)]

#[path = "../../tests/common/skip.rs"]
mod skip;

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use facewire_face::stages::Mesh;
use serde_json::Value;
use tempfile::TempDir;

/// The curves that the built-in clip was rendered from.
const DEMO_TRUTH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/demo-truth.csv");

fn folder() -> TempDir {
    tempfile::tempdir().unwrap()
}

fn evaluate(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_facewire-fit")).arg("evaluate").args(arguments).output().unwrap()
}

/// Runs a command that must succeed and returns its standard output.
fn printed(arguments: &[&str]) -> String {
    let output = evaluate(arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a command that must fail and returns its standard error.
fn refusal(arguments: &[&str]) -> String {
    let output = evaluate(arguments);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && !said.contains("panicked"), "{said}");
    said
}

fn figures(track: &str, truth: &str, options: &[&str]) -> Value {
    let folder = folder();
    let json = folder.path().join("figures.json");
    printed(&[&[track, truth, "--json", json.to_str().unwrap()], options].concat());
    serde_json::from_str(&fs::read_to_string(json).unwrap()).unwrap()
}

/// The built-in clip, tracked once for all tests. `csv` is `None` if no networks can be run.
struct Demo {
    csv: Option<PathBuf>,
    _folder: TempDir,
}

static DEMO: LazyLock<Demo> = LazyLock::new(|| {
    let folder = folder();
    let csv = folder.path().join("demo.csv");
    let command = ["facewire", "track", "demo", "--out", csv.to_str().unwrap()];
    let _ = facewire_tools::run(command.map(OsString::from));
    let rows = fs::read_to_string(&csv).map_or(0, |text| text.lines().count());
    Demo { csv: (rows > 1).then_some(csv), _folder: folder }
});

/// Returns the tracked clip. If the networks cannot be run, notes why and returns `None`.
fn demo() -> Option<&'static str> {
    if let Err(error) =
        facewire_face::engine(facewire_face::EngineChoice::Auto, "", 1).and_then(|engine| Mesh::load(engine.as_ref()))
    {
        skip::skip(&error.to_string());
        return None;
    }
    Some(DEMO.csv.as_deref().and_then(Path::to_str).expect("track writes the clip"))
}

#[test]
fn jaw_and_blinks_of_the_built_in_clip_follow_the_truth() {
    let Some(track) = demo() else { return };
    let found = figures(track, DEMO_TRUTH, &[]);
    assert_eq!(found["frames"], 240);
    for name in ["jawOpen", "eyeBlinkLeft", "eyeBlinkRight"] {
        let own = &found["blendshapes"][name]["figures"];
        let at_least = |figure: &str, least: f64| {
            let value = own[figure].as_f64().unwrap();
            assert!(value >= least, "{name}, {figure}: {value}");
        };
        at_least("pearson", 0.8);
        at_least("spearman", 0.7);
        at_least("xi", 0.45);
        at_least("accuracy", 0.8);
        at_least("f1", 0.7);
        assert!(own["msd"].as_f64().unwrap() < 0.04, "{name}: {own}");
    }
}

#[test]
fn all_curves_of_the_built_in_clip_correlate_above_0_7_on_average() {
    let Some(track) = demo() else { return };
    let found = figures(track, DEMO_TRUTH, &["--shift", "auto"]);
    assert!(found["mean_of_moving"]["pearson"].as_f64().unwrap() > 0.7, "{}", found["mean_of_moving"]);
    assert!(found["shift_frames"].as_i64().unwrap().abs() <= 3);
}

#[test]
fn judge_gives_a_clip_the_figures_that_track_and_evaluate_give_it() {
    let Some(track) = demo() else { return };
    let wanted = figures(track, DEMO_TRUTH, &[]);
    let folder = folder();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../src/capture/demo.avi"), path("demo.avi")).unwrap();
    fs::copy(DEMO_TRUTH, path("demo.csv")).unwrap();
    let json = path("figures.json");
    let judge = ["judge", folder.path().to_str().unwrap(), "--resamples", "40", "--json", &json];
    let output = Command::new(env!("CARGO_BIN_EXE_facewire-fit")).args(judge).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let found: Value = serde_json::from_str(&fs::read_to_string(json).unwrap()).unwrap();
    let state = |name: &str| &found["sets"][0]["neutral"][name]["model"]["figures"]["mean_of_people"]["all"];
    let value = |state: &Value, figure: &str| state[figure]["value"].as_f64().unwrap();
    for (figure, name) in [("r", "pearson"), ("mse", "msd")] {
        let own = value(state("neutral_face_not_known"), figure);
        let wanted = wanted["mean_of_moving"][name].as_f64().unwrap();
        assert!((own - wanted).abs() < 2e-4, "{figure}: {own} instead of {wanted}");
    }
    assert!(value(state("neutral_face_known"), "r") > value(state("neutral_face_not_known"), "r"));
}

#[test]
fn a_curve_matches_itself_perfectly_and_a_lag_of_6_frames_is_found() {
    let folder = folder();
    let row = |time: f64, late: f64| format!("{time},{}\n", 0.5 - 0.5 * ((time - late) * 3.0).cos());
    let write = |name: &str, rate: f64, late: f64| {
        let rows = (0..600).map(|row| f64::from(row) / rate).take_while(|time| *time < 9.01);
        let path = folder.path().join(name);
        fs::write(&path, format!("time_s,jawOpen\n{}", rows.map(|time| row(time, late)).collect::<String>())).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let (itself, late, faster) = (write("a", 30.0, 0.0), write("b", 30.0, 0.2), write("c", 60.0, 0.0));
    let own = figures(&itself, &itself, &[]);
    assert_eq!(own["blendshapes"]["jawOpen"]["figures"]["pearson"], 1.0);
    assert_eq!(own["blendshapes"]["jawOpen"]["figures"]["f1"], 1.0);
    let found = figures(&late, &faster, &["--shift", "auto"]);
    assert_eq!(found["shift_frames"], 6);
    assert!(found["blendshapes"]["jawOpen"]["figures"]["pearson"].as_f64().unwrap() > 0.999);
}

#[test]
fn a_live_link_face_recording_is_matched_by_name_and_time() {
    let folder = folder();
    let [recording, track] = ["live-link.csv", "track.csv"].map(|name| folder.path().join(name));
    let value = |row: u32| f64::from(row % 40) / 40.0;
    let live_link: String = (0..120)
        .map(|row| format!("23:59:{}:{}.25,61,0.0,{}\n", 56 + row / 30, row % 30 * 2, value(row)))
        .collect::<Vec<_>>()
        .concat();
    let ours: String = (0..120)
        .map(|row| format!("{row},{},live,{},0.0\n", f64::from(row) / 30.0, value(row)))
        .collect::<Vec<_>>()
        .concat();
    fs::write(&recording, format!("Timecode,BlendShapeCount,JawRight,JawLeft\n{live_link}")).unwrap();
    fs::write(&track, format!("frame,time_s,state,jawLeft,jawRight\n{ours}")).unwrap();
    let found = figures(track.to_str().unwrap(), recording.to_str().unwrap(), &[]);
    assert!((found["truth_hz"].as_f64().unwrap() - 30.0).abs() < 0.01);
    assert!(found["blendshapes"]["jawLeft"]["figures"]["pearson"].as_f64().unwrap() > 0.999);
    assert_eq!(found["blendshapes"]["jawRight"]["moves"], false);
}

#[test]
fn annotated_events_replace_those_derived_from_the_truth() {
    let folder = folder();
    let events = folder.path().join("events.csv");
    fs::write(&events, "blendshape,frame\njawOpen,20\njawOpen,200\n").unwrap();
    let found = figures(DEMO_TRUTH, DEMO_TRUTH, &["--events", events.to_str().unwrap()]);
    assert_eq!(found["blendshapes"]["jawOpen"]["events"]["reference"], 2);
    assert_eq!(found["blendshapes"]["eyeBlinkLeft"]["events"], Value::Null);
}

#[test]
fn invalid_files_are_refused_with_the_reason() {
    let folder = folder();
    let write = |name: &str, content: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, content).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let short = write("short.csv", b"frame,jawOpen\n0,0.1\n1,0.2\n2,0.3\n");
    let other = write("other.csv", b"frame,x\n0,0.1\n1,0.2\n");
    let picture = write("picture.png", b"\x89PNG\r\n\x1a\n\xff\xfe\xfd,\xff\n\xff\xff");
    assert!(refusal(&[&short, DEMO_TRUTH]).contains("--overlap"));
    assert!(refusal(&[&other, DEMO_TRUTH]).contains("no column of a blendshape"));
    assert!(refusal(&[&picture, DEMO_TRUTH]).contains("not a CSV file"));
    assert!(refusal(&["absent.csv", DEMO_TRUTH]).contains("cannot read absent.csv"));
    assert!(refusal(&[DEMO_TRUTH, DEMO_TRUTH, "--shift", "soon"]).contains("number of frames or `auto`"));
}
