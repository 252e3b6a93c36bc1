//! What a link to a Maestro promises, with a simulator that holds to its user's guide.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod board;
mod maestro;
#[path = "common/program.rs"]
#[allow(dead_code, reason = "each test uses a part")]
mod program;
#[path = "board/service.rs"]
#[allow(dead_code, reason = "each test uses a part")]
mod service;

use std::fs;
use std::path::Path;
use std::sync::Arc;

use allocation_counter::measure;
use board::{Board, StablePath, eventually};
use facewire::config::{self, Settings};
use facewire::link::{Link, Output, Pose, Traffic};
use facewire_packet::{BLENDSHAPES, Reason, State};
use maestro::{CRC_ERROR, Maestro, Model, PROTOCOL_ERROR};
use service::Service;

/// Two neighbouring channels, one that runs backwards, and one far away from them.
const CHANNELS: &str = "
[[link.channel]]
channel = 0
sources = { jawOpen = 1.0 }
pulse_at_0_us = 1900
pulse_at_1_us = 1100
speed_per_s = 2.0
acceleration_per_s2 = 10.0
[[link.channel]]
channel = 1
sources = { eyeBlinkLeft = 1.0 }
[[link.channel]]
channel = 5
sources = { headYaw = 0.01 }
offset = 0.5
loss = \"release\"
";

fn link(device: &Path, keys: &str) -> String {
    format!("[[link]]\nkind = \"maestro\"\ndevice = \"{}\"\n{keys}\n{CHANNELS}", device.display())
}

/// A link and its settings.
struct Open {
    settings: Settings,
    link: Link,
}

impl Open {
    fn to(device: &Path, keys: &str) -> Self {
        let settings = config::parse("test", &link(device, keys)).unwrap();
        let link = Link::open(&settings.links[0], &Arc::<Traffic>::default()).unwrap();
        let open = Self { settings, link };
        eventually("the port", || open.link.carrier().is_open());
        open
    }

    fn show(&mut self, state: State, sources: &[(&str, f32)]) {
        let mut pose = Pose::NEUTRAL;
        for (name, value) in sources {
            pose.coefficients[BLENDSHAPES.iter().position(|blendshape| blendshape == name).unwrap()] = *value;
        }
        let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
        let output = Output { state, reason, pose, age_us: 0, capture_us: 0, followed: true, moving: false };
        self.link.send_last(&self.settings.links[0], &output);
    }
}

#[test]
fn every_protocol_sets_targets_speeds_and_accelerations_without_an_error() {
    let with_crc = Model { crc: true, ..Model::MINI_24 };
    let detects = Model { detects_baud: true, ..Model::MICRO_6 };
    for (model, keys, code) in [
        (Model::MINI_24, "multiple_targets = true", 0x9F),
        (Model::MICRO_6, "", 0x84),
        (with_crc, "crc = true\nmultiple_targets = true\nprotocol = \"pololu\"", 0x9F),
        (with_crc, "crc = true", 0x84),
        (Model { device_number: 7, ..Model::MICRO_6 }, "protocol = \"pololu\"\ndevice_number = 7", 0x84),
        (detects, "", 0x84),
        (Model { device_number: 7, ..Model::MICRO_6 }, "", 0x84),
    ] {
        let maestro = Maestro::plugged_in(model);
        let mut open = Open::to(&maestro.device, keys);
        open.show(State::Live, &[("jawOpen", 0.25), ("eyeBlinkLeft", 2.0)]);
        eventually("the targets", || maestro.pulse_us(5) == Some(1500.0));
        assert_eq!([0, 1].map(|channel| maestro.pulse_us(channel)), [Some(1700.0), Some(2000.0)], "{keys}");
        let state = maestro.state();
        assert!(state.commands.contains(&code), "{keys}");
        assert_eq!(state.ever, 0, "{keys}: {:?}", state.commands);
        // 2.0 of 800 µs a second are 64 times 0.25 µs in 10 ms; 8000 µs/s² are 25.6 units of acceleration.
        assert_eq!((state.speeds[0], state.accelerations[0], state.speeds[1]), (64, 25, 0), "{keys}");
    }
}

#[test]
fn a_servo_moves_no_faster_than_its_limit_by_the_units_of_the_maestro() {
    let maestro = Maestro::plugged_in(Model::MINI_24);
    let mut open = Open::to(&maestro.device, "");
    open.show(State::Live, &[("jawOpen", 1.0)]);
    eventually("the target", || maestro.pulse_us(0) == Some(1100.0));
    let state = maestro.state();
    assert_eq!([100, 250, 500].map(|ms| state.reached(0, 7600, ms)), [6960, 6000, 4400], "800 µs in 0.5 s");
}

#[test]
fn sending_allocates_nothing() {
    let maestro = Maestro::plugged_in(Model::MINI_24);
    let mut open = Open::to(&maestro.device, "multiple_targets = true\ncrc = true");
    let allocated = measure(|| (0..100).for_each(|_| open.show(State::Live, &[("jawOpen", 0.3)])));
    assert_eq!(allocated.count_total, 0);
}

#[test]
fn a_maestro_that_was_unplugged_in_mid_move_gets_its_limits_and_the_newest_target_again() {
    let stable = StablePath::new();
    let plug = || {
        let maestro = Maestro::plugged_in(Model::MINI_24);
        std::os::unix::fs::symlink(&maestro.device, stable.path()).unwrap();
        maestro
    };
    let maestro = plug();
    let mut open = Open::to(&stable.path(), "");
    open.show(State::Live, &[("jawOpen", 0.5)]);
    eventually("the target", || maestro.pulse_us(0) == Some(1500.0));
    fs::remove_file(stable.path()).unwrap();
    drop(maestro);
    eventually("the loss", || {
        open.show(State::Live, &[("jawOpen", 0.6)]);
        !open.link.carrier().is_open()
    });
    let maestro = plug();
    open.show(State::Live, &[("jawOpen", 1.0)]);
    eventually("the newest target", || maestro.pulse_us(0) == Some(1100.0));
    assert_eq!(maestro.state().speeds[0], 64);
}

/// The service with these links, and with a camera that is missing: it sends neutral outputs all the time.
fn serve(links: &str) -> Service {
    Service::with(&format!("[camera]\ndevice = \"/dev/nowhere\"\n{links}"))
}

#[test]
fn each_error_of_a_maestro_is_told_once_with_what_to_do() {
    let maestro = Maestro::plugged_in(Model { crc: true, ..Model::MICRO_6 });
    let service = serve(&link(&maestro.device, "crc = true"));
    eventually("a command", || maestro.state().commands.contains(&0x84));
    for error in [CRC_ERROR, CRC_ERROR, PROTOCOL_ERROR] {
        maestro.state().fail(error);
        eventually("the question", || maestro.state().errors == 0);
    }
    eventually("the log", || service.logged("it received a command that it does not know") == 1);
    assert_eq!(service.logged("a command had a wrong checksum: give link.crc"), 1);
}

#[test]
fn a_maestro_that_does_not_answer_is_told_once_with_the_settings_to_look_at() {
    let deaf = Maestro::plugged_in(Model { takes_commands: false, ..Model::MICRO_6 });
    let wrong_crc = Maestro::plugged_in(Model { crc: true, ..Model::MICRO_6 });
    let links = [link(&deaf.device, ""), link(&wrong_crc.device, "")].concat();
    let service = serve(&links);
    eventually("the log", || service.logged("set its serial mode to \"USB Dual Port\"") == 2);
    let asked = wrong_crc.state().ever;
    assert_eq!(asked & PROTOCOL_ERROR, PROTOCOL_ERROR, "a command without its CRC");
    let quiet = Board::plugged_in();
    let one_way = serve(&link(&quiet.device, "read_errors = false"));
    eventually("the port", || one_way.logged("link opened") == 1);
    assert_eq!(service.logged("does not answer"), 2, "it was told again");
    assert_eq!(one_way.logged("does not answer"), 0);
}

#[test]
fn a_maestro_that_restarts_is_given_its_limits_again() {
    let maestro = Maestro::plugged_in(Model::MICRO_6);
    let mut open = Open::to(&maestro.device, "");
    open.show(State::Live, &[]);
    eventually("the limits", || maestro.state().speeds[0] == 64);
    maestro.state().speeds[0] = 0;
    eventually("the limits again", || maestro.state().speeds[0] == 64);
}
