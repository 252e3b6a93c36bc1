//! Landmarks through the whole program against MediaPipe's, frame by frame.
//!
//! `golden/` has MediaPipe's for the built-in clip. Where the folder of reference clips is at hand (`FACEWIRE_SHARED`,
//! or `shared` beside this checkout), films of people are compared too.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::path::{Path, PathBuf};
use std::process::Stdio;
use std::sync::LazyLock;

use common::film::{decode, demo_avi};
use common::points::{Distance, read_npy, read_npz, read_steps};
use common::program::{Run, facewire, text};
use common::{shared, skip};
use facewire::face::Landmarks;
use tempfile::NamedTempFile;

/// Largest mean distance from MediaPipe's landmarks in the picture.
const MEAN_PX: f64 = 0.3;
/// Largest distance of any point, in the picture and in depth.
const WORST_PX: f64 = 1.5;
/// A face may be lost or found so many frames earlier or later.
const FRAMES_APART: usize = 3;

/// Landmarks of the built-in clip.
static DEMO: LazyLock<Vec<Landmarks>> = LazyLock::new(|| track("demo", Stdio::null()));

/// The landmarks that `facewire track` writes for a film.
fn track(input: &str, stdin: Stdio) -> Vec<Landmarks> {
    let file = NamedTempFile::with_suffix(".npy").unwrap();
    let mut command = facewire(["track", input, "--landmarks", text(file.path())]);
    Run::ended(&command.stdin(stdin).output().unwrap()).succeeded();
    read_npy(file.path())
}

/// The landmarks of a film that ffmpeg decodes; `None` without ffmpeg.
fn track_decoded(film: &Path, options: &[&str]) -> Option<Vec<Landmarks>> {
    let mut decoder = decode(film, options)?;
    let landmarks = track("-", decoder.stdout.take().unwrap().into());
    assert!(decoder.wait().unwrap().success());
    Some(landmarks)
}

/// Ours and MediaPipe's landmarks of a reference film; `None`, having said why, where something for it is missing.
fn reference(test: &str, film: &str, golden: &str) -> Option<[Vec<Landmarks>; 2]> {
    let Some(shared) = shared() else {
        skip(test, "no folder of reference clips; set FACEWIRE_SHARED");
        return None;
    };
    let Some(ours) = track_decoded(&shared.join("footage").join(film), &["-pix_fmt", "yuv420p"]) else {
        skip(test, "no ffmpeg");
        return None;
    };
    Some([ours, read_npz(&shared.join("golden").join(golden))])
}

fn golden() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/demo-landmarks.npy")
}

/// Tells how far the landmarks of a film are from MediaPipe's; `cargo test --test golden -- --nocapture` shows it.
fn told(clip: &str, ours: &[Landmarks], theirs: &[Landmarks]) -> Distance {
    let distance = Distance::between(ours, theirs);
    let Distance { frames, mean_px, worst_px, .. } = distance;
    println!("{clip}: {frames} frames with a face, mean distance {mean_px:.2} px, worst {worst_px:.2} px");
    distance
}

/// Checks the demands on landmarks over as many frames with a face.
fn assert_near(clip: &str, ours: &[Landmarks], theirs: &[Landmarks], frames: usize) {
    let distance = told(clip, ours, theirs);
    assert_eq!(distance.frames, frames);
    assert!(distance.mean_px <= MEAN_PX, "{distance:?}");
    assert!(distance.worst_px <= WORST_PX, "{distance:?}");
    assert!(distance.worst_depth_px <= WORST_PX, "{distance:?}");
}

#[test]
fn every_8th_frame_of_the_clip_is_as_mediapipe_sees_it() {
    let ours: Vec<Landmarks> = DEMO.iter().step_by(8).cloned().collect();
    assert_near("built-in, every 8th frame", &ours, &read_steps(&golden()), 30);
}

#[test]
fn every_frame_of_the_clip_is_as_mediapipe_sees_it() {
    let Some(shared) = shared() else {
        return skip("every_frame_of_the_clip", "no folder of reference clips; set FACEWIRE_SHARED");
    };
    assert_near("built-in", &DEMO, &read_npz(&shared.join("golden/demo-mediapipe.npz")), 240);
}

#[test]
fn a_person_who_speaks_is_as_mediapipe_sees_it() {
    if let Some([ours, theirs]) = reference("a_person_who_speaks", "single_face.mp4", "single_face-mediapipe.npz") {
        assert_near("a person speaking", &ours, &theirs, 72);
    }
}

#[test]
fn a_person_who_leaves_is_lost_when_mediapipe_loses_it() {
    let Some([ours, theirs]) = reference("a_person_who_leaves", "face_noface.mov", "face_noface-mediapipe.npz") else {
        return;
    };
    let [ours_changes, theirs_changes] = [&ours, &theirs].map(|film| changes(film));
    assert!(!theirs_changes.is_empty());
    assert_eq!(ours_changes.len(), theirs_changes.len(), "{ours_changes:?} {theirs_changes:?}");
    for (ours, theirs) in ours_changes.iter().zip(&theirs_changes) {
        assert!(ours.abs_diff(*theirs) <= FRAMES_APART, "{ours_changes:?} {theirs_changes:?}");
    }
    let distance = told("a person who leaves", &ours, &theirs);
    println!("a person who leaves: a face comes or goes in frames {ours_changes:?}, by MediaPipe {theirs_changes:?}");
    assert!(distance.frames > 60 && distance.mean_px <= MEAN_PX, "{distance:?}");
}

/// The frames at which a face comes or goes.
fn changes(film: &[Landmarks]) -> Vec<usize> {
    (1..film.len()).filter(|&frame| film[frame].is_finite() != film[frame - 1].is_finite()).collect()
}

/// Black and white at 16 and 235 or at 0 and 255: the stream says which. Taken for the other, the mean is 0.29 px.
#[test]
fn a_film_of_either_luma_range_gives_the_same_landmarks() {
    for (range, format) in [("limited", "yuv420p"), ("full", "yuvj420p")] {
        let options = ["-frames:v", "24", "-pix_fmt", format];
        let Some(ours) = track_decoded(&demo_avi(), &options) else {
            return skip("a_film_of_either_luma_range", "no ffmpeg");
        };
        let distance = Distance::between(&ours, &DEMO[..24]);
        assert!(distance.mean_px <= 0.22 && distance.worst_px <= WORST_PX, "{range}: {distance:?}");
    }
}
