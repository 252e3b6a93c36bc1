//! The input and the output of `facewire track`.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::path::PathBuf;
use std::process::Stdio;
use std::sync::LazyLock;

use common::coefficients::{Row, difference, rows};
use common::film::{decode, demo_avi, demo_y4m, empty_y4m};
use common::points::read_npy;
use common::program::{Run, facewire, text, track_stream};
use common::skip;
use facewire_face::Landmarks;
use tempfile::TempDir;

/// The header of the CSV, on which other programs rely.
const HEADER: &str = "frame,time_s,state,\
    eyeBlinkLeft,eyeLookDownLeft,eyeLookInLeft,eyeLookOutLeft,eyeLookUpLeft,eyeSquintLeft,eyeWideLeft,\
    eyeBlinkRight,eyeLookDownRight,eyeLookInRight,eyeLookOutRight,eyeLookUpRight,eyeSquintRight,eyeWideRight,\
    jawForward,jawLeft,jawRight,jawOpen,mouthClose,mouthFunnel,mouthPucker,mouthLeft,mouthRight,\
    mouthSmileLeft,mouthSmileRight,mouthFrownLeft,mouthFrownRight,mouthDimpleLeft,mouthDimpleRight,\
    mouthStretchLeft,mouthStretchRight,mouthRollLower,mouthRollUpper,mouthShrugLower,mouthShrugUpper,\
    mouthPressLeft,mouthPressRight,mouthLowerDownLeft,mouthLowerDownRight,mouthUpperUpLeft,mouthUpperUpRight,\
    browDownLeft,browDownRight,browInnerUp,browOuterUpLeft,browOuterUpRight,cheekPuff,cheekSquintLeft,\
    cheekSquintRight,noseSneerLeft,noseSneerRight,tongueOut,\
    head_yaw_deg,head_pitch_deg,head_roll_deg,head_x_mm,head_y_mm,head_z_mm";

/// Output for the built-in clip, which all tests share.
struct Demo {
    csv: String,
    landmarks: PathBuf,
    _folder: TempDir,
}

static DEMO: LazyLock<Demo> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let [csv, landmarks] = ["demo.csv", "demo.npy"].map(|name| folder.path().join(name));
    let run = Run::of(&mut facewire(["track", "demo", "--out", text(&csv), "--landmarks", text(&landmarks)]));
    assert!(run.succeeded().out.is_empty());
    Demo { csv: fs::read_to_string(csv).unwrap(), landmarks, _folder: folder }
});

impl Demo {
    /// Tracks the landmarks of the clip with these options.
    fn solved(&self, options: &[&str]) -> Vec<Row> {
        let run = Run::of(facewire(["track", text(&self.landmarks), "--fps", "30"]).args(options));
        rows(&run.succeeded().out)
    }
}

#[test]
fn the_csv_has_the_promised_header_and_a_row_for_every_frame() {
    assert_eq!(DEMO.csv.lines().next(), Some(HEADER));
    let rows = rows(&DEMO.csv);
    assert!(rows.iter().map(|row| row.frame).eq(0..240));
    for row in &rows {
        assert!((row.time_s - row.frame as f64 / 30.0).abs() < 2e-6, "{row:?}");
        assert_eq!((row.state.as_str(), row.values.len()), ("live", 52 + 6));
        assert!(row.coefficients().iter().all(|value| (0.0..=1.0).contains(value)), "{row:?}");
    }
}

#[test]
fn every_number_of_the_csv_has_6_decimals() {
    for line in DEMO.csv.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').collect();
        let numbers = fields.iter().enumerate().filter(|(column, _)| ![0, 2].contains(column));
        for (_, number) in numbers {
            assert_eq!(number.split_once('.').map(|(_, decimals)| decimals.len()), Some(6), "{number}");
        }
    }
}

/// The face of the clip blinks, opens its jaw, smiles and turns to both sides.
#[test]
fn coefficients_and_pose_follow_the_movements_of_the_clip() {
    let rows = rows(&DEMO.csv);
    let most = |name| rows.iter().map(|row| row.coefficient(name)).fold(0.0, f64::max);
    for name in ["eyeBlinkLeft", "eyeBlinkRight", "jawOpen", "mouthSmileLeft", "mouthSmileRight", "browInnerUp"] {
        assert!(most(name) > 0.5, "{name} {}", most(name));
    }
    let yaw_deg: Vec<f64> = rows.iter().map(|row| row.values[52]).collect();
    assert!(yaw_deg.iter().any(|yaw| *yaw > 10.0) && yaw_deg.iter().any(|yaw| *yaw < -10.0), "{yaw_deg:?}");
}

/// Tracks the clip on a lower step.
fn on_step(step: &str) -> Vec<Row> {
    rows(&Run::of(&mut facewire(["track", "demo", "--step", step])).succeeded().out)
}

#[test]
fn on_a_lower_step_a_frame_that_is_left_out_repeats_the_row_before() {
    let rows = on_step("third");
    assert!(rows.iter().map(|row| row.frame).eq(0..240));
    for three in rows.chunks(3) {
        assert!(three.iter().all(|row| row.values == three[0].values));
        assert!(three.iter().all(|row| (row.time_s - row.frame as f64 / 30.0).abs() < 2e-6));
    }
    assert!(rows.windows(2).filter(|pair| pair[0].values != pair[1].values).count() >= 70);
}

/// A blink of the clip lasts for a few frames, so that each eye is seen once or twice in it.
#[test]
fn while_lips_and_eyes_take_turns_a_blink_still_closes() {
    let (full, turns) = (rows(&DEMO.csv), on_step("turns"));
    for name in ["eyeBlinkLeft", "eyeBlinkRight", "jawOpen"] {
        let most = |rows: &[Row]| rows.iter().map(|row| row.coefficient(name)).fold(0.0, f64::max);
        assert!(most(&turns) > 0.85 * most(&full), "{name}: {} instead of {}", most(&turns), most(&full));
    }
    let [mean, _] = difference(&full, &turns);
    assert!((0.001..0.05).contains(&mean), "{mean}");
}

#[test]
fn landmarks_give_the_same_coefficients_as_their_film_where_the_model_reads_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("landmarks.toml");
    let shipped = include_str!("../models/blendshapes.toml");
    fs::write(&path, shipped.split_once("[appearance]").unwrap().0).unwrap();
    let model = ["--model", text(&path)];
    let film = rows(&Run::of(facewire(["track", "demo"]).args(model)).succeeded().out);
    let points = DEMO.solved(&model);
    assert!(difference(&film, &points)[1] <= 1e-4);
    assert!(difference(&rows(&DEMO.csv), &points)[1] > 0.01, "the shipped model also reads how the face looks");
    let same = |a: &Row, b: &Row| (a.frame, &a.state) == (b.frame, &b.state) && (a.time_s - b.time_s).abs() < 2e-6;
    assert!(film.iter().zip(&points).all(|(a, b)| same(a, b)));
}

#[test]
fn each_stage_of_the_solver_changes_the_coefficients() {
    let [raw, corrected, smoothed] = ["raw", "corrected", "smoothed"].map(|stage| DEMO.solved(&["--stage", stage]));
    assert!(difference(&raw, &corrected)[1] > 0.01);
    assert!(difference(&corrected, &smoothed)[1] > 0.01);
    assert_eq!(smoothed, DEMO.solved(&[]));
}

#[test]
fn with_the_wearers_neutral_face_a_resting_face_has_lower_coefficients() {
    let (without, with) = (DEMO.solved(&[]), DEMO.solved(&["--neutral", "0..8"]));
    let rest = |rows: &[Row]| rows[..8].iter().flat_map(|row| row.coefficients().to_vec()).sum::<f64>() / (8.0 * 52.0);
    assert!(rest(&with) < 0.5 * rest(&without), "{} {}", rest(&with), rest(&without));
    assert!(difference(&without[8..], &with[8..])[0] > 0.01);
}

#[test]
fn a_y4m_stream_of_the_same_samples_gives_the_same_rows() {
    let run = track_stream(&demo_y4m(12)).succeeded();
    assert!(run.err.starts_with("facewire: 12 frames, 12 with a face in "), "{}", run.err);
    assert!(run.out.lines().eq(DEMO.csv.lines().take(13)));
}

#[test]
fn the_clip_decoded_by_ffmpeg_gives_nearly_the_same_rows() {
    let Some(mut decoder) = decode(&demo_avi(), &["-pix_fmt", "yuv420p", "-frames:v", "60"]) else {
        return skip("there is no ffmpeg");
    };
    let stream = Stdio::from(decoder.stdout.take().unwrap());
    let run = Run::ended(&facewire(["track", "-"]).stdin(stream).output().unwrap()).succeeded();
    decoder.wait().unwrap();
    let [mean, worst] = difference(&rows(&run.out), &rows(&DEMO.csv)[..60]);
    assert!(mean < 0.01 && worst < 0.3, "{mean} {worst}");
}

#[test]
fn a_face_that_leaves_the_picture_is_held_and_then_decays_to_neutral() {
    let stream = [demo_y4m(12), empty_y4m(60).split_off(common::film::HEADER.len())].concat();
    let rows = rows(&track_stream(&stream).succeeded().out);
    assert_eq!(rows.len(), 72);
    let mut states: Vec<&str> = rows.iter().map(|row| row.state.as_str()).collect();
    states.dedup();
    assert_eq!(states, ["live", "hold", "decay", "neutral"]);
    assert_eq!(rows[13].coefficients(), rows[12].coefficients(), "held");
    assert!(rows[71].coefficients().iter().all(|value| *value == 0.0));
}

#[test]
fn a_film_without_a_face_is_neutral_throughout() {
    let run = track_stream(&empty_y4m(3)).succeeded();
    let rows = rows(&run.out);
    assert_eq!(rows.len(), 3);
    assert!(rows.iter().all(|row| row.state == "neutral" && row.coefficients().iter().all(|value| *value == 0.0)));
}

#[test]
fn landmarks_of_frames_without_a_face_are_not_a_number() {
    let file = tempfile::NamedTempFile::with_suffix(".npy").unwrap();
    Run::fed(&mut facewire(["track", "-", "--landmarks", text(file.path())]), &empty_y4m(2)).succeeded();
    let landmarks: Vec<Landmarks> = read_npy(file.path());
    assert_eq!(landmarks.len(), 2);
    assert!(landmarks.iter().all(|face| face.0.as_flattened().iter().all(|value| value.is_nan())));
}
