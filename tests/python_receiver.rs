//! `packet/python/receiver.py` follows the face that the program sends, and goes neutral when the program is gone.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod board;
mod common;

use std::io::{BufRead as _, BufReader};
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use board::Board;
use common::service::Service;
use common::{python_with, skip};
use facewire_packet::{Packet, State};
use rustix::process::Signal;

/// Longer than anything in these tests takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);

/// What the receiver shows: whether packets come, jaw, left lid, and the rotation of the head.
#[derive(Debug)]
struct Shown {
    is_live: bool,
    values: Vec<f32>,
}

impl Shown {
    fn is_neutral(&self) -> bool {
        self.values == [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    }
}

/// The running receiver. It is killed when the test ends.
struct Receiver {
    child: Child,
    lines: Box<dyn Iterator<Item = String>>,
}

impl Receiver {
    fn start(python: &Path, arguments: &[&str]) -> Self {
        let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("packet/python/receiver.py");
        let mut command = Command::new(python);
        command.arg(program).args(arguments).env("PYTHONDONTWRITEBYTECODE", "1");
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let lines = Box::new(BufReader::new(child.stdout.take().unwrap()).lines().map(Result::unwrap));
        Self { child, lines }
    }

    /// Reads what is shown up to the first that is wanted, and returns all of it.
    fn until(&mut self, wanted: impl Fn(&Shown) -> bool) -> Vec<Shown> {
        let begun = Instant::now();
        let mut shown = Vec::new();
        while !shown.last().is_some_and(&wanted) {
            assert!(begun.elapsed() < PATIENCE, "{:?}", shown.last());
            let line = self.lines.next().unwrap();
            let (state, values) = line.split_once(' ').unwrap();
            let values = values.split(' ').map(|value| value.parse().unwrap()).collect();
            shown.push(Shown { is_live: state == "live", values });
        }
        shown
    }
}

impl Drop for Receiver {
    fn drop(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

/// A UDP port of the loopback address that nobody uses.
fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

#[test]
fn by_udp_the_face_moves_and_is_neutral_after_the_program_was_killed() {
    let port = free_port();
    let mut receiver = Receiver::start(Path::new("python3"), &["--host", "127.0.0.1", "--port", &port.to_string()]);
    assert!(receiver.until(|_| true)[0].is_neutral());
    let service = Service::start("[camera]\ndevice = \"demo\"\n", &[format!("127.0.0.1:{port}")]);
    receiver.until(|shown| shown.is_live && shown.values[0] > 0.2);
    service.stop(Signal::KILL);
    let shown = receiver.until(|shown| !shown.is_live && shown.is_neutral());
    let falls = shown.iter().filter(|shown| !shown.is_live).collect::<Vec<_>>();
    assert!(falls.len() > 2, "the face does not jump: {shown:?}");
    assert!(falls.is_sorted_by(|before, after| before.values[0] >= after.values[0]), "{falls:?}");
}

#[test]
fn by_a_serial_line_the_face_moves_whatever_else_is_on_the_line() {
    let Some(python) = python_with("serial") else {
        skip("there is no pyserial: run scripts/setup tests");
        return;
    };
    let board = Board::plugged_in();
    let mut receiver = Receiver::start(&python, &["--serial", board.device.to_str().unwrap()]);
    assert!(receiver.until(|_| true)[0].is_neutral());
    let mut packet = Packet { state: State::Live, ..Packet::NEUTRAL };
    packet.coefficients[17] = 0.75;
    board.send(b"Booting\r\n");
    let mut shown = Vec::new();
    while !shown.last().is_some_and(|shown: &Shown| (shown.values[0] - 0.75).abs() < 1e-3) {
        packet.sequence += 1;
        board.send(&packet.encode_frame());
        shown.extend(receiver.until(|_| true));
    }
    receiver.until(|shown| !shown.is_live && shown.is_neutral());
}
