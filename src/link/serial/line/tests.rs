#![allow(clippy::unwrap_used)]

use std::os::fd::OwnedFd;

use facewire_packet::FRAME_BYTES;
use rustix::fs::{Mode, OFlags};
use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};

use super::*;
use crate::config::AutoDevice;

/// Returns how many of the packets given in 10 s a line takes, and the longest time that one of them waits.
fn given(packets_hz: u32, baud: u32) -> (u32, Duration) {
    let (bytes_per_s, mut unsent_bytes, mut taken, mut longest) = (f64::from(baud) / 10.0, 0.0, 0, 0.0);
    for _ in 0..10 * packets_hz {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some hundreds")]
        if !is_behind(unsent_bytes as u32, FRAME_BYTES) {
            longest = f64::max(longest, unsent_bytes / bytes_per_s);
            unsent_bytes += FRAME_BYTES as f64;
            taken += 1;
        }
        unsent_bytes = f64::max(0.0, unsent_bytes - bytes_per_s / f64::from(packets_hz));
    }
    (taken, Duration::from_secs_f64(longest))
}

#[test]
fn a_line_that_is_given_too_many_packets_is_always_busy_and_no_packet_waits_for_two_others() {
    let packet = Duration::from_secs_f64(10.0 * FRAME_BYTES as f64 / 57_600.0);
    let (taken, waited) = given(60, 57_600);
    assert!((428..=432).contains(&taken), "{taken}: 57,600 baud carry 42.99 a second");
    assert!(waited <= packet, "{waited:?}");
}

#[test]
fn a_line_that_is_fast_enough_drops_no_packet() {
    assert_eq!(given(42, 57_600).0, 420);
}

/// A line at a pseudo-terminal whose board began to restart at this time, the board's end, and the port.
fn restarting(begun: Instant) -> (Line, TTYPort, OwnedFd) {
    let (mut board, tty) = TTYPort::pair().unwrap();
    board.set_timeout(Duration::from_secs(10)).unwrap();
    let device = PathBuf::from(tty.name().unwrap());
    let open = || rustix::fs::open(&device, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
    let port = open();
    let mut modes = tcgetattr(&port).unwrap();
    modes.control_modes |= ControlModes::HUPCL;
    tcsetattr(&port, OptionalActions::Now, &modes).unwrap();
    let place = Place::Board(BoardSearch::new(AutoDevice::Microcontroller));
    let mut line = Line::new(place, 115_200, vec![0], Some(QUESTION));
    let (restart, claim) = (Restart::new(open(), begun), PortClaim::acquire(&device).unwrap());
    line.open = Some(Port::new(device.clone(), tty, Some(restart), claim));
    (line, board, port)
}

const QUESTION: Inquiry = Inquiry { question: Vec::new(), answer_bytes: 0, troubles: |_| Vec::new(), silence: "" };

fn keeps_dtr(port: &OwnedFd) -> bool {
    !tcgetattr(port).unwrap().control_modes.contains(ControlModes::HUPCL)
}

#[test]
fn a_board_that_restarts_gets_neither_preamble_nor_messages_and_the_port_lowers_dtr_if_it_is_closed() {
    let (mut line, board, port) = restarting(Instant::now() + Duration::from_secs(1000));
    for _ in 0..3 {
        assert!(!line.write(b"dropped").unwrap());
        line.attend().unwrap();
    }
    assert_eq!(board.bytes_to_read().unwrap(), 0);
    assert!(!keeps_dtr(&port));
}

#[test]
fn a_board_that_has_restarted_gets_the_preamble_once_and_then_messages_and_the_port_keeps_dtr() {
    let begun = Instant::now().checked_sub(Duration::from_secs(2)).unwrap();
    let (mut line, mut board, port) = restarting(begun);
    line.attend().unwrap();
    assert!(keeps_dtr(&port));
    assert!(line.write(b"first").unwrap() && line.write(b"second").unwrap());
    let mut bytes = [0; 12];
    board.read_exact(&mut bytes).unwrap();
    assert_eq!(&bytes, b"\0firstsecond");
    assert_eq!(board.bytes_to_read().unwrap(), 0);
}
