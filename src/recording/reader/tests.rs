#![allow(clippy::unwrap_used, clippy::indexing_slicing)]

use std::fs;
use std::path::PathBuf;

use facewire_packet::Reason;

use super::*;
use crate::link::Pose;
use crate::recording::Writer;
use facewire_face::Landmarks;

/// A file name in a folder that is removed at the end.
fn file() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("face.fwrec");
    (folder, path)
}

/// Frames of a face that moves, 30 a second, and every tenth without a face.
fn frames(count: u64) -> Vec<Recorded> {
    let frame = |number: u64| {
        let time_us = 5_000_000 + number * 33_333;
        if number % 10 == 9 {
            return Recorded::nothing(time_us, Reason::NoFace);
        }
        let place = |index: usize| 200.0 + index as f32 * 0.5 + (number as f32 * 0.3 + index as f32).sin();
        let landmarks = Landmarks(core::array::from_fn(|index| [place(index), place(index + 9), place(index + 99)]));
        Recorded::new(time_us, &Pose::NEUTRAL, [640.0, 480.0], Some(&landmarks))
    };
    (0..count).map(frame).collect()
}

/// Writes the frames, and returns the size of the file and how many had room.
fn write(path: &Path, frames: &[Recorded], limit_bytes: u64) -> (u64, usize) {
    let mut writer = Writer::create(path, limit_bytes).unwrap();
    let taken = frames.iter().take_while(|frame| writer.push(frame).unwrap()).count();
    let bytes = writer.finish().unwrap();
    assert_eq!(writer.frames(), read(&fs::read(path).unwrap()).0.len() as u64, "frames without room do not count");
    (bytes, taken)
}

/// Reads frames up to the end or to an error.
fn read(bytes: &[u8]) -> (Vec<Recorded>, Option<RecordingError>) {
    let mut read = Vec::new();
    let mut reader = match Reader::new(bytes) {
        Ok(reader) => reader,
        Err(error) => return (read, Some(error)),
    };
    loop {
        match reader.next_frame() {
            Ok(Some(frame)) => read.push(frame),
            Ok(None) => return (read, None),
            Err(error) => return (read, Some(error)),
        }
    }
}

/// The frame as a recording that begins with frame 0 gives it back.
fn kept(frame: &Recorded) -> Recorded {
    let frame = Recorded { time_us: frame.time_us - 5_000_000, ..frame.clone() };
    Recorded::from_bytes(&frame.to_bytes()).unwrap()
}

#[test]
fn frames_are_read_back_with_their_times_in_a_third_of_the_space_of_their_landmarks() {
    let ((_folder, path), frames) = (file(), frames(100));
    let (bytes, taken) = write(&path, &frames, u64::MAX);
    assert_eq!((fs::metadata(&path).unwrap().len(), taken), (bytes, 100));
    assert!(bytes < 90 * 478 * 3 * 4 / 3, "{bytes}");
    let (read, error) = read(&fs::read(&path).unwrap());
    assert!(error.is_none() && read == frames.iter().map(kept).collect::<Vec<_>>());
}

#[test]
fn recording_that_was_cut_anywhere_has_all_frames_of_its_complete_chunks() {
    let ((_folder, path), frames) = (file(), frames(70));
    write(&path, &frames, u64::MAX);
    let bytes = fs::read(&path).unwrap();
    let mut counts = Vec::new();
    for length in (START.len()..=bytes.len()).step_by(997).chain([bytes.len()]) {
        let (read, error) = read(&bytes[..length]);
        assert!(error.is_none(), "{length}: {error:?}");
        assert!(read.iter().zip(&frames).all(|(read, frame)| *read == kept(frame)), "{length}");
        counts.push(read.len());
    }
    counts.dedup();
    assert_eq!(counts, [0, 31, 62, 70], "a chunk holds a second");
}

#[test]
fn damaged_chunk_ends_the_recording_and_the_frames_before_it_are_used() {
    let ((_folder, path), frames) = (file(), frames(70));
    write(&path, &frames, u64::MAX);
    let mut bytes = fs::read(&path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    let (read_before, error) = read(&bytes);
    assert_eq!(read_before.len(), 31);
    assert!(error.unwrap().to_string().contains("damaged after frame 31"));
    bytes[START.len()..][..4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(matches!(read(&bytes), (none, Some(RecordingError::Damaged { frames: 0 })) if none.is_empty()));
}

#[test]
fn other_files_and_later_versions_are_refused() {
    assert!(matches!(read(b"RIFF....AVI "), (_, Some(RecordingError::Other))));
    assert!(matches!(read(b"FW"), (_, Some(RecordingError::Other))));
    assert!(matches!(read(b"FWREC\0\0\x02"), (_, Some(RecordingError::Version))));
}

#[test]
fn recording_never_exceeds_its_limit_and_replaces_no_file() {
    let ((_folder, path), frames) = (file(), frames(1000));
    let (bytes, taken) = write(&path, &frames, 100_000);
    assert!(bytes <= 100_000 && taken < 1000, "{bytes}");
    assert!(read(&fs::read(&path).unwrap()).0.len() > 30);
    assert_eq!(Writer::create(&path, 1000).unwrap_err().kind(), ErrorKind::AlreadyExists);
}
