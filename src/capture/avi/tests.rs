#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use turbojpeg::Subsamp;

use super::super::testing::{avi, avi_header, chunk, jpeg, list};
use super::*;

fn frame() -> Vec<u8> {
    let mut frame = jpeg(16, 8, Subsamp::Sub2x2);
    frame.resize(frame.len() | 1, 0);
    frame
}

fn open(bytes: &[u8]) -> Result<AviSource<&[u8]>, CaptureError> {
    AviSource::open(bytes, "film")
}

/// Returns the numbers of the intact frames, and the errors.
fn play(bytes: &[u8]) -> (Vec<u64>, Vec<CaptureError>) {
    let (mut numbers, mut errors) = (Vec::new(), Vec::new());
    let mut source = open(bytes).unwrap();
    loop {
        match source.next() {
            Ok(Some(frame)) => numbers.push(frame.number),
            Ok(None) => return (numbers, errors),
            Err(error) => errors.push(error),
        }
    }
}

#[test]
fn frames_of_the_video_stream_carry_their_time() {
    let film = avi(16, 8, &[frame(), frame()]);
    let mut source = open(&film).unwrap();
    assert_eq!(source.describe().to_string(), "film: MJPEG 16x8 at 30 fps");
    assert_eq!(source.frame_period_us(), Some(33_333));
    let times: Vec<_> = (0..2).map(|_| source.next().unwrap().unwrap().captured_us).collect();
    assert_eq!(times, [0, 33_333]);
    assert!(source.next().unwrap().is_none());
}

#[test]
fn every_truncation_gives_the_frames_before_it_and_one_error_with_its_offset() {
    let film = avi(16, 8, &[frame(), frame(), frame()]);
    let starts: Vec<_> = film.windows(4).enumerate().filter(|(_, id)| id == b"01dc").map(|(at, _)| at).collect();
    let movi = starts[0];
    let index = film.windows(4).rposition(|id| id == b"idx1").unwrap();
    for length in 0..movi {
        assert!(matches!(open(&film[..length]), Err(CaptureError::Avi(_))) || length == movi, "{length}");
    }
    for length in movi..index + 8 {
        let complete = starts.iter().filter(|&start| start + 8 + frame().len() <= length).count();
        let (numbers, errors) = play(&film[..length]);
        assert_eq!(numbers.len(), complete, "{length}");
        let [CaptureError::CutShort { frame, offset }] = errors[..] else { unreachable!("{length}: {errors:?}") };
        assert_eq!((frame, offset), (complete as u64, length as u64));
    }
    for length in index + 8..=film.len() {
        assert_eq!(play(&film[..length]).1.len(), 0, "nothing is lost with the index");
    }
}

#[test]
fn a_bad_frame_is_counted_and_the_next_one_follows() {
    let mut broken = frame();
    broken.truncate(100);
    let (numbers, errors) = play(&avi(16, 8, &[frame(), broken, frame()]));
    assert_eq!(numbers, [0, 2]);
    assert!(matches!(errors[..], [CaptureError::Frame { number: 1, fault: FrameFault::Incomplete }]));
}

#[test]
fn a_frame_that_is_too_large_is_skipped() {
    let huge = vec![0; 200_000];
    let (numbers, errors) = play(&avi(16, 8, &[huge.clone(), frame()]));
    assert_eq!(numbers, [1]);
    assert!(matches!(errors[..], [CaptureError::Frame { number: 0, fault: FrameFault::TooLarge }]));
    let film = avi(16, 8, &[huge]);
    let (_, errors) = play(&film[..film.len() - 1000]);
    assert!(matches!(errors[..], [CaptureError::CutShort { frame: 0, .. }]));
}

#[test]
fn a_dropped_frame_keeps_its_number_and_time() {
    let (numbers, errors) = play(&avi(16, 8, &[frame(), Vec::new(), frame()]));
    assert_eq!((numbers, errors.len()), (vec![0, 2], 0));
}

#[test]
fn a_recording_without_sizes_is_read_to_its_end() {
    let mut film = avi(16, 8, &[frame(), frame()]);
    film[4..8].copy_from_slice(&[0; 4]);
    let movi = film.windows(4).position(|id| id == b"movi").unwrap();
    film[movi - 4..movi].copy_from_slice(&[0xff; 4]);
    let index = film.windows(4).rposition(|id| id == b"idx1").unwrap();
    let (numbers, errors) = play(&film[..index]);
    assert_eq!((numbers, errors.len()), (vec![0, 1], 0));
}

#[test]
fn all_parts_of_an_opendml_film_are_read_and_data_behind_them_is_not() {
    let mut film = avi(16, 8, &[frame()]);
    let groups = list(b"LIST", b"rec ", &[chunk(b"01dc", &frame()), chunk(b"01dc", &frame())]);
    film.extend(list(b"RIFF", b"AVIX", &[list(b"LIST", b"movi", &[groups])]));
    film.extend(chunk(b"01dc", &frame()));
    let (numbers, errors) = play(&film);
    assert_eq!((numbers, errors.len()), (vec![0, 1, 2], 0));
}

#[test]
fn other_files_are_refused_with_their_reason() {
    let reason = |bytes: &[u8]| open(bytes).unwrap_err().to_string();
    let movi = list(b"LIST", b"movi", &[]);
    let film = |header| list(b"RIFF", b"AVI ", &[header, movi.clone()]);
    assert!(reason(&list(b"RIFF", b"WAVE", &[chunk(b"data", &[0; 9])])).contains("is not an AVI file"));
    assert!(reason(&film(avi_header(16, 8, b"H264"))).contains("is not Motion-JPEG"));
    assert!(reason(&film(chunk(b"JUNK", &[]))).contains("has no video stream"));
    assert!(reason(&film(avi_header(5000, 8, b"MJPG"))).contains("5000x8"));
    assert!(reason(&list(b"RIFF", b"AVI ", &[avi_header(16, 8, b"MJPG")])).contains("has no pictures"));
}

#[test]
fn a_damaged_byte_causes_neither_a_panic_nor_an_endless_film() {
    let film = avi(16, 8, &[frame(), frame()]);
    for at in 0..film.len() {
        let mut damaged = film.clone();
        damaged[at] ^= 0xff;
        let Ok(mut source) = open(&damaged) else {
            continue;
        };
        let items = std::iter::from_fn(|| source.next().map(|frame| frame.map(|_| ())).transpose());
        assert!(items.take(10).count() < 10);
    }
}
