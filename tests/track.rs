//! The input and the output of `facewire track`, and what it says of input that is damaged or missing.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::path::PathBuf;
use std::sync::LazyLock;

use common::coefficients::{Row, difference, rows};
use common::film::{HEADER as Y4M_HEADER, demo_avi, demo_y4m, empty_y4m};
use common::points::{read_npy, write_npy};
use common::program::{Run, facewire, text};
use facewire_face::LANDMARKS;
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
    head_yaw_deg,head_pitch_deg,head_roll_deg,head_x_mm,head_y_mm,head_z_mm,\
    visibility_left_eye,visibility_right_eye,visibility_brows,visibility_mouth,visibility_cheeks,visibility_face";

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
    fn solved(&self, options: &[&str]) -> Vec<Row> {
        let run = Run::of(facewire(["track", text(&self.landmarks), "--fps", "30"]).args(options));
        rows(&run.succeeded().out)
    }
}

fn track_stream(stream: &[u8]) -> Run {
    Run::fed(&mut facewire(["track", "-"]), stream)
}

fn track_file(name: &str, bytes: &[u8]) -> Run {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    Run::of(&mut facewire(["track", text(&path)]))
}

#[test]
fn the_csv_has_the_promised_header_and_a_row_for_every_frame_with_6_decimals() {
    assert_eq!(DEMO.csv.lines().next(), Some(HEADER));
    let rows = rows(&DEMO.csv);
    assert!(rows.iter().map(|row| row.frame).eq(0..240));
    for (row, line) in rows.iter().zip(DEMO.csv.lines().skip(1)) {
        assert!((row.time_s - row.frame as f64 / 30.0).abs() < 2e-6, "{row:?}");
        assert_eq!((row.state.as_str(), row.values.len()), ("live", 52 + 6 + 6));
        assert!(row.coefficients().iter().all(|value| (0.0..=1.0).contains(value)), "{row:?}");
        let decimals = line.split(',').filter_map(|field| Some(field.split_once('.')?.1.len()));
        assert!(decimals.eq([6; 1 + 52 + 6 + 6]), "{line}");
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

#[test]
fn on_a_lower_step_a_frame_that_is_left_out_repeats_the_row_before() {
    let rows = rows(&Run::of(&mut facewire(["track", "demo", "--step", "third"])).succeeded().out);
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
    let (full, turns) =
        (rows(&DEMO.csv), rows(&Run::of(&mut facewire(["track", "demo", "--step", "turns"])).succeeded().out));
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
fn a_face_that_leaves_the_picture_is_held_and_then_decays_to_neutral_and_its_landmarks_are_not_a_number() {
    let file = tempfile::NamedTempFile::with_suffix(".npy").unwrap();
    let stream = [demo_y4m(12), empty_y4m(60).split_off(Y4M_HEADER.len())].concat();
    let run = Run::fed(&mut facewire(["track", "-", "--landmarks", text(file.path())]), &stream).succeeded();
    let rows = rows(&run.out);
    assert_eq!(rows.len(), 72);
    let mut states: Vec<&str> = rows.iter().map(|row| row.state.as_str()).collect();
    states.dedup();
    assert_eq!(states, ["live", "hold", "decay", "neutral"]);
    assert_eq!(rows[13].coefficients(), rows[12].coefficients(), "held");
    assert!(rows[71].coefficients().iter().all(|value| *value == 0.0));
    for (frame, landmarks) in read_npy(file.path()).iter().enumerate() {
        assert!(landmarks.0.as_flattened().iter().all(|value| value.is_nan() == (frame >= 12)), "frame {frame}");
    }
}

#[test]
fn a_face_stays_live_for_three_frame_periods_without_a_pose_also_at_few_frames_a_second() {
    let mut points = read_npy(&DEMO.landmarks);
    points.truncate(12);
    for missing in [4, 7, 8] {
        points[missing].0.as_flattened_mut().fill(f32::NAN);
    }
    let values: Vec<f32> = points.iter().flat_map(|face| face.0.as_flattened().to_vec()).collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("points.npy");
    fs::write(&path, write_npy(&[12, 478, 3], &values)).unwrap();
    for fps in ["5", "10"] {
        let run = Run::of(&mut facewire(["track", text(&path), "--fps", fps])).succeeded();
        let rows = rows(&run.out);
        assert!(rows.iter().all(|row| row.state == "live"), "{fps}: {}", run.out);
        assert_eq!(rows[4].coefficients(), rows[3].coefficients(), "held at {fps}");
    }
}

#[test]
fn an_input_that_is_cut_off_gives_the_rows_before_the_cut() {
    let (y4m, avi) = (demo_y4m(4), fs::read(demo_avi()).unwrap());
    for (whole, run) in [
        (3, track_stream(&y4m[..y4m.len() - 1])),
        (3, track_file("cut.y4m", &y4m[..y4m.len() - 1000])),
        (8, track_file("cut.avi", &avi[..100_000])),
    ] {
        let sentence = run.sentence(65);
        assert!(sentence.contains("cut short at byte") && sentence.contains(&format!("in frame {whole}")));
        assert!(run.out.lines().eq(DEMO.csv.lines().take(1 + whole)), "{}", run.out);
    }
    let points = fs::read(&DEMO.landmarks).unwrap();
    let run = track_file("cut.npy", &points[..128 + 5 * LANDMARKS * 12 + 1000]);
    assert!(run.sentence(65).contains("cut short in frame 5"), "{}", run.err);
    assert_eq!(rows(&run.out), DEMO.solved(&[])[..5]);
}

#[test]
fn a_damaged_frame_keeps_its_row_and_the_next_frames_follow() {
    let mut avi = fs::read(demo_avi()).unwrap();
    let frames: Vec<usize> =
        (0..avi.len() - 10).filter(|&at| avi[at..].starts_with(b"00dc") && avi[at + 8] == 0xff).collect();
    avi[frames[6] + 8..][..2].fill(0);
    avi.truncate(frames[9]);
    let run = track_file("damaged.avi", &avi);
    let rows = rows(&run.out);
    assert!(rows.iter().map(|row| row.frame).eq(0..9), "{}", run.err);
    assert!(run.err.contains("9 frames, 8 with a face, 1 damaged"), "{}", run.err);
    assert_eq!(rows[6].coefficients(), rows[5].coefficients(), "what the service would send");
}

#[test]
fn an_input_of_which_no_frame_can_be_read_fails_with_the_reason_and_one_without_a_face_is_named() {
    assert_eq!(
        track_stream(Y4M_HEADER.as_bytes()).sentence(65),
        "standard input has no frame; record or convert it again"
    );
    let mut avi = fs::read(demo_avi()).unwrap();
    for at in 0..avi.len() - 10 {
        if avi[at..].starts_with(b"00dc") {
            avi[at + 8] = 0;
        }
    }
    let run = track_file("damaged.avi", &avi);
    assert!(run.sentence(65).contains("damaged.avi could be read (the last: it is not a JPEG image); "), "{}", run.err);
    let run = track_stream(&empty_y4m(4)).succeeded();
    assert_eq!(rows(&run.out).len(), 4);
    assert!(run.err.contains("facewire: no frame of standard input shows a face; check that "), "{}", run.err);
}

#[test]
fn bytes_of_a_video_that_belong_to_no_frame_are_counted() {
    let mut avi = fs::read(demo_avi()).unwrap();
    let frames: Vec<usize> =
        (0..avi.len() - 10).filter(|&at| avi[at..].starts_with(b"00dc") && avi[at + 8] == 0xff).collect();
    avi.truncate(frames[4]);
    avi.splice(frames[2]..frames[2], [7; 100]);
    avi[4..8].fill(0);
    let movi = avi.windows(4).position(|id| id == b"movi").unwrap();
    avi[movi - 4..movi].fill(0);
    let run = track_file("stray.avi", &avi).succeeded();
    assert!(run.out.lines().eq(DEMO.csv.lines().take(5)));
    assert!(run.err.contains("stray.avi: bytes that belong to no frame and were passed over: 100"), "{}", run.err);
}

#[test]
fn a_file_that_is_no_film_and_no_landmarks_is_refused_with_the_reason() {
    let points = write_npy(&[1, 478, 3], &[0.0_f32; 478 * 3]);
    let header = |replaced: &str, by: &str| {
        // The padding keeps the length.
        let padding = " ".repeat(by.len() - replaced.len());
        let header = String::from_utf8(points[10..128].to_vec()).unwrap();
        let header = header.replacen(&padding, "", 1).replacen(replaced, by, 1);
        [&points[..10], header.as_bytes(), &points[128..]].concat()
    };
    let no_npy = "is not a .npy file of plain numbers";
    for (name, content, reason) in [
        ("text.avi", b"a letter\n".to_vec(), "neither an AVI nor a y4m"),
        ("nothing.y4m", Vec::new(), "neither an AVI nor a y4m"),
        ("riff.avi", b"RIFF".to_vec(), "the AVI file"),
        ("huge.y4m", b"YUV4MPEG2 W99999 H99999 F30:1\nFRAME\n".to_vec(), "each side must be 1 to 4096"),
        ("points.npy", write_npy(&[2, 468, 3], &[0.0_f32; 2 * 468 * 3]), "has shape [2, 468, 3]"),
        ("points.npy", write_npy(&[478, 3], &[0.0_f32; 478 * 3]), "has shape [478, 3]"),
        ("points.npy", write_npy(&[1, 478, 3], &[0_i32; 478 * 3]), "holds numbers of the kind `<i4`"),
        ("points.npy", write_npy(&[1, 478, 3], &[0_i64; 478 * 3]), "floating-point numbers of 32 or 64 bits"),
        ("points.npy", b"a letter".to_vec(), "is not a .npy file"),
        ("points.npy", Vec::new(), "is not a .npy file"),
        ("points.npy", header("False", "True "), "Fortran order"),
        ("points.npy", header("(1, 478, 3)", "(9999999999999999, 478, 3)"), ""),
        ("points.npy", header("(1, 478, 3)", "(18446744073709551615, 478, 3)"), ""),
        // These headers would keep their parser busy.
        ("points.npy", [&b"\x93NUMPY\x01\x00\x28\x00"[..], &[b'{'; 40]].concat(), no_npy),
        ("points.npy", [&b"\x93NUMPY\x01\x00\x98\x3a"[..], &[b'('; 15_000]].concat(), no_npy),
        ("points.npy", b"\x93NUMPY\x02\0\xff\xff\xff\xff".to_vec(), no_npy),
    ] {
        let run = track_file(name, &content);
        assert!(run.sentence(65).contains(reason), "{name}: {}", run.err);
        assert!(run.out.lines().count() <= 2, "{}", run.out);
    }
    assert!(track_stream(b"a letter\n").sentence(65).contains("does not begin with YUV4MPEG2"));
}

#[test]
fn inputs_outputs_and_options_that_cannot_be_used_are_named_with_their_own_exit_statuses() {
    let points = text(&DEMO.landmarks);
    let folder = env!("CARGO_MANIFEST_DIR");
    for (arguments, status, told) in [
        (&["nowhere/film.avi"][..], 66, "nowhere/film.avi"),
        (&["nowhere/points.npy"], 66, "nowhere/points.npy"),
        (&[folder], 66, folder),
        (&[points, "--out", "/nowhere/x.csv"], 74, "cannot write /nowhere/x.csv: "),
        (&[points, "--out", "/"], 74, "cannot write /: "),
        (&[points, "--landmarks", "/nowhere/x.npy"], 74, "cannot write /nowhere/x.npy: "),
        (&[points, "--out", "/dev/full"], 74, "No space left on device"),
        (&[points, "--landmarks", "/dev/full"], 74, "No space left on device"),
        (&["demo", "--neutral", "500..600"], 65, "--neutral 500..600: the input has 240 frames; give a range within"),
    ] {
        let run = Run::of(facewire(["track"]).args(arguments));
        assert!(run.sentence(status).contains(told), "{}", run.err);
    }
    let run = Run::fed(&mut facewire(["track", "-", "--neutral", "0..2"]), &empty_y4m(4));
    assert!(run.sentence(65).starts_with("--neutral 0..2: none of these frames shows a face; "), "{}", run.err);
    for [option, value, hint] in [
        ["--neutral", "5..5", "such as 0..30"],
        ["--fps", "0", "from 0.1 to 1000"],
        ["--size", "640", "such as 640x480"],
        ["--stage", "cooked", "raw, corrected, smoothed"],
    ] {
        let run = Run::of(&mut facewire(["track", "demo", option, value]));
        assert!(run.status == Some(2) && run.err.contains(hint), "{}", run.err);
    }
}
