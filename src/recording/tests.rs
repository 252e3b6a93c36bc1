use std::path::PathBuf;

use facewire_face::Landmarks;
use facewire_packet::{Pose, Reason};

use super::*;

/// A file name in a folder that is removed at the end, and frames of a face that moves, 30 a second, every tenth without a
/// face.
fn file_and_frames(count: u64) -> (tempfile::TempDir, PathBuf, Vec<Recorded>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("face.fwrec");
    let frame = |number: u64| {
        let time_us = 5_000_000 + number * 33_333;
        if number % 10 == 9 {
            return Recorded::nothing(time_us, Reason::NoFace);
        }
        let place = |index: usize| 200.0 + index as f32 * 0.5 + (number as f32 * 0.3 + index as f32).sin();
        let landmarks = Landmarks(core::array::from_fn(|index| [place(index), place(index + 9), place(index + 99)]));
        Recorded::new(time_us, &Pose::NEUTRAL, [640.0, 480.0], Some(&landmarks))
    };
    (folder, path, (0..count).map(frame).collect())
}

/// Writes the frames, and returns the bytes of the file and how many frames had room.
fn write(path: &Path, frames: &[Recorded], limit_bytes: u64) -> (Vec<u8>, usize) {
    let mut writer = Writer::create(path, limit_bytes).unwrap();
    let taken = frames.iter().take_while(|frame| writer.push(frame).unwrap()).count();
    let length = writer.finish().unwrap();
    let bytes = fs::read(path).unwrap();
    assert_eq!(bytes.len() as u64, length);
    assert_eq!(writer.frames(), read(&bytes).0.len() as u64, "frames without room do not count");
    (bytes, taken)
}

fn read(bytes: &[u8]) -> (Vec<Recorded>, Option<RecordingError>) {
    let mut read = Vec::new();
    let mut read_all = || {
        let mut reader = Reader::new(bytes)?;
        while let Some(frame) = reader.next_frame()? {
            read.push(frame);
        }
        Ok(())
    };
    let error = read_all().err();
    (read, error)
}

/// The frame as a recording that begins with frame 0 gives it back.
fn kept(frame: &Recorded) -> Recorded {
    let frame = Recorded { time_us: frame.time_us - 5_000_000, ..frame.clone() };
    Recorded::from_bytes(&frame.to_bytes()).unwrap()
}

#[test]
fn recording_that_was_cut_anywhere_has_all_frames_of_its_complete_chunks_in_a_third_of_their_space() {
    let (_folder, path, frames) = file_and_frames(70);
    let (bytes, taken) = write(&path, &frames, u64::MAX);
    assert!(taken == 70 && bytes.len() < 63 * 478 * 3 * 4 / 3, "{}", bytes.len());
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
fn damaged_chunk_ends_the_recording_and_other_files_and_later_versions_are_refused() {
    assert!(matches!(read(b"RIFF....AVI "), (_, Some(RecordingError::Other))));
    assert!(matches!(read(b"FW"), (_, Some(RecordingError::Other))));
    assert!(matches!(read(b"FWREC\0\0\x02"), (_, Some(RecordingError::Version))));
    let (_folder, path, frames) = file_and_frames(70);
    let (mut bytes, _) = write(&path, &frames, u64::MAX);
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    let (read_before, error) = read(&bytes);
    assert_eq!(read_before.len(), 31);
    assert!(error.unwrap().to_string().contains("damaged after frame 31"));
    bytes[START.len()..][..4].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(matches!(read(&bytes), (none, Some(RecordingError::Damaged { frames: 0 })) if none.is_empty()));
}

#[test]
fn recording_never_exceeds_its_limit_and_replaces_no_file() {
    let (_folder, path, frames) = file_and_frames(1000);
    let (bytes, taken) = write(&path, &frames, 100_000);
    assert!(bytes.len() <= 100_000 && taken < 1000, "{}", bytes.len());
    assert!(read(&bytes).0.len() > 30);
    assert_eq!(Writer::create(&path, 1000).unwrap_err().kind(), ErrorKind::AlreadyExists);
}
