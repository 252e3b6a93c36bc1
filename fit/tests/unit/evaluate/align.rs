use anyhow::Result;
use facewire_fit::evaluate::align::*;
use facewire_fit::recording::{CsvTable, Recording};
use facewire_fit::statistics::Event;

use crate::statistics::events::at;

fn recording(text: &str, fps: f64) -> Recording {
    Recording::of(&CsvTable::read(text.as_bytes()).unwrap(), fps).unwrap()
}

fn wave(fps: f64, length_s: f64, lag_s: f64) -> Recording {
    let times = (0..1000).map(|row| f64::from(row) / fps).take_while(|time| *time < length_s + 0.5 / fps);
    let value = |time: f64| ((time - lag_s) * 4.0).sin().mul_add(0.5, 0.5);
    let lines: Vec<String> = times.map(|time| format!("{time},{}\n", value(time))).collect();
    recording(&format!("time_s,jawOpen\n{}", lines.concat()), fps)
}

#[test]
fn a_truth_of_another_rate_is_interpolated() {
    let aligned = Aligned::new(&wave(30.0, 5.0, 0.0), &wave(100.0, 5.0, 0.0), 0).unwrap();
    assert_eq!(aligned.times_s.len(), 151);
    let worst = aligned.pairs[0].estimate.iter().zip(&aligned.pairs[0].truth).map(|(a, b)| (a - b).abs());
    assert!(worst.fold(0.0, f64::max) < 2e-4);
    let refused = same_length(&wave(30.0, 5.0, 0.0), &wave(100.0, 4.0, 0.0)).expect_err("another length");
    assert!(refused.to_string().contains("--overlap"), "{refused}");
}

#[test]
fn the_lag_is_found_to_the_frame() {
    let late = best(&wave(30.0, 8.0, 0.2), &wave(60.0, 8.0, 0.0)).unwrap();
    assert_eq!(late.shift_frames, 6);
    assert!(late.mean_correlation() > 0.999);
    let early = best(&wave(30.0, 8.0, -0.5), &wave(30.0, 8.0, 0.0)).unwrap();
    assert_eq!(early.shift_frames, -15);
}

#[test]
fn blendshapes_that_only_one_file_has_are_named() {
    let other = recording("time_s,jawOpen,jawLeft\n0,0,0\n5,1,1\n", 30.0);
    let aligned = Aligned::new(&wave(30.0, 5.0, 0.0), &other, 0).unwrap();
    assert_eq!(aligned.unmatched, [vec![], vec!["jawLeft"]]);
    let strange = recording("time_s,jawLeft\n0,0\n5,1\n", 30.0);
    assert!(Aligned::new(&wave(30.0, 5.0, 0.0), &strange, 0).is_err());
}

fn read(text: &str) -> Result<Annotations> {
    Annotations::of(&CsvTable::read(text.as_bytes())?, 30.0)
}

#[test]
fn events_may_be_given_in_seconds_or_frames_with_or_without_an_end() {
    let seconds = read("blendshape,time_s\njawOpen,0.5\nEyeBlinkLeft,2\njawOpen,1.5\n").unwrap();
    assert_eq!(seconds.of_blendshape("jawOpen"), Some(&[at(0.5), at(1.5)][..]));
    assert_eq!(seconds.of_blendshape("jawLeft"), None);
    assert_eq!(read("frame,blendshape\n15,jawOpen\n60,eyeBlinkLeft\n45,jawOpen\n").unwrap(), seconds);
    let ended = read("blendshape,frame,end_frame\njawOpen,15,60\njawOpen,90,\n").unwrap();
    assert_eq!(ended.0["jawOpen"], [Event { start_s: 0.5, end_s: 2.0 }, at(3.0)]);
}

#[test]
fn errors_name_the_line() {
    let refusal = |text| format!("{:#}", read(text).unwrap_err());
    assert!(refusal("blendshape,time_s\njawOpen,1\njawOpened,2\n").contains("line 3: `jawOpened`"));
    assert!(refusal("blendshape,time_s\njawOpen,soon\n").contains("line 2, column time_s: `soon`"));
    assert!(refusal("blendshape,time_s,end_s\njawOpen,2,1\n").contains("line 2: the event ends before"));
    assert!(refusal("blendshape,when\njawOpen,1\n").contains("time_s or frame"));
    assert!(refusal("blendshape,time_s\n").contains("no events"));
}
