//! The known faults of the program with unusual cameras, serial drivers and networks. The test of an entry passes as long as
//! the fault is there, and fails once it is fixed. Then remove the entry, and write a test for what the program does now.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::net::UdpSocket;
use std::process::ExitCode;

use common::board::Board;
use common::camera::{
    Camera, Cameras, Clock, DEVICE_CAPS, FPS_120, Listing, STREAMING, VIDEO_CAPTURE_MPLANE, clip_jpegs,
};
use common::eventually;
use common::hooks::hook;
use common::interface::Interface;
use common::service::{DEMO, Service, counted};
use facewire_packet::State;
use facewire_packet::formats::ifacialmocap::REQUEST;
use libtest_mimic::{Arguments, Failed, Trial};
use rustix::io::Errno;

const AUTO: &str = "[camera]\ndevice = \"auto\"\n";

struct Fault {
    name: &'static str,
    symptom: &'static str,
    is_mended: fn() -> bool,
}

/// All faults that are known.
const FAULTS: [Fault; 16] = [
    Fault {
        name: "a_clock_that_stands_still",
        symptom: "the face is neutral for ever, and the log says nothing",
        is_mended: || is_live_by(Clock::Frozen),
    },
    Fault {
        name: "a_clock_that_shows_zero",
        symptom: "the face is neutral for ever, and the log says nothing",
        is_mended: || is_live_by(Clock::Constant(0)),
    },
    Fault {
        name: "a_clock_with_a_negative_time",
        symptom: "the face is neutral for ever, and the log says nothing",
        is_mended: || is_live_by(Clock::Constant(-140_448_221_376_697)),
    },
    Fault {
        name: "a_clock_that_begins_with_the_stream",
        symptom: "the face is neutral for ever, and the log says nothing",
        is_mended: || is_live_by(Clock::FromStart),
    },
    Fault {
        name: "a_clock_that_is_behind",
        symptom: "the face is neutral for ever, and the log says nothing",
        // Further behind than any time limit of the failsafe, also on a slow machine.
        is_mended: || is_live_by(Clock::Offset(-60_000_000)),
    },
    Fault {
        name: "a_camera_in_uyvy",
        symptom: "\"does not offer YUYV, NV12, MJPEG, JPEG or GREY\"",
        is_mended: || opens(&["UYVY"]),
    },
    Fault {
        name: "a_camera_in_yu12",
        symptom: "\"does not offer YUYV, NV12, MJPEG, JPEG or GREY\"",
        is_mended: || opens(&["YU12"]),
    },
    Fault {
        name: "formats_that_are_not_read_are_not_named",
        symptom: "`facewire devices` says \"no format that facewire reads\", but not which formats the camera has",
        is_mended: || {
            let machine = Cameras::with(&[Camera { formats: &["pBAA"], ..Camera::default() }]);
            machine.run(&["devices"]).succeeded().out.contains("pBAA")
        },
    },
    Fault {
        name: "a_multiplanar_camera",
        symptom: "\"there is no camera\"",
        is_mended: || {
            let own = VIDEO_CAPTURE_MPLANE | STREAMING;
            let camera = Camera { formats: &["NV12"], capabilities: [own | DEVICE_CAPS, own], ..Camera::default() };
            outcome(&Cameras::with(&[camera])).is_none_or(|said| !said.contains("there is no camera"))
        },
    },
    Fault {
        name: "a_driver_that_takes_every_interval",
        symptom: "it is asked for 1000 fps, because its longest interval, 2^32 - 1 s, is not believed",
        is_mended: || {
            let intervals = Listing::Continuous { least: [1, 1000], most: [u32::MAX, 1] };
            let machine = Cameras::with(&[Camera { intervals, pace: Some([1, 120]), ..Camera::default() }]);
            assert_eq!(outcome(&machine), None);
            machine.calls(0).contains("S_PARM 1/30\n")
        },
    },
    Fault {
        name: "a_jpeg_image_with_more_rows_than_the_driver_says",
        symptom: "the camera never opens: \"it is 640x480, not the announced size\"",
        is_mended: || {
            let machine = Cameras::with(&[]);
            let (formats, film) = (&["MJPG"], machine.film("film", &clip_jpegs(8)));
            machine.plug(0, &Camera { formats, frames: film, granted_size: Some([640, 472]), ..Camera::default() });
            outcome(&machine).is_none()
        },
    },
    Fault {
        name: "frames_without_a_byte",
        symptom: "\"check the camera's cable and USB bandwidth\", although the driver sends empty frames",
        is_mended: || {
            let machine = Cameras::with(&[Camera { empty: (1, 1), intervals: FPS_120, ..Camera::default() }]);
            outcome(&machine).is_none_or(|said| !said.contains("check the camera's cable and USB bandwidth"))
        },
    },
    Fault {
        name: "a_camera_that_times_out_when_it_is_started",
        symptom: "\"the camera sent nothing for 5000 ms\", although its driver has refused to start at once",
        is_mended: || {
            let machine = Cameras::with(&[Camera::failing("STREAMON", Errno::TIMEDOUT)]);
            outcome(&machine).is_none_or(|said| !said.contains("sent nothing for 5000 ms"))
        },
    },
    Fault {
        name: "an_infrared_camera_beside_one_with_colours",
        symptom: "`auto` takes the infrared camera if its node has the lower number",
        is_mended: || {
            let infrared = Camera { card: "Infrared", formats: &["GREY"], ..Camera::default() };
            let machine = Cameras::with(&[infrared, Camera { card: "Colour", ..Camera::default() }]);
            let (service, _receiver) = machine.serve(AUTO);
            service.await_log("camera opened: ");
            service.logged("camera opened: Colour") == 1
        },
    },
    Fault {
        name: "a_serial_driver_that_makes_another_rate",
        symptom: "the link runs at 921,600 baud in place of 2,000,000, and the log says \"at 2000000 baud\"",
        is_mended: || {
            let mut board = Board::plugged_in();
            let link =
                format!("[[link]]\nkind = \"serial\"\ndevice = \"{}\"\nbaud = 2000000\n", board.device.display());
            let service = Service::start_with(&[DEMO, &link].concat(), &[], |command| {
                command.env("LD_PRELOAD", hook("serial")).env("SERIAL_BASE_BAUD", "921600")
            });
            eventually("packets", || !board.packets().is_empty());
            assert_eq!(rustix::termios::tcgetattr(board.port()).unwrap().output_speed(), 921_600);
            service.logged("921600") > 0
        },
    },
    Fault {
        name: "an_ifacialmocap_receiver_whose_network_was_away",
        symptom: "it is dropped after 3 s, and never gets the face again, because it asks only once",
        is_mended: ifacialmocap_comes_back,
    },
];

/// Whether packets are live after ten frames with a face from a camera with this clock.
fn is_live_by(clock: Clock) -> bool {
    let machine = Cameras::with(&[]);
    machine.show_clip(Camera { formats: &["MJPG"], clock, ..Camera::default() });
    let (service, receiver) = machine.serve(AUTO);
    receiver.packet();
    eventually("frames with a face", || counted(&service.status(), "faces") >= 10);
    receiver.rest().iter().any(|packet| packet.state == State::Live)
}

fn opens(formats: &'static [&'static str]) -> bool {
    let machine = Cameras::with(&[]);
    machine.show_clip(Camera { formats, ..Camera::default() });
    let said = outcome(&machine);
    let is_this_fault = said.as_ref().is_none_or(|said| said.contains("does not offer"));
    assert!(is_this_fault, "another fault: {said:?}");
    said.is_none()
}

/// The reason why the service opens no camera, or `None` if it opens one.
fn outcome(machine: &Cameras) -> Option<String> {
    let (service, _receiver) = machine.serve(AUTO);
    eventually("a word about the camera", || service.logged("camera opened: ") + service.logged("no camera: ") > 0);
    let log = service.log();
    let said = log.lines().find_map(|line| line.split_once("no camera: "));
    said.map(|(_, said)| said.trim_end_matches("; trying again").to_owned())
}

/// Whether a receiver that does not ask again gets the face after its network has been away.
fn ifacialmocap_comes_back() -> bool {
    let Some(interface) = Interface::inside("an_ifacialmocap_receiver_whose_network_was_away") else { return false };
    let receiver = UdpSocket::bind("0.0.0.0:0").unwrap();
    receiver.set_nonblocking(true).unwrap();
    let mut bytes = [0; 4096];
    let mut gets_face = || receiver.recv(&mut bytes).is_ok();
    let link = "[[link]]\nkind = \"ifacialmocap\"\nreply_port = 0\n";
    let (service, near) = Service::with_receiver(&[DEMO, link].concat());
    eventually("the face", || {
        let _ = receiver.send_to(REQUEST, (Interface::ADDRESS, 49983));
        gets_face()
    });
    interface.take_down();
    service.await_log("is away, and no longer gets the face");
    while gets_face() {}
    interface.bring_up();
    near.rest();
    (0..20).for_each(|_| _ = near.packet());
    gets_face()
}

fn main() -> ExitCode {
    let trial = |fault: Fault| {
        Trial::test(fault.name, move || match (fault.is_mended)() {
            false => Ok(()),
            true => Err(Failed::from(format!(
                "{} is mended ({}): take it off the list, and promise what holds now in a test",
                fault.name, fault.symptom
            ))),
        })
    };
    libtest_mimic::run(&Arguments::from_args(), FAULTS.into_iter().map(trial).collect()).exit_code()
}
