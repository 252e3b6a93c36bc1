//! What a link to a Maestro and `facewire servo` promise, with a simulator that holds to the Maestro's user's guide.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::io::{Read as _, Write as _};
use std::os::fd::OwnedFd;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Child, ExitStatus, Stdio};
use std::sync::Arc;

use allocation_counter::measure;
use common::board::{Board, StablePath};
use common::eventually;
use common::maestro::{CRC_ERROR, Maestro, Model, PROTOCOL_ERROR, State as MaestroState, remainder};
use common::program::{Run, facewire, text};
use common::service::{NO_CAMERA, Service};
use facewire::config::{self, Settings};
use facewire::link::{Link, Output, Traffic};
use facewire_packet::{BLENDSHAPES, Pose, Reason, State};
use rustix::fs::fcntl_setfl;
use rustix::process::{Pid, Signal, kill_process};
use rustix::termios::{LocalModes, tcgetattr};

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

struct Open {
    settings: Settings,
    link: Link,
}

impl Open {
    fn to(device: &Path, keys: &str) -> Self {
        let settings = config::parse("test", &link(device, keys)).unwrap();
        let link = Link::open(&settings.links[0], &Arc::<Traffic>::default()).unwrap();
        eventually("the port", || link.is_open());
        Self { settings, link }
    }

    fn show(&mut self, sources: &[(&str, f32)]) {
        let mut pose = Pose::NEUTRAL;
        for (name, value) in sources {
            pose.coefficients[BLENDSHAPES.iter().position(|blendshape| blendshape == name).unwrap()] = *value;
        }
        let (state, reason) = (State::Live, Reason::None);
        let output =
            Output { state, reason, pose, age_us: 0, capture_us: 0, followed: true, moving: false, is_puppet: false };
        self.link.send_last(&self.settings.links[0], &output);
    }
}

fn await_pulse(maestro: &Maestro, channel: usize, wanted: Option<f32>) {
    eventually(&format!("{wanted:?}"), || maestro.pulse_us(channel) == wanted);
}

#[test]
fn the_simulator_agrees_with_the_examples_of_the_guide() {
    assert_eq!(remainder(&[0x83, 0x01]), 0x17);
    let after = |commands: &[u8]| {
        let mut state = MaestroState::default();
        commands.iter().for_each(|byte| state.take(*byte, &Model::MINI_24));
        state
    };
    let mut state = after(&[0x84, 0x00, 0x70, 0x2E, 0x87, 0x05, 0x0C, 0x01, 0x9F, 2, 3, 0, 0, 0x70, 0x2E]);
    assert_eq!((state.targets[0], state.speeds[5], state.targets[4], state.ever), (6000, 140, 6000, 0));
    // 1000 to 1350 µs at 3.5 µs/ms take 100 ms.
    state.targets[5] = 5400;
    assert_eq!([50, 100].map(|ms| state.reached(5, 4000, ms)), [4700, 5400]);
    for broken in [&[0x84, 0x00, 0x84][..], &[0x05], &[0xB5]] {
        assert_eq!(after(broken).errors, PROTOCOL_ERROR, "{broken:?}");
    }
}

#[test]
fn every_protocol_sets_targets_speeds_and_accelerations_without_an_error_or_an_allocation() {
    let with_crc = Model { crc: true, ..Model::MINI_24 };
    let number_7 = Model { device_number: 7, ..Model::MICRO_6 };
    for (model, keys, code) in [
        (Model::MINI_24, "multiple_targets = true", 0x9F),
        (Model::MICRO_6, "", 0x84),
        (with_crc, "crc = true\nmultiple_targets = true\nprotocol = \"pololu\"", 0x9F),
        (with_crc, "crc = true", 0x84),
        (number_7, "protocol = \"pololu\"\ndevice_number = 7", 0x84),
        (number_7, "", 0x84),
        (Model { detects_baud: true, ..Model::MICRO_6 }, "", 0x84),
    ] {
        let maestro = Maestro::plugged_in(model);
        let mut open = Open::to(&maestro.device, keys);
        let sources = [("jawOpen", 0.25), ("eyeBlinkLeft", 2.0)];
        let allocated = measure(|| (0..100).for_each(|_| open.show(&sources)));
        assert_eq!(allocated.count_total, 0, "{keys}");
        await_pulse(&maestro, 5, Some(1500.0));
        assert_eq!([0, 1].map(|channel| maestro.pulse_us(channel)), [Some(1700.0), Some(2000.0)], "{keys}");
        let state = maestro.state();
        assert!(state.commands.contains(&code) && state.ever == 0, "{keys}: {:?}", state.commands);
        // 2.0 of 800 µs a second are 64 times 0.25 µs in 10 ms; 8000 µs/s² are 25.6 units of acceleration.
        assert_eq!((state.speeds[0], state.accelerations[0], state.speeds[1]), (64, 25, 0), "{keys}");
        assert_eq!(state.reached(0, 7600, 100), 6960, "800 µs in 0.5 s");
    }
}

#[test]
fn a_maestro_that_was_unplugged_in_mid_move_gets_its_limits_and_the_newest_target_again() {
    let stable = StablePath::new();
    let plug = || {
        let maestro = Maestro::plugged_in(Model::MINI_24);
        symlink(&maestro.device, stable.path()).unwrap();
        maestro
    };
    let maestro = plug();
    let mut open = Open::to(&stable.path(), "");
    open.show(&[("jawOpen", 0.5)]);
    await_pulse(&maestro, 0, Some(1500.0));
    fs::remove_file(stable.path()).unwrap();
    drop(maestro);
    eventually("the loss", || {
        open.show(&[("jawOpen", 0.6)]);
        !open.link.is_open()
    });
    let maestro = plug();
    open.show(&[("jawOpen", 1.0)]);
    await_pulse(&maestro, 0, Some(1100.0));
    assert_eq!(maestro.state().speeds[0], 64);
    // A Maestro that restarts by itself has lost its limits, too.
    maestro.state().speeds[0] = 0;
    eventually("the limits again", || maestro.state().speeds[0] == 64);
}

/// The service with these links, and with a camera that is missing: it sends neutral outputs all the time.
fn serve(links: &str) -> Service {
    Service::start(&[NO_CAMERA, links].concat(), &[])
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
    service.await_log("it received a command that it does not know");
    assert_eq!(service.logged("a command had a wrong checksum: give link.crc"), 1);
}

#[test]
fn a_maestro_that_does_not_answer_is_told_once_with_the_settings_to_look_at() {
    let deaf = Maestro::plugged_in(Model { takes_commands: false, ..Model::MICRO_6 });
    let wrong_crc = Maestro::plugged_in(Model { crc: true, ..Model::MICRO_6 });
    let quiet = Board::plugged_in();
    let links = [link(&deaf.device, ""), link(&wrong_crc.device, ""), link(&quiet.device, "read_errors = false")];
    let service = serve(&links.concat());
    eventually("the log", || service.logged("set its serial mode to \"USB Dual Port\"") == 2);
    assert_eq!(wrong_crc.state().ever & PROTOCOL_ERROR, PROTOCOL_ERROR, "a command without its CRC");
    eventually("the ports", || service.logged("link opened") == 3);
    assert_eq!(service.logged("does not answer"), 2, "{}", service.log());
}

const RIGHT: &[u8] = b"\x1b[C";
const LEFT: &[u8] = b"\x1b[D";
const UP: &[u8] = b"\x1b[A";

struct Session {
    terminal: Board,
    port: OwnedFd,
    child: Child,
    screen: String,
}

impl Session {
    fn of(arguments: &[&str]) -> Self {
        let terminal = Board::plugged_in();
        let port = terminal.port();
        fcntl_setfl(&port, rustix::fs::OFlags::empty()).unwrap();
        let end = || Stdio::from(port.try_clone().unwrap());
        let mut command = facewire(["servo", "--channel", "3"].iter().chain(arguments));
        let child = command.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
        Self { child, port, terminal, screen: String::new() }
    }

    fn with(maestro: &Maestro, arguments: &[&str]) -> Self {
        let mut session = Self::of(&[&["--maestro", text(&maestro.device)], arguments].concat());
        session.shows("1500 us (no pulses)");
        session
    }

    fn read(&mut self) -> &str {
        let mut bytes = [0; 4096];
        let length = self.terminal.master.read(&mut bytes).unwrap_or(0);
        self.screen += &String::from_utf8_lossy(&bytes[..length]);
        &self.screen
    }

    fn shows(&mut self, what: &str) {
        eventually(what, || self.read().contains(what));
    }

    fn press(&mut self, key: &[u8]) {
        self.terminal.master.write_all(key).unwrap();
    }

    /// Waits for the end. The terminal must be as it was before.
    fn ended(&mut self) -> ExitStatus {
        let mut status = None;
        eventually("the end", || {
            self.read();
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        self.read();
        let modes = tcgetattr(&self.port).unwrap().local_modes;
        assert!(modes.contains(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG), "{modes:?}");
        status.unwrap()
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn keys_move_one_channel_and_the_lines_for_the_settings_come_at_the_end() {
    let maestro = Maestro::plugged_in(Model::MICRO_6);
    let mut session = Session::with(&maestro, &[]);
    assert_eq!(maestro.pulse_us(3), None, "pulses before the first key");
    for (key, pulse_us) in
        [(RIGHT, 1500.0), (RIGHT, 1510.0), (UP, 1560.0), (b"1", 1560.0), (LEFT, 1550.0), (b"n", 1550.0)]
    {
        session.press(key);
        await_pulse(&maestro, 3, Some(pulse_us));
    }
    session.shows("neutral: 1550");
    (0..11).for_each(|_| session.press(LEFT));
    await_pulse(&maestro, 3, Some(1440.0));
    session.press(b"0");
    session.shows("0: 1440");
    session.press(b"q");
    assert!(session.ended().success(), "{}", session.screen);
    let lines = "[[link.channel]]\r\nchannel = 3\r\nsources = { jawOpen = 1.0 }   # what the servo follows\r\n\
                 pulse_at_0_us = 1440\r\npulse_at_1_us = 1560\r\nneutral = 0.917\r\n";
    assert!(session.screen.ends_with(lines), "{}", session.screen);
    await_pulse(&maestro, 3, None);
    let state = maestro.state();
    assert!(state.ever == 0 && state.speeds[3] > 0);
    assert!(state.targets.iter().all(|target| *target == 0), "another channel moved");
}

#[test]
fn the_servo_is_released_and_the_terminal_restored_after_a_signal_and_after_ctrl_c_or_holds_its_neutral_pulse() {
    for signal in [Some(Signal::TERM), Some(Signal::HUP), None] {
        let maestro = Maestro::plugged_in(Model::MICRO_6);
        let mut session = Session::with(&maestro, &[]);
        session.press(RIGHT);
        await_pulse(&maestro, 3, Some(1500.0));
        match signal {
            Some(signal) => kill_process(Pid::from_child(&session.child), signal).unwrap(),
            None => session.press(b"\x03"),
        }
        assert!(session.ended().success(), "{signal:?}: {}", session.screen);
        await_pulse(&maestro, 3, None);
    }
    let maestro = Maestro::plugged_in(Model::MICRO_6);
    let mut session = Session::with(&maestro, &["--end", "neutral"]);
    [RIGHT, b"n", UP, b"q"].into_iter().for_each(|key| session.press(key));
    assert!(session.ended().success());
    await_pulse(&maestro, 3, Some(1500.0));
}

#[test]
fn a_board_that_is_in_use_deaf_or_missing_and_a_missing_terminal_are_told_with_what_to_do() {
    let used = Maestro::plugged_in(Model::MICRO_6);
    let _link = Open::to(&used.device, "");
    let deaf = Maestro::plugged_in(Model { takes_commands: false, ..Model::MICRO_6 });
    for (arguments, told) in [
        (["--maestro", text(&used.device)], "systemctl stop facewire"),
        (["--maestro", text(&deaf.device)], "USB Dual Port"),
        (["--pca9685", "250"], "I2C bus 250, address 0x40: there is no /dev/i2c bus"),
    ] {
        let mut session = Session::of(&arguments);
        assert_eq!(session.ended().code(), Some(69), "{}", session.screen);
        assert!(session.screen.contains(told), "{}", session.screen);
    }
    assert!(Run::of(&mut facewire(["servo", "--channel", "0"])).sentence(1).contains("terminal"));
}
