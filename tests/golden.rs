//! Compares the landmarks of every engine with those of MediaPipe, frame by frame.
//!
//! `golden/` holds MediaPipe's landmarks for the built-in clip. Where the folder of reference clips exists
//! (`FACEWIRE_SHARED`, or `shared` beside this checkout), films of people are compared as well. To see the distances,
//! run `cargo test --test golden -- --nocapture`.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::io::BufReader;
use std::path::Path;
use std::sync::LazyLock;

use common::film::{decode, demo_avi, read_y4m};
use common::points::{Distance, read_npy, read_npz, read_steps};
use common::{project, shared, skip};
use facewire::capture::{Clip, Source};
use facewire_face::Engine;
use facewire_face::Picture;
use facewire_face::{LANDMARKS, Landmarks, Tracker};

/// Largest mean distance from MediaPipe's landmarks in the picture, and of any point in the picture and in depth.
const MEAN_PX: f64 = 0.3;
const WORST_PX: f64 = 1.5;
/// The same between the landmarks of two engines in the same region.
const ENGINES_MEAN_PX: f64 = 0.02;
const ENGINES_WORST_PX: f64 = 0.1;
/// Largest differences between the values of the feature map that two engines find, in the mean and of any value, over so
/// many frames. The standard deviation of the values is 1.4.
const APPEARANCE_MEAN: f64 = 0.01;
const APPEARANCE_WORST: f64 = 0.3;
const APPEARANCE_FRAMES: usize = 20;
/// Largest number of frames between the moments at which an engine and MediaPipe lose or find a face.
const FRAMES_APART: usize = 3;
/// The number of frames of the clip that the face must be followed through at least, on an emulated processor.
const LEAST_TRACKED: usize = 80;
const NO_FACE: Landmarks = Landmarks([[f32::NAN; 3]; LANDMARKS]);

/// Every engine of this build.
static ENGINES: LazyLock<Vec<Box<dyn Engine>>> = LazyLock::new(|| {
    let engines = facewire_face::stages::engines("", 1).unwrap_or_else(|error| panic!("{error}"));
    assert!(!engines.is_empty(), "this build has no engine");
    engines
});

/// Follows the face through the first frames of a film whose pictures pass through `alter`.
fn track(engine: &dyn Engine, film: &mut dyn Source, most: usize, alter: fn(Picture) -> Picture) -> Vec<Landmarks> {
    let mut tracker = Tracker::load(engine).unwrap_or_else(|error| panic!("{}: {error}", engine.name()));
    let mut faces = Vec::new();
    while faces.len() < most
        && let Some(frame) = film.next().unwrap()
    {
        let picture = alter(*frame.picture().unwrap());
        let region = tracker.detect(&picture, 0).unwrap();
        let landmarks = region.and_then(|region| tracker.landmarks(&picture, &region).unwrap());
        faces.push(landmarks.cloned().unwrap_or(NO_FACE));
    }
    faces
}

/// The same samples, of which black and white are read otherwise.
fn with_other_range(picture: Picture) -> Picture {
    Picture::new(picture.width(), picture.height(), picture.pixels(), !picture.full_range()).unwrap()
}

fn track_demo(engine: &dyn Engine, most: usize) -> Vec<Landmarks> {
    track(engine, &mut Clip::once().unwrap(), most, |picture| picture)
}

/// Follows the face through a film that ffmpeg decodes. Returns `None` without ffmpeg.
fn track_decoded(
    engine: &dyn Engine,
    film: &Path,
    options: &[&str],
    alter: fn(Picture) -> Picture,
) -> Option<Vec<Landmarks>> {
    let mut decoder = decode(film, options)?;
    let stream = BufReader::new(decoder.stdout.take().unwrap());
    let landmarks = track(engine, &mut read_y4m(stream), usize::MAX, alter);
    assert!(decoder.wait().unwrap().success());
    Some(landmarks)
}

/// Returns the landmarks of a reference film by an engine and by MediaPipe. If the film or ffmpeg is missing, reports that
/// the test is skipped and returns `None`.
fn reference(engine: &dyn Engine, film: &str) -> Option<[Vec<Landmarks>; 2]> {
    let Some(shared) = shared() else {
        skip("no folder of reference clips; set FACEWIRE_SHARED");
        return None;
    };
    let path = shared.join("footage").join(film);
    let Some(ours) = track_decoded(engine, &path, &["-pix_fmt", "yuv420p"], |picture| picture) else {
        skip("no ffmpeg");
        return None;
    };
    let golden = format!("golden/{}-mediapipe.npz", path.file_stem().unwrap().to_str().unwrap());
    Some([ours, read_npz(&shared.join(golden))])
}

/// Measures and prints how far an engine's landmarks of a film are from MediaPipe's.
fn measure(engine: &str, film: &str, ours: &[Landmarks], theirs: &[Landmarks]) -> Distance {
    let distance = Distance::between(ours, theirs);
    let Distance { frames, mean_px, worst_px, .. } = distance;
    println!("{engine}, {film}: {frames} frames with a face, mean distance {mean_px:.2} px, worst {worst_px:.2} px");
    distance
}

/// Checks the distances, and that both see a face in exactly `frames` frames.
fn assert_near(engine: &str, film: &str, ours: &[Landmarks], theirs: &[Landmarks], frames: usize) {
    let distance = measure(engine, film, ours, theirs);
    let is_near = distance.mean_px <= MEAN_PX && distance.worst_px <= WORST_PX && distance.worst_depth_px <= WORST_PX;
    assert!(distance.frames == frames && is_near, "{engine}, {film}: {distance:?}");
}

/// Compares every 8th frame of the clip, and every frame if the folder of reference clips exists. `packaging/try` gives a file
/// with the landmarks that `facewire track` has found on an emulated processor, of the first [`LEAST_TRACKED`] frames at least.
/// They are then compared in place of those of this build.
#[test]
fn the_clip_is_as_mediapipe_sees_it() {
    let golden = read_steps(&project("tests/golden/demo-landmarks.npy"));
    let assert_near = |engine: &str, demo: Vec<Landmarks>| {
        let ours: Vec<Landmarks> = demo.iter().step_by(8).cloned().collect();
        assert_near(engine, "every 8th frame of the built-in clip", &ours, &golden[..ours.len()], ours.len());
        if let Some(shared) = shared() {
            let golden = read_npz(&shared.join("golden/demo-mediapipe.npz"));
            assert_near(engine, "the built-in clip", &demo, &golden[..demo.len()], demo.len());
        }
    };
    if let Some(tracked) = std::env::var_os("FACEWIRE_TRACKED") {
        let tracked = read_npy(Path::new(&tracked));
        assert!(tracked.len() >= LEAST_TRACKED, "{} frames were tracked", tracked.len());
        return assert_near("on an emulated processor", tracked);
    }
    for engine in &*ENGINES {
        let demo = track_demo(&**engine, 240);
        assert_eq!(demo.len(), 240);
        assert_near(&engine.name(), demo);
    }
}

#[test]
fn a_person_who_speaks_is_as_mediapipe_sees_it() {
    for engine in ENGINES.iter().map(|engine| &**engine) {
        let Some([ours, theirs]) = reference(engine, "single_face.mp4") else { return };
        assert_near(&engine.name(), "a person who speaks", &ours, &theirs, 72);
    }
}

#[test]
fn a_person_who_leaves_is_lost_when_mediapipe_loses_them() {
    for engine in ENGINES.iter().map(|engine| &**engine) {
        let Some([ours, theirs]) = reference(engine, "face_noface.mov") else { return };
        // The frames at which a face appears or disappears.
        let changes = [&ours, &theirs].map(|faces| -> Vec<usize> {
            (1..faces.len()).filter(|&frame| faces[frame].is_finite() != faces[frame - 1].is_finite()).collect()
        });
        let [ours_changes, theirs_changes] = &changes;
        assert!(!theirs_changes.is_empty() && ours_changes.len() == theirs_changes.len(), "{changes:?}");
        let mut pairs = ours_changes.iter().zip(theirs_changes);
        assert!(pairs.all(|(a, b)| a.abs_diff(*b) <= FRAMES_APART), "{}: {changes:?}", engine.name());
        let distance = measure(&engine.name(), "a person who leaves", &ours, &theirs);
        println!("the face appears or disappears in frames {ours_changes:?}, with MediaPipe in {theirs_changes:?}");
        assert!(distance.frames > 60 && distance.mean_px <= MEAN_PX, "{}: {distance:?}", engine.name());
    }
}

/// All engines get the regions that the last engine of the list finds, so that differences do not add up from frame to
/// frame.
#[test]
fn engines_find_the_same_landmarks_and_appearance_in_the_same_regions() {
    let (last, others) = ENGINES.split_last().unwrap();
    let mut reference = Tracker::load(&**last).unwrap_or_else(|error| panic!("{}: {error}", last.name()));
    let map = |tracker: &Tracker| tracker.face().unwrap().appearance.unwrap().skin.clone();
    for engine in others {
        let (mut tracker, mut clip) = (Tracker::load(&**engine).unwrap(), Clip::once().unwrap());
        let (mut found, mut expected, mut differences) = (Vec::new(), Vec::new(), Vec::new());
        reference.forget();
        while let Some(frame) = clip.next().unwrap() {
            let picture = frame.picture().unwrap();
            let region = reference.detect(picture, 0).unwrap().unwrap();
            expected.push(reference.landmarks(picture, &region).unwrap().unwrap().clone());
            found.push(tracker.landmarks(picture, &region).unwrap().unwrap().clone());
            if expected.len() > APPEARANCE_FRAMES {
                continue;
            }
            let (ours, theirs) = (map(&tracker), map(&reference));
            let pairs = ours.as_flattened().iter().zip(theirs.as_flattened());
            differences.extend(pairs.map(|(ours, theirs)| f64::from((ours - theirs).abs())));
        }
        let distance = Distance::between(&found, &expected);
        let mean = differences.iter().sum::<f64>() / differences.len() as f64;
        let worst = differences.iter().copied().fold(0.0, f64::max);
        let told = format!(
            "{} and {} in the same regions: {distance:?}, values of the map differ by {mean:.1e}, at most {worst:.1e}",
            engine.name(),
            last.name()
        );
        println!("{told}");
        let is_near = distance.worst_px <= ENGINES_WORST_PX && distance.worst_depth_px <= ENGINES_WORST_PX;
        assert!(is_near && distance.mean_px <= ENGINES_MEAN_PX && distance.frames == expected.len(), "{told}");
        assert!(mean <= APPEARANCE_MEAN && worst <= APPEARANCE_WORST, "{told}");
    }
}

/// A y4m stream states whether black and white are 16 and 235 or 0 and 255. Both ranges give the same landmarks. A picture
/// that is read with the wrong range gives other landmarks.
#[test]
fn a_film_of_either_luma_range_gives_the_same_landmarks() {
    for engine in &*ENGINES {
        let demo = track_demo(&**engine, 24);
        for (range, format) in [("limited", "yuv420p"), ("full", "yuvj420p")] {
            let distance = |alter| {
                let options = ["-frames:v", "24", "-pix_fmt", format];
                let ours = track_decoded(&**engine, &demo_avi(), &options, alter)?;
                Some(Distance::between(&ours, &demo))
            };
            let Some(right) = distance(|picture| picture) else {
                return skip("no ffmpeg");
            };
            let wrong = distance(with_other_range).unwrap();
            println!("{}, {range} range: {right:?}, if mistaken {wrong:?}", engine.name());
            let is_same = right.mean_px < wrong.mean_px && right.worst_px <= WORST_PX && wrong.worst_px > WORST_PX;
            assert!(is_same, "{}, {range} range: {right:?}, if mistaken {wrong:?}", engine.name());
        }
    }
}
