//! `facewire servo` on a pseudo-terminal, with a simulated Maestro.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod board;
mod maestro;

use std::io::{Read as _, Write as _};
use std::os::fd::OwnedFd;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;

use board::{Board, eventually};
use facewire::config;
use facewire::link::{Link, Traffic};
use maestro::{Maestro, Model};
use rustix::fs::fcntl_setfl;
use rustix::process::{Pid, Signal, kill_process};
use rustix::termios::{LocalModes, tcgetattr};

const RIGHT: &[u8] = b"\x1b[C";
const LEFT: &[u8] = b"\x1b[D";
const UP: &[u8] = b"\x1b[A";

/// `facewire servo` in a terminal.
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
        let mut command = Command::new(env!("CARGO_BIN_EXE_facewire"));
        command.arg("servo").args(arguments).stdin(end()).stdout(end()).stderr(end());
        Self { child: command.spawn().unwrap(), port, terminal, screen: String::new() }
    }

    fn with(maestro: &Maestro, arguments: &[&str]) -> Self {
        let device = maestro.device.to_str().unwrap();
        let mut session = Self::of(&[&["--channel", "3", "--maestro", device], arguments].concat());
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

/// Keeps the pulse of channel 3 for a comparison.
fn pulses(maestro: &Maestro, wanted: Option<f32>) {
    eventually(&format!("{wanted:?}"), || maestro.pulse_us(3) == wanted);
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
        pulses(&maestro, Some(pulse_us));
    }
    session.shows("neutral: 1550");
    (0..11).for_each(|_| session.press(LEFT));
    pulses(&maestro, Some(1440.0));
    session.press(b"0");
    session.shows("0: 1440");
    session.press(b"q");
    assert!(session.ended().success(), "{}", session.screen);
    let lines = [
        "[[link.channel]]",
        "channel = 3",
        "sources = { jawOpen = 1.0 }   # what the servo follows",
        "pulse_at_0_us = 1440",
        "pulse_at_1_us = 1560",
        "neutral = 0.917\r\n",
    ];
    assert!(session.screen.ends_with(&lines.join("\r\n")), "{}", session.screen);
    pulses(&maestro, None);
    let state = maestro.state();
    assert_eq!(state.ever, 0);
    assert!(state.targets.iter().all(|target| *target == 0) && state.speeds[3] > 0, "another channel moved");
}

#[test]
fn the_servo_is_released_and_the_terminal_restored_after_a_signal_and_after_ctrl_c() {
    for signal in [Some(Signal::TERM), Some(Signal::HUP), None] {
        let maestro = Maestro::plugged_in(Model::MICRO_6);
        let mut session = Session::with(&maestro, &[]);
        session.press(RIGHT);
        pulses(&maestro, Some(1500.0));
        match signal {
            Some(signal) => kill_process(Pid::from_child(&session.child), signal).unwrap(),
            None => session.press(b"\x03"),
        }
        assert!(session.ended().success(), "{signal:?}: {}", session.screen);
        pulses(&maestro, None);
    }
}

#[test]
fn with_end_neutral_the_servo_holds_its_neutral_pulse() {
    let maestro = Maestro::plugged_in(Model::MICRO_6);
    let mut session = Session::with(&maestro, &["--end", "neutral"]);
    for key in [RIGHT, b"n", UP, b"q"] {
        session.press(key);
    }
    assert!(session.ended().success());
    pulses(&maestro, Some(1500.0));
}

#[test]
fn a_board_that_a_link_of_a_service_has_is_refused_with_what_to_do() {
    let maestro = Maestro::plugged_in(Model::MICRO_6);
    let device = maestro.device.to_str().unwrap();
    let text = format!(
        "[[link]]\nkind = \"maestro\"\ndevice = \"{device}\"\n[[link.channel]]\nchannel = 0\nsources = {{ jawOpen = 1.0 }}\n"
    );
    let settings = config::parse("test", &text).unwrap();
    let link = Link::open(&settings.links[0], &Arc::<Traffic>::default()).unwrap();
    eventually("the port", || link.carrier().is_open());
    let mut session = Session::of(&["--channel", "3", "--maestro", device]);
    assert_eq!(session.ended().code(), Some(69), "{}", session.screen);
    assert!(session.screen.contains("systemctl stop facewire"), "{}", session.screen);
}

#[test]
fn a_maestro_that_does_not_listen_is_told_with_the_settings_to_look_at() {
    let maestro = Maestro::plugged_in(Model { takes_commands: false, ..Model::MICRO_6 });
    let mut session = Session::of(&["--channel", "3", "--maestro", maestro.device.to_str().unwrap()]);
    assert_eq!(session.ended().code(), Some(69));
    assert!(session.screen.contains("USB Dual Port"), "{}", session.screen);
}

#[test]
fn without_a_terminal_the_command_says_so_and_touches_nothing() {
    let mut command = Command::new(env!("CARGO_BIN_EXE_facewire"));
    let output = command.args(["servo", "--channel", "0"]).stdin(Stdio::null()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("terminal"));
}

#[test]
fn a_chip_on_a_bus_that_does_not_exist_is_told_with_what_to_do() {
    let mut session = Session::of(&["--channel", "3", "--pca9685", "250"]);
    assert_eq!(session.ended().code(), Some(69));
    assert!(session.screen.contains("I2C bus 250, address 0x40: there is no /dev/i2c bus"), "{}", session.screen);
}
