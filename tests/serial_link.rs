//! What a serial link promises, with a pseudo-terminal for the port and the test for the board.
#![allow(clippy::unwrap_used, clippy::panic)]

mod board;

use std::io::{Read as _, Write as _};
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use allocation_counter::{AllocationInfo, measure};
use board::{Board, StablePath, eventually};
use facewire::config::{LinkKind, LinkSettings};
use facewire::link::{Link, LinkCounts, SerialLink};
use facewire_packet::{Packet, State};
use rustix::termios::{ControlModes, InputModes, LocalModes, OptionalActions, OutputModes, tcgetattr, tcsetattr};

/// Packets without a byte that a terminal would leave alone: control characters of all kinds.
fn packet(sequence: u16) -> Packet {
    let mut packet = Packet { state: State::Live, sequence, age_us: 100, ..Packet::NEUTRAL };
    for (number, coefficient) in (0_u16..).zip(&mut packet.coefficients) {
        *coefficient = f32::from(number * 257 + sequence % 7) / 65535.0;
    }
    Packet::decode(&packet.encode()).unwrap()
}

fn open(board: &Board) -> SerialLink {
    let link = SerialLink::open(&board.device, 115_200).unwrap();
    eventually("the port", || link.is_open());
    link
}

#[test]
fn packets_arrive_as_frames_whatever_their_bytes() {
    let mut board = Board::plugged_in();
    let mut link = open(&board);
    for sequence in 0..300 {
        link.send(&packet(sequence));
        assert_eq!(board.next(), [packet(sequence)]);
    }
    eventually("the count", || link.counts() == LinkCounts { sent: 300, dropped: 0 });
}

#[test]
fn the_port_is_raw_8n1_without_flow_control_at_its_baud_rate_and_keeps_dtr() {
    let board = Board::plugged_in();
    let port = board.port();
    for _ in 0..2 {
        let mut modes = tcgetattr(&port).unwrap();
        modes.control_modes |= ControlModes::HUPCL | ControlModes::CSTOPB | ControlModes::CRTSCTS;
        modes.input_modes |= InputModes::IXON | InputModes::ICRNL;
        tcsetattr(&port, OptionalActions::Now, &modes).unwrap();
        drop(SerialLink::open(&board.device, 460_800).map(|link| eventually("the port", || link.is_open())));
        let modes = tcgetattr(&port).unwrap();
        assert_eq!((modes.input_speed(), modes.output_speed()), (460_800, 460_800));
        let control = modes.control_modes;
        assert_eq!(control & ControlModes::CSIZE, ControlModes::CS8);
        assert!(control.contains(ControlModes::CREAD | ControlModes::CLOCAL));
        let not = ControlModes::HUPCL | ControlModes::PARENB | ControlModes::CSTOPB | ControlModes::CRTSCTS;
        assert!(!control.intersects(not), "{control:?}");
        assert!(!modes.input_modes.intersects(InputModes::IXON | InputModes::IXOFF | InputModes::ICRNL));
        assert!(!modes.output_modes.contains(OutputModes::OPOST));
        assert!(!modes.local_modes.intersects(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG));
    }
}

#[test]
fn a_board_that_stops_reading_gets_the_newest_packet_when_it_reads_again() {
    let mut board = Board::plugged_in();
    let _full = board.stall();
    let mut link = open(&board);
    for sequence in 0..=1000 {
        link.send(&packet(sequence));
    }
    eventually("a time-out", || link.counts().dropped == 1001);
    assert_eq!(link.counts().sent, 0);
    link.send(&packet(7));
    let mut newest = Vec::new();
    eventually("the newest packet", || {
        newest.extend(board.packets());
        link.send(&packet(8));
        newest.contains(&packet(8))
    });
    assert!(newest.iter().all(|packet| packet.sequence < 1000), "a packet was queued");
}

#[test]
fn every_packet_is_counted_once() {
    let mut board = Board::plugged_in();
    let mut link = open(&board);
    let mut received = 0;
    for sequence in 0..3000 {
        link.send(&packet(sequence));
        received += board.packets().len() as u64;
    }
    eventually("the last count", || {
        received += board.packets().len() as u64;
        link.counts().sent + link.counts().dropped == 3000 && link.counts().sent == received
    });
}

#[test]
fn handing_a_packet_over_allocates_nothing_whether_the_port_takes_it_or_not() {
    let board = Board::plugged_in();
    let mut links = [open(&board), SerialLink::open(Path::new("/dev/nowhere"), 115_200).unwrap()];
    for link in &mut links {
        let packet = packet(1);
        let allocated = measure(|| (0..100).for_each(|_| link.send(&packet)));
        assert_eq!(allocated, AllocationInfo::default());
    }
}

#[test]
fn a_port_that_is_not_there_yet_is_opened_when_it_comes() {
    let stable = StablePath::new();
    let mut link = SerialLink::open(&stable.path(), 115_200).unwrap();
    (0..10).for_each(|sequence| link.send(&packet(sequence)));
    assert_eq!((link.is_open(), link.counts()), (false, LinkCounts { sent: 0, dropped: 9 }));
    let mut board = Board::plugged_in();
    stable.leads_to(&board);
    assert_eq!(board.next(), [packet(9)], "of those that waited, the newest");
}

#[test]
fn a_board_plugged_in_again_under_another_node_is_back_within_1_5_s() {
    let stable = StablePath::new();
    let mut board = Board::plugged_in();
    stable.leads_to(&board);
    let mut link = SerialLink::open(&stable.path(), 115_200).unwrap();
    for round in 0..3 {
        link.send(&packet(round));
        assert_eq!(board.next(), [packet(round)]);
        stable.pull(std::mem::replace(&mut board, Board::plugged_in()));
        eventually("the loss", || {
            link.send(&packet(99));
            !link.is_open()
        });
        // Long enough for the longest wait between attempts.
        thread::sleep(Duration::from_millis(500 * u64::from(round)));
        link.send(&packet(100));
        stable.leads_to(&board);
        let back = Instant::now();
        assert_eq!(board.next(), [packet(100)]);
        assert!(back.elapsed() < Duration::from_millis(1500), "{:?}", back.elapsed());
    }
}

#[test]
fn what_was_sent_last_is_written_before_the_link_is_gone() {
    for sequence in 0..50 {
        let mut board = Board::plugged_in();
        let port = board.port();
        let mut link = open(&board);
        link.send(&packet(sequence));
        drop(link);
        assert_eq!(board.next(), [packet(sequence)]);
        drop(port);
    }
}

#[test]
fn a_link_at_the_port_of_another_opens_it_as_soon_as_that_one_is_closed() {
    let (stable, mut board) = (StablePath::new(), Board::plugged_in());
    stable.leads_to(&board);
    // Held open so that what the old link wrote last outlives it.
    let _port = board.port();
    let mut old = open(&board);
    let mut new = SerialLink::open(&stable.path(), 230_400).unwrap();
    new.send(&packet(2));
    thread::sleep(Duration::from_millis(300));
    assert!(!new.is_open(), "by another name it is the same port");
    old.send(&packet(1));
    old.stop();
    let (stopped, mut came) = (Instant::now(), Vec::new());
    eventually("the packets of both", || {
        came.extend(board.packets());
        came.len() > 1
    });
    assert_eq!(came, [packet(1), packet(2)]);
    assert!(stopped.elapsed() < Duration::from_millis(500), "{:?}", stopped.elapsed());
}

#[test]
fn a_link_ends_though_its_board_does_not_read() {
    // Full, and full but for a part of a frame, which is where the system makes the thread wait.
    for room in [0, 50] {
        let board = Board::plugged_in();
        let _full = board.stall();
        (&board.master).read_exact(&mut vec![0; room]).unwrap();
        let mut link = open(&board);
        link.send(&packet(1));
        thread::sleep(Duration::from_millis(20));
        let begin = Instant::now();
        drop(link);
        assert!(begin.elapsed() < Duration::from_secs(5));
    }
}

#[test]
fn what_the_board_says_is_thrown_away_so_that_it_never_waits() {
    let mut board = Board::plugged_in();
    let mut link = open(&board);
    let mut taken = 0;
    for sequence in 0..200 {
        link.send(&packet(sequence));
        assert_eq!(board.next(), [packet(sequence)]);
        taken += board.master.write(&[b'x'; 1000]).unwrap_or(0);
    }
    assert_eq!(taken, 200_000);
}

/// The sentence for a port that does not open.
fn trouble(device: &Path) -> String {
    let settings = LinkSettings { kind: LinkKind::Serial, device: device.to_owned(), ..LinkSettings::default() };
    Link::check(&settings).unwrap_err().to_string()
}

#[test]
fn a_port_that_does_not_open_is_told_in_one_sentence_with_what_to_do() {
    let missing =
        "link /dev/nowhere: there is no such serial port; plug it in, or give one that `facewire devices` lists";
    assert_eq!(trouble(Path::new("/dev/nowhere")), missing);
    let file = tempfile::NamedTempFile::new().unwrap();
    for path in [file.path(), Path::new("/dev/null"), Path::new("/tmp")] {
        let text = trouble(path);
        assert!(text.ends_with("not a serial port; give one that `facewire devices` lists"), "{text}");
    }
    let board = Board::plugged_in();
    let link = open(&board);
    let busy = "another program has it open; end that program, or give another port";
    assert_eq!(trouble(&board.device), format!("link {}: {busy}", board.device.display()));
    drop(link);
}
