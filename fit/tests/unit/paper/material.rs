use std::fs;

use anyhow::bail;
use facewire_fit::paper::material::*;
use tempfile::TempDir;

fn signal(truth: Vec<f64>, clip_frames: usize) -> Signal {
    let clips = (0..truth.len()).step_by(clip_frames).map(|first| first..first + clip_frames).collect();
    Signal { blendshape: "jawOpen", raw: truth.clone(), truth, clips, rest_frames: REST_FRAMES }
}

#[test]
fn the_liveliest_frames_are_of_one_clip() {
    let truth = (0..300).map(|frame| if frame < 160 { 0.0 } else { f64::from(frame % 2) }).collect();
    assert_eq!(signal(truth, 150).lively(), 150..300, "a clip is shorter than six seconds");
    let truth = (0..800).map(|frame| if frame < 415 { 0.0 } else { f64::from(frame % 2) }).collect();
    let found = signal(truth, 400).lively();
    assert!(found.len() == 180 && found.start >= 415, "{found:?}");
}

#[test]
fn autocorrelation_of_a_known_ar_1_series_is_its_parameter_whatever_the_seams_of_clips() {
    let mut random = fastrand::Rng::with_seed(3);
    for parameter in [0.3, 0.9] {
        let mut value = 0.0;
        let next = |frame: i32| {
            value = parameter * value + random.f64() - 0.5;
            // The second clip lies higher, and the third does not vary.
            [value, value + 9.0, 4.0][frame as usize / 10_000]
        };
        let series: Vec<f64> = (0..30_000).map(next).collect();
        let found = signal(series.clone(), 10_000).autocorrelation(&series, 1)[1];
        assert!((found - parameter).abs() < 0.02, "{found} for {parameter}");
    }
}

#[test]
fn a_folder_is_made_once_and_anew_after_an_interruption_or_with_another_note() {
    let folder = TempDir::new().unwrap();
    let made = folder.path().join("made");
    let make = |note: &str, file: &'static str| {
        once(&made, note, || {
            fs::write(made.join(file), "")?;
            if file == "half" { bail!("interrupted") } else { Ok(()) }
        })
    };
    let files = || {
        let mut names: Vec<_> = fs::read_dir(&made).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    assert!(make("edition 1", "half").is_err());
    make("edition 1", "whole").unwrap();
    assert_eq!(files(), ["command.txt", "whole"], "what was left unfinished is gone");
    make("edition 1", "again").unwrap();
    assert_eq!(files(), ["command.txt", "whole"], "made before");
    make("edition 2", "new").unwrap();
    assert_eq!(files(), ["command.txt", "new"]);
    fs::remove_file(made.join("command.txt")).unwrap();
    assert!(make("edition 2", "other").is_err());
    assert_eq!(files(), ["new"], "files of others are neither removed nor used");
}
