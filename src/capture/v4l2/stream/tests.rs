#![allow(clippy::unwrap_used, clippy::panic)]

use std::cell::Cell;

use v4l::timestamp::Timestamp;

use super::*;

fn meta(bytesused: u32, flags: Flags) -> Metadata {
    Metadata { bytesused, flags, timestamp: Timestamp::new(2, 500), ..Metadata::default() }
}

#[test]
fn only_the_part_that_the_driver_filled_is_returned() {
    let buffer = [7; 100];
    let shown = |bytesused, flags| shot(&buffer, &meta(bytesused, flags)).map(|shot| shot.bytes.len());
    assert_eq!(shown(60, Flags::empty()), Ok(60));
    assert_eq!(shown(101, Flags::empty()), Err(FrameFault::Incomplete));
    assert_eq!(shown(60, Flags::ERROR), Err(FrameFault::Marked));
}

#[test]
fn timestamps_of_another_clock_or_of_the_future_are_replaced() {
    let now_us = 3_000_000;
    let time = |flags, now_us| captured_us(&meta(0, flags), now_us);
    assert_eq!(time(Flags::TIMESTAMP_MONOTONIC, now_us), 2_000_500);
    assert_eq!(time(Flags::TIMESTAMP_COPY, now_us), now_us);
    assert_eq!(time(Flags::TIMESTAMP_UNKNOWN, now_us), now_us);
    assert_eq!(time(Flags::TIMESTAMP_MONOTONIC, 1_000_000), 1_000_000);
}

/// A stream whose attempts to stop end as listed, and which panics in `Drop` as that of the v4l crate does.
struct Stoppable<'a> {
    errors: std::slice::Iter<'a, Option<Errno>>,
    dropped: &'a Cell<bool>,
}

impl v4l::io::traits::Stream for Stoppable<'_> {
    type Item = [u8];

    fn start(&mut self) -> io::Result<()> {
        Ok(())
    }

    fn stop(&mut self) -> io::Result<()> {
        match self.errors.next() {
            Some(Some(error)) => Err((*error).into()),
            _ => Ok(()),
        }
    }
}

impl Drop for Stoppable<'_> {
    fn drop(&mut self) {
        self.dropped.set(true);
        if let Err(error) = v4l::io::traits::Stream::stop(self) {
            panic!("{error}");
        }
    }
}

/// Releases such a stream, and returns whether it was dropped.
fn released(errors: &[Option<Errno>]) -> (Result<(), CaptureError>, bool) {
    let dropped = Cell::new(false);
    let stream = Stoppable { errors: errors.iter(), dropped: &dropped };
    (release(stream, Path::new("/dev/video7")), dropped.get())
}

#[test]
fn a_stream_that_stops_is_dropped_even_if_a_signal_interrupts_it() {
    assert!(matches!(released(&[]), (Ok(()), true)));
    assert!(matches!(released(&[Some(Errno::INTR), Some(Errno::INTR)]), (Ok(()), true)));
    assert!(matches!(released(&[Some(Errno::NODEV)]), (Ok(()), true)), "unplugged");
}

#[test]
fn a_camera_that_cannot_be_stopped_is_an_error_with_its_remedy() {
    for errors in [vec![Some(Errno::IO)], vec![Some(Errno::INTR); STOP_ATTEMPTS]] {
        let (outcome, dropped) = released(&errors);
        assert!(!dropped, "its drop would panic");
        let sentence = outcome.unwrap_err().to_string();
        assert!(
            sentence.starts_with("/dev/video7 cannot be stopped: ") && sentence.contains("start this program again")
        );
    }
}

/// The second attempt is the one in `Drop`.
#[test]
fn a_stream_that_stops_once_but_not_again_does_no_harm() {
    assert!(matches!(released(&[None, Some(Errno::IO)]), (Ok(()), true)));
}

#[test]
fn a_bus_without_bandwidth_is_told_with_its_remedy() {
    let sentence = CaptureError::device(Path::new("/dev/video7"), "starting it", Errno::NOSPC.into()).to_string();
    assert!(
        sentence.starts_with("/dev/video7 cannot start, because its USB bus has no bandwidth left; "),
        "{sentence}"
    );
    assert!(sentence.contains("camera.format = \"mjpeg\""), "{sentence}");
}
