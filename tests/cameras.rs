//! Cameras of a real kernel. `tests/guest/cameras` runs these tests as root in a virtual machine with the driver vivid. A
//! plain `cargo test` leaves them out, because they change devices of the system.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

use std::process::Command;
use std::thread::{sleep, spawn};
use std::time::Duration;

use facewire::capture::v4l2::{CameraSource, PixelFormat, Wish};
use facewire::capture::{CaptureError, FrameFault, FrameRate, Source, monotonic_us};

const TIMEOUT: Duration = Duration::from_secs(2);

fn wish(format: Option<PixelFormat>) -> Wish {
    Wish { width: 640, height: 480, rate: FrameRate::new(25, 1).unwrap(), format }
}

fn open(device: &str, format: Option<PixelFormat>) -> Result<CameraSource, CaptureError> {
    CameraSource::open(device, &wish(format), TIMEOUT)
}

fn shell(command: &str) {
    assert!(Command::new("sh").args(["-c", command]).status().unwrap().success(), "{command}");
}

/// Loads the driver of the test camera, or binds the camera to it again.
fn plug_vivid() {
    shell(
        "modprobe vivid n_devs=1 node_types=0x1; cd /sys/bus/platform/drivers/vivid; [ -e vivid.0 ] || echo vivid.0 >bind",
    );
    shell("udevadm settle; v4l2-ctl -d /dev/video0 -c percentage_of_dropped_buffers=0");
}

fn vivid(control: &str) {
    shell(&format!("v4l2-ctl -d /dev/video0 -c {control}"));
}

fn says<T>(outcome: Result<T, CaptureError>, text: &str) -> bool {
    outcome.is_err_and(|error| error.to_string().contains(text))
}

fn failure(source: &mut CameraSource) -> CaptureError {
    for _ in 0..2000 {
        match source.next() {
            Ok(_) | Err(CaptureError::Frame { .. }) => {}
            Err(error) => return error,
        }
    }
    panic!("the source does not fail");
}

#[test]
#[ignore = "needs the test camera vivid"]
fn a_slow_reader_gets_a_fresh_frame_and_the_number_of_skipped_ones() {
    plug_vivid();
    let mut source = open("vivid", Some(PixelFormat::Yuyv)).unwrap();
    source.next().unwrap();
    sleep(Duration::from_secs(1));
    let asked_us = monotonic_us();
    let captured_us = source.next().unwrap().unwrap().captured_us;
    assert!(captured_us + 500_000 > asked_us, "{} us old", asked_us - captured_us);
    let skipped = source.take_tally().for_newer;
    assert!(skipped >= 3, "{skipped}");
}

#[test]
#[ignore = "needs the test camera vivid"]
fn a_reader_of_every_third_frame_gets_no_other_and_the_others_are_left_out() {
    plug_vivid();
    let mut source = open("vivid", Some(PixelFormat::Yuyv)).unwrap();
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

#[test]
#[ignore = "needs the test camera vivid"]
fn a_damaged_frame_is_an_error_and_the_next_one_is_intact() {
    plug_vivid();
    let mut source = open("vivid", Some(PixelFormat::Yuyv)).unwrap();
    source.next().unwrap();
    let breaker = spawn(|| vivid("inject_v4l2_buf_flag_error=1"));
    let outcomes: Vec<_> = (0..100).map(|_| source.next().map(|_| ())).collect();
    breaker.join().unwrap();
    let faults: Vec<_> = outcomes.into_iter().filter_map(Result::err).collect();
    assert!(matches!(faults[..], [CaptureError::Frame { fault: FrameFault::Marked, .. }]), "{faults:?}");
}

#[test]
#[ignore = "needs the test camera vivid"]
fn a_silent_camera_has_stalled() {
    plug_vivid();
    let mut source = open("vivid", Some(PixelFormat::Yuyv)).unwrap();
    vivid("percentage_of_dropped_buffers=100");
    assert!(failure(&mut source).to_string().contains("sent nothing for 2000 ms"));
}

#[test]
#[ignore = "needs the test camera vivid"]
fn after_an_error_of_the_driver_the_camera_can_be_opened_again() {
    plug_vivid();
    for error in ["inject_fatal_streaming_error=1", "inject_vidioc_qbuf_error=1"] {
        let mut source = open("vivid", Some(PixelFormat::Yuyv)).unwrap();
        vivid(error);
        assert!(failure(&mut source).to_string().contains("the camera failed while"), "{error}");
        drop(source);
        assert!(open("vivid", None).unwrap().next().unwrap().is_some(), "{error}");
    }
    for error in ["inject_vidioc_reqbufs_error=1", "inject_vidioc_streamon_error=1"] {
        vivid(error);
        assert!(says(open("vivid", None), "the camera failed while"), "{error}");
        assert!(open("vivid", None).unwrap().next().unwrap().is_some(), "{error}");
    }
}
