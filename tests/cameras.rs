//! The capture code alone, in a process that has a simulated camera (`tests/hooks/camera.c`).
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::time::Duration;

use common::camera::{Camera, Cameras, FPS_120};
use common::eventually;
use facewire::capture::v4l2::{CameraSource, Wish};
use facewire::capture::{CaptureError, FrameFault, FrameRate, Source};
use facewire::clock::monotonic_us;

const TIMEOUT: Duration = Duration::from_millis(200);
const WISH: Wish = Wish { width: 640, height: 480, rate: FrameRate::FPS_30, format: None };

fn open() -> CameraSource {
    CameraSource::open("/dev/video0", &WISH, TIMEOUT).unwrap()
}

/// Reads frames until the source fails.
fn failure(source: &mut CameraSource) -> CaptureError {
    let errors = (0..2000).find_map(|_| source.next().err());
    errors.unwrap_or_else(|| panic!("the source does not fail"))
}

fn fast() -> Camera {
    Camera { intervals: FPS_120, ..Camera::default() }
}

/// Waits until the clock shows this time.
fn await_us(time_us: u64) {
    eventually("the time", || monotonic_us() >= time_us);
}

#[test]
fn a_slow_reader_gets_a_fresh_frame_and_the_number_of_skipped_ones() {
    let Some(_cameras) = Cameras::inside(&[fast()]) else { return };
    let mut source = open();
    let period_us = source.frame_period_us().unwrap();
    let captured_us = source.next().unwrap().unwrap().captured_us;
    await_us(captured_us + 20 * period_us);
    let asked_us = monotonic_us();
    let captured_us = source.next().unwrap().unwrap().captured_us;
    assert!(captured_us + 3 * period_us > asked_us, "{} us old", asked_us - captured_us);
    let skipped = source.take_tally().for_newer;
    assert!(skipped >= 3, "{skipped}");
}

#[test]
fn a_reader_of_every_third_frame_gets_no_other_and_the_others_are_left_out() {
    let Some(_cameras) = Cameras::inside(&[Camera::default()]) else { return };
    let mut source = open();
    let period_us = source.frame_period_us().unwrap();
    let mut captured_us = source.next().unwrap().unwrap().captured_us;
    source.take_tally();
    for _ in 0..5 {
        let wanted_us = captured_us + 5 * period_us / 2;
        source.leave_out_until(wanted_us);
        captured_us = source.next().unwrap().unwrap().captured_us;
        assert!(captured_us >= wanted_us, "{} us early", wanted_us - captured_us);
    }
    let left_out = source.take_tally().left_out;
    assert!((1..=10).contains(&left_out), "{left_out}");
}

/// The camera stops after the damaged frame, so that no later one takes its place.
#[test]
fn a_damaged_frame_is_an_error_and_the_next_one_is_intact() {
    let damaged = Camera { marked: (1, 10), limit: Some(10), ..fast() };
    let Some(cameras) = Cameras::inside(std::slice::from_ref(&damaged)) else { return };
    let mut source = open();
    let error = failure(&mut source);
    let CaptureError::Frame { fault: FrameFault::Marked, number } = error else { panic!("{error:?}") };
    cameras.change(0, &Camera { limit: Some(11), ..damaged });
    assert_eq!(source.next().unwrap().unwrap().number, number + 1);
}

#[test]
fn a_silent_camera_has_stalled() {
    let Some(cameras) = Cameras::inside(&[fast()]) else { return };
    let mut source = open();
    source.next().unwrap();
    cameras.change(0, &Camera { limit: Some(0), ..fast() });
    let error = failure(&mut source).to_string();
    assert!(error.contains("sent nothing for 200 ms"), "{error}");
}
