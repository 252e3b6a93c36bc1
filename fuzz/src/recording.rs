//! Checks the reader of recordings.

use facewire::recording::{Reader, Recorded, RecordingError};

/// Checks that any bytes are read to their end or to an error of one line, that every frame is finite, and that it is the
/// same when it is written and read again. The bytes are taken as a whole recording, and as one frame.
pub fn recording(data: &[u8]) {
    if let Some(frame) = Recorded::from_bytes(data) {
        check(&frame);
    }
    let mut reader = match Reader::new(data) {
        Ok(reader) => reader,
        Err(error) => return refused(&error),
    };
    loop {
        match reader.next_frame() {
            Ok(Some(frame)) => check(&frame),
            Ok(None) => return,
            Err(error) => return refused(&error),
        }
    }
}

fn check(frame: &Recorded) {
    assert!(frame.landmarks.as_ref().is_none_or(facewire_face::Landmarks::is_finite));
    let again = Recorded::from_bytes(&frame.to_bytes()).unwrap();
    assert_eq!((again.time_us, &again.landmarks), (frame.time_us, &frame.landmarks));
}

fn refused(error: &RecordingError) {
    let error = error.to_string();
    assert!(!error.is_empty() && !error.contains(char::is_control), "{error:?}");
}
