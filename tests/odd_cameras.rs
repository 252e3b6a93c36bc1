//! The whole program with cameras and drivers of all kinds, also faulty ones. The cameras are simulated
//! (`tests/hooks/camera.c`), so that the tests need no device and no privilege.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs::File;
use std::io::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::{JoinHandle, sleep, spawn};
use std::time::Duration;

use common::camera::{
    Camera, Cameras, Clock, DEVICE_CAPS, FPS_120, Failure, Listing, META_CAPTURE, STREAMING, VIDEO_CAPTURE, clip_jpegs,
    clip_raw,
};
use common::eventually;
use common::program::{settings, text};
use common::service::counted;
use facewire::capture::v4l2::{Layout, Store};
use facewire_face::FaceBox;
use facewire_face::stages::{Block, Border, CropShape, crop};
use facewire_packet::{Packet, Reason, State, yaw_pitch_roll_deg};
use rustix::fs::{CWD, FileType, Mode, mknodat};
use rustix::io::Errno;
use serde_json::Value;
use v4l::format::Quantization;
use v4l::{Format, FourCC};

const AUTO: &str = "[camera]\ndevice = \"auto\"\n";
/// A busy machine may take seconds for a frame.
const PATIENT: &str = "[camera]\ndevice = \"auto\"\n[failsafe]\nlive_ms = 5000\nhold_ms = 6000\nneutral_ms = 7000\n";
const IS_NO_FACE: fn(&Packet) -> bool = |packet| packet.reason == Reason::NoFace;
const IS_NO_CAMERA: fn(&Packet) -> bool = |packet| packet.reason == Reason::NoCamera;

fn settings_for(device: &str) -> String {
    format!("[camera]\ndevice = \"{device}\"\n")
}

/// Runs `facewire check` with these settings. Returns the one sentence with which it must refuse the camera.
fn refusal(machine: &Cameras, toml: &str) -> String {
    let file = settings(toml);
    machine.run(&["check", "--config", text(file.path())]).sentence(66).to_owned()
}

#[test]
fn every_format_shows_the_face_also_where_rows_are_padded() {
    let table: [(&[&str], Option<u32>, &str); 11] = [
        (&["YUYV"], None, "YUYV"),
        (&["YUYV"], Some(1344), "YUYV"),
        (&["NV12"], None, "NV12"),
        (&["NV12"], Some(704), "NV12"),
        (&["GREY"], None, "GREY"),
        (&["GREY"], Some(648), "GREY"),
        (&["MJPG"], None, "MJPEG"),
        (&["JPEG"], None, "JPEG"),
        (&["UYVY"], Some(1344), "UYVY"),
        (&["YU12"], None, "YU12"),
        (&["BGR3"], None, "BGR3"),
    ];
    for (formats, stride, name) in table {
        let machine = Cameras::with(&[]);
        machine.show_clip(Camera { formats, stride, ..Camera::default() });
        let (service, receiver) = machine.serve(PATIENT);
        receiver.live();
        service.await_log(&format!("camera opened: Simulated camera (/dev/video0): {name} 640x480 at 30 fps"));
        assert_eq!(counted(&service.status(), "damaged"), 0, "{}", service.log());
    }
}

#[test]
fn a_camera_with_several_planes_shows_the_face_in_every_format_of_one_also_behind_other_bytes_and_in_padded_rows() {
    for (formats, stride, data_offset, name) in [
        (&["NV12"], None, 0, "NV12"),
        (&["NV12"], Some(704), 4096, "NV12"),
        (&["YUYV"], Some(1344), 100, "YUYV"),
        (&["MJPG"], None, 64, "MJPEG"),
    ] {
        let machine = Cameras::with(&[]);
        machine.show_clip(Camera { formats, stride, data_offset, ..Camera::built_in() }.multi_planar());
        let (service, receiver) = machine.serve(PATIENT);
        receiver.live();
        service.await_log(&format!("camera opened: Simulated camera (/dev/video0): {name} 640x480 at 30 fps"));
        assert_eq!(counted(&service.status(), "damaged"), 0, "{}", service.log());
        let calls = machine.calls(0);
        assert!(calls.contains(&format!("S_FMT {} 640x480 field 0\nS_PARM 1/30\nREQBUFS 4\n", formats[0])), "{calls}");
    }
}

/// The middle of the first frame of the clip, as a camera sends it in this format, in samples from 0 to 1.
fn middle(fourcc: &str, stride: usize) -> Vec<f32> {
    let code = fourcc.as_bytes().try_into().unwrap();
    let format = Format {
        stride: stride as u32,
        quantization: Quantization::FullRange,
        ..Format::new(640, 480, FourCC::new(code))
    };
    let mut store = Store::new(Layout::of(&format).unwrap()).unwrap();
    store.keep(&clip_raw(fourcc, stride, 1)[0]).unwrap();
    let region = FaceBox { centre: [320.0, 240.0], size: 400.0, angle_rad: 0.0 };
    let shape = CropShape { side: 64, range: [0.0, 1.0], border: Border::Black };
    let mut rows = vec![[0.0; 3 * 64]; 64];
    crop(&store.picture().unwrap(), &region, shape, &mut Block::default(), &mut rows);
    rows.concat()
}

#[test]
fn every_raw_format_gives_the_colours_of_the_picture_that_it_was_made_of() {
    let wanted = middle("YUYV", 1280);
    let grey = middle("GREY", 640);
    let difference = |fourcc, stride, wanted: &[f32]| {
        let samples = middle(fourcc, stride);
        samples.iter().zip(wanted).map(|(sample, wanted)| f64::from((sample - wanted).abs())).sum::<f64>()
            / wanted.len() as f64
    };
    for (fourcc, stride) in [("UYVY", 1346), ("YVYU", 1280), ("VYUY", 1288), ("422P", 640)] {
        assert_eq!(difference(fourcc, stride, &wanted), 0.0, "{fourcc}");
    }
    // Half the chroma, colours that were rounded, and fewer of them.
    let coarse = [("NV12", 640), ("NV21", 704), ("NV16", 704), ("NV61", 640), ("YU12", 640), ("YV12", 704)];
    let packed = [("RGB3", 1924), ("BGR3", 1920), ("RGB4", 2560), ("XR24", 2564), ("XB24", 2560), ("RX24", 2560)];
    for (fourcc, stride) in coarse.into_iter().chain(packed).chain([("RGBP", 1284)]) {
        let most = if fourcc == "RGBP" { 0.012 } else { 0.004 };
        let difference = difference(fourcc, stride, &wanted);
        assert!(difference < most, "{fourcc}: {difference}");
    }
    for (fourcc, stride) in [("Y10 ", 1280), ("Y12 ", 1284), ("Y16 ", 1280)] {
        assert_eq!(difference(fourcc, stride, &grey), 0.0, "{fourcc}");
    }
    let without_colours = difference("GREY", 640, &wanted);
    assert!(without_colours > 0.02, "the picture has too little colour to tell formats apart: {without_colours}");
}

#[test]
fn devices_lists_each_camera_with_its_modes_and_stable_path_and_no_other_node() {
    let metadata = [VIDEO_CAPTURE | META_CAPTURE | STREAMING | DEVICE_CAPS, META_CAPTURE | STREAMING];
    let (least, most, step) = ([32, 16], [1920, 1080], [2, 2]);
    let rates = Listing::Steps { least: [1, 60], most: [1, 5], step: [1, 60] };
    let two = Listing::Discrete(&[[640, 480], [320, 240]]);
    let machine = Cameras::with(&[
        Camera { card: "Webcam", formats: &["MJPG", "YUYV"], sizes: two, ..Camera::default() },
        Camera { capabilities: metadata, ..Camera::default() },
        Camera { card: "Steps", sizes: Listing::Steps { least, most, step }, intervals: rates, ..Camera::built_in() },
        Camera { card: "Any", sizes: Listing::Continuous { least, most }, formats: &["NV12"], ..Camera::built_in() },
        Camera { card: "One", sizes: Listing::Unlisted([352, 288]), formats: &["GREY"], ..Camera::built_in() },
        Camera { card: "No rate", intervals: Listing::Unlisted([1, 30]), ..Camera::built_in() },
        Camera { card: "Codec", driver: "bcm2835-codec", ..Camera::built_in() },
        Camera::failing("open", Errno::ACCESS),
        Camera { card: "Planes", formats: &["NV12", "NM12"], driver: "rkisp", ..Camera::built_in() }.multi_planar(),
    ]);
    machine.link("by-id/usb-Webcam-video-index0", 0);
    machine.link("by-path/platform-usb-0:1.2:1.0-video-index0", 0);
    let out = machine.run(&["devices"]).succeeded().out;
    let cameras = "camera /dev/video0 \"Webcam\" (uvcvideo)
  stable path /dev/v4l/by-id/usb-Webcam-video-index0
  stable path /dev/v4l/by-path/platform-usb-0:1.2:1.0-video-index0
  MJPEG 640x480 at 30 fps
  MJPEG 320x240 at 30 fps
  YUYV 640x480 at 30 fps
  YUYV 320x240 at 30 fps
camera /dev/video2 \"Steps\" (vivid)
  YUYV 32..1920x16..1080 at 5 fps to 60 fps
camera /dev/video3 \"Any\" (vivid)
  NV12 32..1920x16..1080 at 30 fps
camera /dev/video4 \"One\" (vivid)
  GREY 352x288 at 30 fps
camera /dev/video5 \"No rate\" (vivid)
  YUYV 640x480
camera /dev/video8 \"Planes\" (rkisp)
  NV12 640x480 at 30 fps
not examined: no permission to open /dev/video7; add the user to the group `video`
";
    assert!(out.starts_with(cameras), "{out}");
}

#[test]
fn sizes_and_rates_are_taken_as_the_driver_grants_them() {
    let least = [16, 16];
    let table = [
        (
            Camera { sizes: Listing::Continuous { least, most: [4096, 4096] }, ..Camera::default() },
            "YUYV 640x480 at 30 fps",
        ),
        (Camera { sizes: Listing::Unlisted([352, 288]), ..Camera::default() }, "YUYV 352x288 at 30 fps"),
        (Camera { intervals: Listing::Unlisted([1, 30]), ..Camera::default() }, "YUYV 640x480\n"),
        (Camera { granted_size: Some([320, 240]), ..Camera::default() }, "YUYV 320x240 at 30 fps"),
        (Camera { granted_interval: Some([1, 15]), ..Camera::default() }, "YUYV 640x480 at 15 fps"),
        (Camera { granted_format: Some("NV12"), ..Camera::default() }, "NV12 640x480 at 30 fps"),
        (Camera { granted_size: Some([320, 240]), ..Camera::default() }.multi_planar(), "YUYV 320x240 at 30 fps"),
        (Camera { sizes: Listing::Unlisted([352, 288]), ..Camera::default() }.multi_planar(), "YUYV 352x288 at 30 fps"),
        (Camera::failing("S_PARM", Errno::NOTTY).multi_planar(), "YUYV 640x480 at 30 fps"),
        (Camera::failing("S_PARM", Errno::NOTTY), "YUYV 640x480 at 30 fps"),
        (Camera::failing("ENUM_FRAMEINTERVALS", Errno::NOTTY), "YUYV 640x480\n"),
        (Camera::failing("ENUM_FRAMESIZES", Errno::NOTTY), "YUYV 640x480 at 30 fps"),
    ];
    for (camera, mode) in table {
        let machine = Cameras::one(&camera);
        let (service, receiver) = machine.serve(AUTO);
        receiver.until(IS_NO_FACE);
        service.await_log(&format!("(/dev/video0): {mode}"));
    }
}

#[test]
fn a_face_is_live_by_every_clock_and_one_that_cannot_be_true_is_reported_once_and_counted() {
    let clocks = [
        (Clock::Monotonic, true),
        (Clock::Unknown(0), true),
        (Clock::Copied(1_000_000), true),
        (Clock::Realtime, true),
        (Clock::Offset(900_000), true),
        (Clock::Offset(-30_000), true),
        (Clock::Rate(101), true),
        (Clock::Rate(99), true),
        (Clock::Pairs, true),
        (Clock::StepsBack(20_000), true),
        (Clock::Frozen, false),
        (Clock::Constant(0), false),
        (Clock::Constant(-140_448_221_376_697), false),
        (Clock::FromStart, false),
        // Further behind than any time limit of the failsafe, also on a slow machine.
        (Clock::Offset(-60_000_000), false),
    ];
    for (clock, can_be_true) in clocks {
        let machine = Cameras::with(&[]);
        machine.show_clip(Camera { formats: &["MJPG"], clock, ..Camera::default() });
        let (service, receiver) = machine.serve(PATIENT);
        receiver.live();
        if !can_be_true {
            service.await_log("the camera driver's timestamps cannot be true");
            let before = counted(&service.status(), "mistimed");
            eventually("more of them", || counted(&service.status(), "mistimed") > before + 10);
        }
        assert_eq!(service.logged("lost or damaged"), 0, "{clock:?}: {}", service.log());
        let reports = service.logged("cannot be true");
        assert_eq!(reports, usize::from(!can_be_true), "{clock:?}");
    }
}

#[test]
fn each_call_that_fails_is_one_sentence_with_a_remedy() {
    let table = [
        ("open", Errno::ACCESS, "no permission to open /dev/video0; add the user to the group `video`"),
        ("open", Errno::BUSY, "/dev/video0 is in use by another program; stop that program"),
        ("open", Errno::NODEV, "there is no camera; plug one in"),
        ("QUERYCAP", Errno::NOTTY, "there is no camera; plug one in"),
        (
            "ENUM_FMT",
            Errno::INVAL,
            "/dev/video0 offers no format that facewire reads (it has none); use another camera",
        ),
        ("G_FMT", Errno::INVAL, "there is no camera; plug one in"),
        ("S_FMT", Errno::BUSY, "/dev/video0 is in use by another program; stop that program"),
        ("S_FMT", Errno::IO, "the camera failed while setting its format: "),
        ("REQBUFS", Errno::BUSY, "/dev/video0 is in use by another program; stop that program"),
        ("REQBUFS", Errno::NOMEM, "the camera failed while starting it: "),
        ("QUERYBUF", Errno::INVAL, "the camera failed while starting it: "),
        ("mmap", Errno::NOMEM, "the camera failed while starting it: "),
        ("QBUF", Errno::IO, "the camera failed while starting it: "),
        ("STREAMON", Errno::NOSPC, "/dev/video0 cannot start, because its USB bus has no bandwidth left"),
        ("STREAMON", Errno::TIMEDOUT, "the camera failed while starting it: "),
        ("STREAMON", Errno::NODEV, "the camera is gone; plug it in again"),
        ("DQBUF", Errno::IO, "the camera failed while starting it: "),
    ];
    for (call, error, sentence) in table {
        for camera in [Camera::failing(call, error), Camera::failing(call, error).multi_planar()] {
            let said = refusal(&Cameras::one(&camera), AUTO);
            assert!(said.starts_with(sentence), "{call}, {error}: {said}");
        }
    }
}

#[test]
fn what_is_no_camera_or_lacks_the_format_is_one_sentence() {
    let metadata = [VIDEO_CAPTURE | META_CAPTURE | STREAMING | DEVICE_CAPS, META_CAPTURE | STREAMING];
    let machine = Cameras::with(&[
        Camera { card: "UVC Camera", formats: &["MJPG"], ..Camera::default() },
        Camera { capabilities: metadata, ..Camera::default() },
    ]);
    let format = |device, format| format!("{}format = \"{format}\"\n", settings_for(device));
    for (toml, sentence) in [
        (settings_for("/dev/video7"), "no camera is called /dev/video7; `facewire devices` lists"),
        (settings_for("/dev/video1"), "/dev/video1 is not a camera that captures pictures; `facewire devices` lists"),
        (settings_for("webcam"), "no camera is called webcam; there is UVC Camera (/dev/video0)"),
        (
            format("/dev/video0", "yuyv"),
            "/dev/video0 does not offer YUYV; set camera.format = \"auto\" for those that it offers (MJPEG)",
        ),
    ] {
        let said = refusal(&machine, &toml);
        assert!(said.starts_with(sentence), "{said}");
    }
}

#[test]
fn a_driver_that_returns_an_undefined_value_is_named() {
    let camera = Camera { field: 77, ..Camera::default() };
    for (camera, value) in [(camera.clone(), "Invalid field order"), (camera.multi_planar(), "asking for its format")] {
        let machine = Cameras::one(&camera);
        for device in ["auto", "/dev/video0"] {
            let said = refusal(&machine, &settings_for(device));
            let sentence = "the driver of /dev/video0 returned a value that the kernel does not define (";
            assert!(said.starts_with(&format!("{sentence}{value}")), "{said}");
        }
    }
}

/// The node that a program feeds may become a camera at any time, so that it shows how often the service has looked.
#[test]
fn a_node_that_is_no_camera_is_opened_once_and_that_of_a_codec_never_until_a_camera_comes() {
    let metadata = [VIDEO_CAPTURE | META_CAPTURE | STREAMING | DEVICE_CAPS, META_CAPTURE | STREAMING];
    let machine = Cameras::with(&[
        Camera { driver: "bcm2835-codec", formats: &["NV12"], ..Camera::built_in() },
        Camera { capabilities: metadata, ..Camera::default() },
        Camera { formats: &["pBAA"], ..Camera::built_in() },
        Camera { formats: &["NM12"], ..Camera::built_in() }.multi_planar(),
        Camera { formats: &[], ..Camera::of_a_program() },
    ]);
    let (service, receiver) = machine.serve(AUTO);
    receiver.until(IS_NO_CAMERA);
    eventually("five attempts", || machine.called(4, "open") >= 5);
    assert_eq!([0, 1, 2, 3].map(|number| machine.called(number, "open")), [0, 1, 1, 1]);
    machine.plug(2, &Camera::default());
    receiver.until(IS_NO_FACE);
    service.await_log("camera opened: Simulated camera (/dev/video2)");
    assert_eq!([0, 1, 3].map(|number| machine.called(number, "open")), [0, 1, 1]);
}

#[test]
fn a_camera_that_was_busy_is_used_once_it_is_free_although_nothing_shows_that_at_its_node() {
    let busy = Failure { call: "REQBUFS", error: Errno::BUSY, nth: 1 };
    let machine = Cameras::one(&Camera { failures: vec![busy; 4], ..Camera::default() });
    let (service, receiver) = machine.serve(AUTO);
    service.await_log("/dev/video0 is in use by another program");
    receiver.until(IS_NO_FACE);
    assert_eq!(machine.called(0, "STREAMON"), 1);
}

#[test]
fn a_camera_that_has_just_appeared_is_tried_until_it_has_its_group_and_only_then_the_operator_is_told_to_join_it() {
    let refused = Camera { is_new: true, ..Camera::failing("open", Errno::ACCESS) };
    for device in ["auto", "/dev/video0"] {
        let machine = Cameras::one(&refused);
        let (service, receiver) = machine.serve(&settings_for(device));
        // A service that starts late finds a node that is new, too.
        eventually("a node that has just appeared", || {
            machine.plug(0, &refused);
            service.log().contains("/dev/video0 has just appeared, and has no permissions yet; wait some seconds")
        });
        machine.change(0, &Camera { is_new: true, ..Camera::default() });
        receiver.until(IS_NO_FACE);
        assert_eq!(service.logged("add the user to the group"), 0, "{device}: {}", service.log());
        machine.plug(0, &Camera { is_new: false, ..refused.clone() });
        service.await_log("no permission to open /dev/video0; add the user to the group `video`");
    }
}

#[test]
fn a_camera_whose_picture_stands_still_counts_as_none_and_is_opened_again_once_until_the_picture_moves() {
    let machine = Cameras::with(&[]);
    let moving = machine.show_clip(Camera { formats: &["MJPG"], ..Camera::default() });
    let still = Camera { frames: machine.film("still", &clip_jpegs(1)), ..moving.clone() };
    let (service, receiver) = machine.serve(PATIENT);
    receiver.live();
    machine.change(0, &still);
    receiver.until(IS_NO_CAMERA);
    receiver.until_state(State::Neutral);
    service.await_log("frames in a row were bad (the last: it shows the same picture as for a second before");
    receiver.rest();
    service.await_log("tracking is impaired: the picture does not change at all");
    eventually("it is opened again", || counted(&service.status(), "cameras_opened") == 2);
    let frames = counted(&service.status(), "frames");
    eventually("frames that stand still", || counted(&service.status(), "frames") > frames + 60);
    assert!(service.status().contains("impaired_by=frozen-picture"), "{}", service.status());
    assert!(
        receiver.rest().iter().all(|packet| packet.state == State::Neutral),
        "a picture that stood still was shown"
    );
    machine.change(0, &moving);
    receiver.live();
    assert_eq!(counted(&service.status(), "cameras_opened"), 2);
    let told = ["camera lost: ", "no camera: "].map(|line| service.logged(line));
    assert_eq!(told, [1, 0], "{}", service.log());
}

#[test]
fn a_still_picture_that_a_program_sends_is_shown_and_reported() {
    let machine = Cameras::with(&[]);
    let still = Camera { formats: &["MJPG"], frames: machine.film("still", &clip_jpegs(1)), ..Camera::of_a_program() };
    machine.plug(0, &still);
    let (service, receiver) = machine.serve(PATIENT);
    receiver.live();
    service.await_log("tracking is impaired: the picture does not change at all");
    assert!(service.status().contains("frozen-picture"), "{}", service.log());
    receiver.rest();
    receiver.live();
    let moving = Camera { frames: machine.film("moving", &clip_jpegs(20)), ..still };
    machine.change(0, &moving);
    eventually("a picture that moves", || !service.status().contains("frozen-picture"));
    assert_eq!(counted(&service.status(), "cameras_opened"), 1);
}

#[test]
fn interlaced_pictures_are_shown_and_halves_of_them_are_refused_by_name() {
    let small = Listing::Discrete(&[[320, 240]]);
    for (field, sizes) in [(4, Camera::default().sizes), (8, small), (9, small), (2, small), (3, small)] {
        let machine = Cameras::one(&Camera { field, sizes, ..Camera::default() });
        let (service, receiver) = machine.serve(AUTO);
        receiver.until(IS_NO_FACE);
        service.await_log("camera opened: ");
        assert!(!machine.calls(0).contains(" field 4\n"), "{}", machine.calls(0));
    }
    let flat = Listing::Discrete(&[[640, 240]]);
    for (field, sizes, name) in [
        (2, flat, "top"),
        (3, flat, "bottom"),
        (5, small, "sequential, top then bottom"),
        (6, small, "sequential, bottom then top"),
        (7, small, "alternate between fields"),
    ] {
        let machine = Cameras::one(&Camera { field, sizes, ..Camera::default() });
        let said = refusal(&machine, AUTO);
        let sentence = "/dev/video0 sends pictures of which every second row is elsewhere (fields: ";
        assert!(
            said.starts_with(&format!("{sentence}{name}); switch what is connected to it to a progressive mode")),
            "{said}"
        );
        assert_eq!(machine.calls(0).matches(" field 4\n").count(), 1, "{}", machine.calls(0));
    }
}

/// Whichever is opened shows what was tried first: the module works by then, too.
#[test]
fn a_camera_module_whose_service_gives_no_picture_is_tried_after_the_other_cameras_the_next_time() {
    let camera = Camera { intervals: FPS_120, ..Camera::default() };
    let machine = Cameras::one(&camera);
    mknodat(CWD, machine.module(), FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
    let (service, receiver) = machine.serve(AUTO);
    receiver.until(IS_NO_FACE);
    service.await_log("passed over /run/facewire-camera/video, because ");
    let _feed = Feed::start(&machine.module());
    let failure = Failure { call: "DQBUF", error: Errno::IO, nth: 1 };
    machine.change(0, &Camera { failures: vec![failure], ..camera });
    eventually("the camera", || service.logged("camera opened: Simulated camera (/dev/video0") == 2);
    machine.unplug(0);
    service.await_log("camera opened: /run/facewire-camera/video: JPEG 640x480");
    let listed = machine.run(&["devices"]).succeeded().out;
    assert!(listed.starts_with("camera /run/facewire-camera/video \"Camera module of a Raspberry Pi\""), "{listed}");
    let listed: Value = serde_json::from_str(&machine.run(&["devices", "--json"]).succeeded().out).unwrap();
    assert_eq!(listed["cameras"][0]["path"], "/run/facewire-camera/video");
}

#[test]
fn a_machine_without_cameras_says_so() {
    let machine = Cameras::with(&[]);
    assert!(refusal(&machine, AUTO).starts_with("there is no camera; plug one in"));
    assert!(machine.run(&["devices"]).succeeded().out.starts_with("no camera\n"));
}

#[test]
fn a_camera_that_facewire_cannot_read_is_named_with_what_it_offers() {
    let machine = Cameras::with(&[Camera { formats: &["pBAA", "H264"], ..Camera::default() }]);
    let unread = "no format that facewire reads (it has pBAA, H264)";
    assert!(machine.run(&["devices"]).succeeded().out.contains(unread));
    let said = refusal(&machine, AUTO);
    assert_eq!(said, format!("/dev/video0 offers {unread}; use another camera"));
    let machine = Cameras::one(&Camera { formats: &["YM12", "NM12"], planes: 3, ..Camera::default() }.multi_planar());
    let planes = "/dev/video0 (Simulated camera) gives its pictures in several planes";
    for device in ["auto", "/dev/video0"] {
        let said = refusal(&machine, &settings_for(device));
        assert!(said.starts_with(planes), "{said}");
    }
    // The driver lists a format of one plane, and then sets it with two.
    let wrong = Cameras::one(&Camera { formats: &["NV12"], planes: 2, ..Camera::default() }.multi_planar());
    let said = refusal(&wrong, AUTO);
    assert!(said.starts_with(planes), "{said}");
    let listed = machine.run(&["devices"]).succeeded().out;
    assert!(listed.contains(&format!("no camera\nnot read: {planes}")), "{listed}");
    machine.plug(1, &Camera { card: "Webcam", formats: &["MJPG"], ..Camera::default() });
    let said = refusal(&machine, &format!("{AUTO}format = \"yuyv\"\n"));
    assert!(said.starts_with("/dev/video1 does not offer YUYV"), "{said}");
    let said = refusal(&machine, &settings_for("C920"));
    assert!(said.starts_with("no camera is called C920; there is Webcam"), "{said}");
    machine.plug(1, &Camera { card: "Webcam", ..Camera::default() });
    let (service, receiver) = machine.serve(AUTO);
    receiver.until(IS_NO_FACE);
    service.await_log("camera opened: Webcam (/dev/video1): ");
}

#[test]
fn a_driver_that_takes_every_interval_is_asked_for_the_one_of_the_settings() {
    // The longest intervals that versions of v4l2loopback state.
    for most in [[u32::MAX, 1], [1, 1], [1, 0]] {
        let intervals = Listing::Continuous { least: [1, 1000], most };
        let machine = Cameras::with(&[Camera { intervals, pace: Some([1, 120]), ..Camera::default() }]);
        let (service, receiver) = machine.serve(AUTO);
        receiver.until(IS_NO_FACE);
        service.await_log("YUYV 640x480 at 30 fps");
        assert!(machine.calls(0).contains("S_PARM 1/30\n"), "{}", machine.calls(0));
    }
}

#[test]
fn jpeg_images_of_another_size_than_the_driver_says_are_shown() {
    let machine = Cameras::with(&[]);
    machine.show_clip(Camera { formats: &["MJPG"], granted_size: Some([640, 472]), ..Camera::default() });
    let (service, receiver) = machine.serve(PATIENT);
    receiver.live();
    service.await_log("MJPEG 640x480 at 30 fps");
}

#[test]
fn a_camera_with_empty_frames_alone_is_reported_with_a_remedy_of_its_own() {
    let machine = Cameras::with(&[Camera { empty: (1, 1), intervals: FPS_120, ..Camera::default() }]);
    let said = refusal(&machine, AUTO);
    assert!(said.contains("it is empty") && said.contains("its driver delivers empty buffers"), "{said}");
}

#[test]
fn an_infrared_camera_is_used_if_there_is_none_with_colours() {
    let infrared = Camera { card: "Infrared", formats: &["GREY"], ..Camera::default() };
    let machine = Cameras::with(&[infrared]);
    let (service, receiver) = machine.serve(AUTO);
    receiver.until(IS_NO_FACE);
    service.await_log("camera opened: Infrared");
    drop(service);
    machine.plug(1, &Camera { card: "Colour", ..Camera::default() });
    let (service, receiver) = machine.serve(AUTO);
    receiver.until(IS_NO_FACE);
    service.await_log("camera opened: Colour");
}

#[test]
fn a_busy_camera_is_passed_over_and_one_on_usb_comes_first() {
    let busy = Camera { failures: Camera::failing("REQBUFS", Errno::BUSY).failures, ..Camera::built_in() };
    let machine = Cameras::with(&[busy, Camera::built_in()]);
    let (service, receiver) = machine.serve(AUTO);
    receiver.until(IS_NO_FACE);
    let passed = "camera opened: Simulated camera (/dev/video1; passed over /dev/video0, because /dev/video0 is in use by \
                  another program";
    service.await_log(passed);
    drop(service);
    machine.plug(2, &Camera { card: "Webcam", ..Camera::default() });
    let (service, receiver) = machine.serve(AUTO);
    receiver.until(IS_NO_FACE);
    service.await_log("camera opened: Webcam (/dev/video2): ");
}

#[test]
fn a_camera_that_comes_back_with_another_number_is_found_by_its_name_and_by_its_socket() {
    let camera = Camera { card: "UVC Camera", intervals: FPS_120, ..Camera::default() };
    let socket = "by-path/platform-usb-0:1:1.0-video-index0";
    let by_path = format!("/dev/v4l/{socket}");
    for (device, camera) in
        [("uvc camera", camera.clone()), (by_path.as_str(), camera.clone()), (by_path.as_str(), camera.multi_planar())]
    {
        let machine = Cameras::one(&camera);
        machine.link(socket, 0);
        let (service, receiver) = machine.serve(&settings_for(device));
        receiver.until(IS_NO_FACE);
        machine.unplug(0);
        receiver.until(IS_NO_CAMERA);
        service.await_log("camera lost: the camera is gone; plug it in again");
        machine.plug(1, &camera);
        machine.link(socket, 1);
        receiver.until(IS_NO_FACE);
        service.await_log("camera opened: UVC Camera (/dev/video1)");
        assert_eq!(service.logged("camera opened: UVC Camera (/dev/video0)"), 1, "{device}: {}", service.log());
    }
}

#[test]
fn a_camera_that_falls_silent_is_closed_and_opened_again() {
    let camera = Camera { intervals: FPS_120, ..Camera::default() };
    for camera in [camera.clone(), camera.multi_planar()] {
        let machine = Cameras::one(&camera);
        let (service, receiver) = machine.serve(&format!("{AUTO}stall_timeout_ms = 100\n"));
        receiver.until(IS_NO_FACE);
        machine.change(0, &Camera { limit: Some(0), ..camera.clone() });
        receiver.until(IS_NO_CAMERA);
        service.await_log("camera lost: the camera sent nothing for 100 ms; check its cable and USB bandwidth");
        machine.change(0, &camera);
        receiver.until(IS_NO_FACE);
        assert_eq!(counted(&service.status(), "cameras_opened"), 2);
        let calls = machine.calls(0);
        let opened = calls.lines().filter(|call| *call == "open").count();
        let closed = calls.lines().filter(|call| *call == "close").count();
        assert_eq!(opened, closed + 1, "each camera but the last is closed: {calls}");
        assert!(calls.contains("STREAMOFF\nREQBUFS 0\nclose\n"), "its buffers are given back: {calls}");
    }
}

#[test]
fn after_an_error_of_the_driver_the_camera_is_opened_again() {
    let camera = Camera { intervals: FPS_120, ..Camera::default() };
    for (call, error, sentence) in [
        ("DQBUF", Errno::IO, "camera lost: the camera failed while sending frames: Input/output error"),
        ("QBUF", Errno::IO, "camera lost: the camera failed while sending frames: Input/output error"),
        ("DQBUF", Errno::NODEV, "camera lost: the camera is gone; plug it in again"),
    ] {
        for camera in [camera.clone(), camera.clone().multi_planar()] {
            let machine = Cameras::one(&camera);
            let (service, receiver) = machine.serve(AUTO);
            receiver.until(IS_NO_FACE);
            machine.change(0, &Camera { failures: vec![Failure { call, error, nth: 1 }], ..camera });
            service.await_log(sentence);
            eventually("the camera", || service.logged("camera opened: ") == 2);
            receiver.until(IS_NO_FACE);
        }
    }
}

#[test]
fn a_camera_that_cannot_be_stopped_ends_the_service() {
    let camera = Camera { intervals: FPS_120, ..Camera::default() };
    for camera in [camera.clone(), camera.multi_planar()] {
        let machine = Cameras::one(&camera);
        let (mut service, receiver) = machine.serve(&format!("{AUTO}stall_timeout_ms = 100\n"));
        receiver.until(IS_NO_FACE);
        let failures = Camera::failing("STREAMOFF", Errno::IO).failures;
        machine.change(0, &Camera { limit: Some(0), failures, ..camera });
        eventually("the end", || service.child.try_wait().unwrap().is_some());
        assert_eq!(service.child.wait().unwrap().code(), Some(69), "{}", service.log());
        assert!(service.log().contains("/dev/video0 cannot be stopped: Input/output error"), "{}", service.log());
    }
}

#[test]
fn damaged_frames_are_counted_and_left_out_whatever_is_wrong_with_them() {
    let machine = Cameras::with(&[]);
    let film = machine.film("film", &clip_jpegs(5));
    let jpeg = Camera { formats: &["MJPG"], frames: film, intervals: FPS_120, ..Camera::default() };
    let raw = Camera { intervals: FPS_120, ..Camera::default() };
    for camera in [
        Camera { marked: (1, 5), ..raw.clone() },
        Camera { cut: (1, 5), ..raw.clone() },
        Camera { empty: (1, 5), ..raw.clone() },
        Camera { marked: (1, 5), ..raw.clone() }.multi_planar(),
        Camera { cut: (1, 5), ..raw.clone() }.multi_planar(),
        Camera { empty: (1, 5), data_offset: 32, ..raw }.multi_planar(),
        Camera { cut: (1, 5), ..jpeg.clone() },
        Camera { empty: (1, 5), ..jpeg },
    ] {
        machine.plug(0, &camera);
        let (service, receiver) = machine.serve(AUTO);
        receiver.packet();
        eventually("damaged frames", || counted(&service.status(), "damaged") >= 5);
        assert_eq!(service.logged("camera opened: "), 1, "{}", service.log());
    }
}

#[test]
fn a_camera_of_damaged_frames_is_none_until_it_sends_pictures() {
    let machine = Cameras::with(&[]);
    let camera = Camera { intervals: FPS_120, ..Camera::default() };
    machine.plug(0, &camera);
    let (service, receiver) = machine.serve(AUTO);
    receiver.until(IS_NO_FACE);
    machine.change(0, &Camera { cut: (1, 1), ..camera.clone() });
    receiver.until(IS_NO_CAMERA);
    // Three attempts to open the camera, each of which gives up after 8 damaged frames.
    eventually("damaged frames", || counted(&service.status(), "damaged") >= 24);
    machine.change(0, &camera);
    receiver.until(IS_NO_FACE);
    assert_eq!(counted(&service.status(), "cameras_opened"), 2);
    let log = service.log();
    let told = ["camera lost: 8 frames in a row were bad", "no camera: 8 frames in a row were bad"];
    assert_eq!(told.map(|line| log.matches(line).count()).iter().sum::<usize>(), 1, "{log}");
}

/// The numbers of the frames have gaps, as if the USB bus were too slow. Even a busy machine keeps up with ten frames a
/// second, and so loses none itself.
#[test]
fn frames_that_a_driver_loses_are_reported_as_missing() {
    let (intervals, lost) = (Listing::Discrete(&[[1, 10]]), (1, 4));
    let machine = Cameras::with(&[Camera { formats: &["GREY"], intervals, lost, ..Camera::default() }]);
    let (service, receiver) = machine.serve(AUTO);
    receiver.until(IS_NO_FACE);
    service.await_log("frames get lost or damaged between camera and board: give the camera a USB port of its own");
    assert!(service.status().contains(" impaired_by=missing-frames "), "{}", service.log());
}

/// A camera that shows the clip, mounted so that its picture must be turned clockwise by this angle to stand upright.
fn mounted(machine: &Cameras, rotation_deg: u32) -> Camera {
    let [width, height] = if rotation_deg % 180 == 90 { [480, 640] } else { [640, 480] };
    let place = |at: usize| match (rotation_deg, at % width, at / width) {
        (90, x, y) => x * 640 + 639 - y,
        (180, x, y) => (479 - y) * 640 + 639 - x,
        (270, x, y) => (479 - x) * 640 + y,
        _ => at,
    };
    let turned = |frame: &Vec<u8>| (0..width * height).map(|at| frame[place(at)]).collect();
    let frames: Vec<Vec<u8>> = clip_raw("GREY", 640, 10).iter().map(turned).collect();
    Camera {
        formats: &["GREY"],
        sizes: if width == 480 { Listing::Discrete(&[[480, 640]]) } else { Listing::Discrete(&[[640, 480]]) },
        stride: Some(width as u32),
        image_bytes: Some(frames[0].len() as u32),
        frames: machine.film("clip", &frames),
        ..Camera::default()
    }
}

#[test]
fn the_rotation_of_a_camera_on_its_side_or_upside_down_is_proposed_and_makes_its_face_that_of_an_upright_one() {
    let settings_with = |rotation_deg| PATIENT.replace("[failsafe]", &format!("rotation = {rotation_deg}\n[failsafe]"));
    let mut places_mm = Vec::new();
    for rotation_deg in [0, 90, 180, 270] {
        let machine = Cameras::with(&[]);
        machine.plug(0, &mounted(&machine, rotation_deg));
        let check = |set| {
            let file = settings(&settings_with(set));
            machine.run(&["check", "--config", text(file.path())]).out
        };
        if rotation_deg != 0 {
            let told = check(0);
            assert!(told.contains(&format!("set camera.rotation = {rotation_deg}")), "{rotation_deg}: {told}");
        }
        let good = check(rotation_deg);
        assert!(good.contains("; a face of ") && !good.contains("camera.rotation"), "{rotation_deg}: {good}");
        let (_service, receiver) = machine.serve(&settings_with(rotation_deg));
        let packet = receiver.live().pop().unwrap();
        let [_, _, roll_deg] = yaw_pitch_roll_deg(packet.rotation);
        assert!(roll_deg.abs() < 12.0, "{rotation_deg}: {roll_deg}");
        // The angle of view is that across the rows, of which the pictures on their side have fewer pixels.
        let [x_mm, y_mm, z_mm] = packet.position_mm;
        places_mm.push([x_mm, y_mm, if rotation_deg % 180 == 90 { z_mm * 640.0 / 480.0 } else { z_mm }]);
    }
    let is_near = |place: &[f32; 3]| place.iter().zip(places_mm[0]).all(|(one, other)| (one - other).abs() < 12.0);
    assert!(places_mm.iter().all(is_near), "{places_mm:?}");
}

#[test]
fn a_running_service_doubts_a_face_that_is_upside_down_and_says_which_rotation_makes_it_upright() {
    let machine = Cameras::with(&[]);
    machine.plug(0, &mounted(&machine, 180));
    let (service, receiver) = machine.serve(PATIENT);
    receiver.live();
    service.await_log("tracking is impaired: the face is hardly recognised or lies on its side");
    service.await_log("set camera.rotation = 180, which shows the face upright");
    assert!(service.status().contains(" proposed_rotation=180 "), "{}", service.status());
    service.reload(&PATIENT.replace("[failsafe]", "rotation = 180\n[failsafe]"));
    let is_upright =
        |status: String| status.contains(" impaired_by=none ") && status.contains(" proposed_rotation=none ");
    eventually("an upright face", || is_upright(service.status()) && !receiver.live().is_empty());
}

/// Writes the images of the clip to a named pipe again and again, as a program that reads a camera does, until it ends.
struct Feed {
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Feed {
    fn start(pipe: &Path) -> Self {
        let is_over = Arc::new(AtomicBool::new(false));
        let over = Arc::clone(&is_over);
        let pipe = pipe.to_owned();
        let thread = spawn(move || {
            let mut writer = File::options().write(true).open(pipe).unwrap();
            for image in clip_jpegs(60).iter().cycle().take_while(|_| !over.load(Relaxed)) {
                // Without a reader there is nothing to do.
                if writer.write_all(image).is_err() {
                    return;
                }
                sleep(Duration::from_millis(20));
            }
        });
        Self { is_over, thread: Some(thread) }
    }

    fn end(mut self) {
        self.is_over.store(true, Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}

#[test]
fn a_stream_through_a_named_pipe_is_a_camera_that_comes_back_with_its_writer() {
    let folder = tempfile::tempdir().unwrap();
    let pipe = folder.path().join("video");
    mknodat(CWD, &pipe, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
    let feed = Feed::start(&pipe);
    let machine = Cameras::with(&[]);
    let (service, receiver) = machine.serve(&PATIENT.replace("auto", text(&pipe)));
    receiver.live();
    service.await_log(&format!("camera opened: {}: JPEG 640x480", pipe.display()));
    feed.end();
    receiver.until(IS_NO_CAMERA);
    service.await_log("video has no writer any more; start the program that writes JPEG images to it");
    let again = Feed::start(&pipe);
    receiver.live();
    assert_eq!(counted(&service.status(), "damaged"), 0, "{}", service.log());
    again.end();
}
