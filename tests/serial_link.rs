//! What a serial link promises, with a pseudo-terminal as its port and the test as its board.
#![allow(clippy::unwrap_used, clippy::panic)]

mod board;

use std::io::{Read as _, Write as _};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;
use std::time::{Duration, Instant};

use allocation_counter::{AllocationInfo, measure};
use board::{Board, StablePath, eventually};
use facewire::config::{AutoDevice, LinkKind, LinkSettings, SerialDevice, SerialSettings};
use facewire::link::{Background, Carrier as _, Link, Traffic, serial_carrier};
use facewire_packet::{Packet, State};
use rustix::fs::{FlockOperation, flock};
use rustix::termios::{ControlModes, InputModes, LocalModes, OptionalActions, OutputModes, tcgetattr, tcsetattr};

/// Returns a packet with control characters of all kinds, which a terminal would change if its port were not raw.
fn packet(sequence: u16) -> Packet {
    let mut packet = Packet { state: State::Live, sequence, age_us: 100, ..Packet::NEUTRAL };
    for (number, coefficient) in (0_u16..).zip(&mut packet.coefficients) {
        *coefficient = f32::from(number * 257 + sequence % 7) / 65535.0;
    }
    Packet::decode(&packet.encode()).unwrap()
}

/// A serial link and its counters.
struct Serial {
    carrier: Background,
    traffic: Arc<Traffic>,
}

impl Serial {
    fn at(device: &Path, baud: u32) -> Self {
        let (device, traffic) = (SerialDevice::Path(device.to_owned()), Arc::<Traffic>::default());
        Self {
            carrier: serial_carrier(&device, baud, AutoDevice::Microcontroller, (vec![0], None), Arc::clone(&traffic))
                .unwrap(),
            traffic,
        }
    }

    /// Opens the board's port and waits until it is open.
    fn open(board: &Board) -> Self {
        let link = Self::at(&board.device, 115_200);
        eventually("the port", || link.carrier.is_open());
        link
    }

    fn send(&mut self, packet: &Packet) {
        self.carrier.send(&packet.encode_frame());
    }

    fn is_open(&self) -> bool {
        self.carrier.is_open()
    }

    /// Packets sent, and packets dropped.
    fn counts(&self) -> (u64, u64) {
        (self.traffic.sent.load(Relaxed), self.traffic.dropped.load(Relaxed))
    }
}

/// Drops the link and waits until its thread has closed the port.
fn close(link: Serial) {
    let traffic = Arc::downgrade(&link.traffic);
    drop(link);
    eventually("the end of the thread", || traffic.strong_count() == 0);
}

#[test]
fn packets_arrive_as_frames_whatever_their_bytes() {
    let mut board = Board::plugged_in();
    let mut link = Serial::open(&board);
    for sequence in 0..300 {
        link.send(&packet(sequence));
        assert_eq!(board.next(), [packet(sequence)]);
    }
    eventually("the count", || link.counts() == (300, 0));
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
        let link = Serial::at(&board.device, 460_800);
        eventually("the port", || link.is_open());
        close(link);
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
    let mut link = Serial::open(&board);
    for sequence in 0..=1000 {
        link.send(&packet(sequence));
    }
    eventually("a time-out", || link.counts().1 == 1001);
    assert_eq!(link.counts().0, 0);
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
    let mut link = Serial::open(&board);
    let mut received = 0;
    for sequence in 0..3000 {
        link.send(&packet(sequence));
        received += board.packets().len() as u64;
    }
    eventually("the last count", || {
        received += board.packets().len() as u64;
        link.counts() == (received, 3000 - received)
    });
}

#[test]
fn sending_allocates_nothing_whether_the_port_takes_the_packet_or_not() {
    let board = Board::plugged_in();
    let mut links = [Serial::open(&board), Serial::at(Path::new("/dev/nowhere"), 115_200)];
    for link in &mut links {
        let packet = packet(1);
        let allocated = measure(|| (0..100).for_each(|_| link.send(&packet)));
        assert_eq!(allocated, AllocationInfo::default());
    }
}

#[test]
fn a_missing_port_is_opened_when_it_appears() {
    let stable = StablePath::new();
    let mut link = Serial::at(&stable.path(), 115_200);
    (0..10).for_each(|sequence| link.send(&packet(sequence)));
    assert_eq!((link.is_open(), link.counts()), (false, (0, 9)));
    let mut board = Board::plugged_in();
    stable.leads_to(&board);
    assert_eq!(board.next(), [packet(9)], "the newest of the packets that waited");
}

#[test]
fn a_board_plugged_in_again_under_another_node_is_back_within_1_5_s() {
    let stable = StablePath::new();
    let mut board = Board::plugged_in();
    stable.leads_to(&board);
    let mut link = Serial::at(&stable.path(), 115_200);
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
fn a_link_that_replaces_another_opens_the_port_after_the_last_packet_of_that_one() {
    let (stable, mut board) = (StablePath::new(), Board::plugged_in());
    stable.leads_to(&board);
    // Held open so that the last packet of the old link outlives it.
    let _port = board.port();
    let mut old = Serial::open(&board);
    let mut new = Serial::at(&stable.path(), 230_400);
    new.send(&packet(2));
    old.send(&packet(0));
    assert_eq!(board.next(), [packet(0)]);
    assert!(!new.is_open(), "by another name it is the same port");
    old.send(&packet(1));
    drop(old);
    let mut came = Vec::new();
    eventually("the packets of both", || {
        came.extend(board.packets());
        came.len() > 1
    });
    assert_eq!(came, [packet(1), packet(2)]);
}

#[test]
fn a_link_waits_while_its_path_leads_to_the_port_of_another_and_opens_its_own_when_that_appears() {
    let (stable, mut shared, mut own) = (StablePath::new(), Board::plugged_in(), Board::plugged_in());
    stable.leads_to(&shared);
    let mut first = Serial::at(&shared.device, 115_200);
    let mut second = Serial::at(&stable.path(), 115_200);
    first.send(&packet(1));
    second.send(&packet(2));
    assert_eq!(shared.next(), [packet(1)]);
    assert_eq!((first.is_open(), second.is_open()), (true, false));
    stable.leads_elsewhere(&own);
    assert_eq!(own.next(), [packet(2)]);
    assert_eq!(shared.packets(), []);
}

#[test]
fn a_link_ends_even_if_its_board_does_not_read() {
    // A full line, and a line with room for a part of a frame, where the system makes the thread wait.
    for room in [0, 50] {
        let board = Board::plugged_in();
        let _full = board.stall();
        (&board.master).read_exact(&mut vec![0; room]).unwrap();
        let mut link = Serial::open(&board);
        link.send(&packet(1));
        eventually("the packet is tried", || link.counts() == (0, 1));
        close(link);
    }
}

#[test]
fn output_of_the_board_is_discarded_so_that_the_board_never_waits() {
    let mut board = Board::plugged_in();
    let mut link = Serial::open(&board);
    let mut taken = 0;
    for sequence in 0..200 {
        link.send(&packet(sequence));
        assert_eq!(board.next(), [packet(sequence)]);
        taken += board.master.write(&[b'x'; 1000]).unwrap_or(0);
    }
    assert_eq!(taken, 200_000);
}

/// Returns the sentence about a port that does not open.
fn trouble(device: &Path) -> String {
    let serial = SerialSettings { device: SerialDevice::Path(device.to_owned()), ..SerialSettings::default() };
    let settings = LinkSettings { kind: LinkKind::Serial(serial), ..LinkSettings::default() };
    Link::check_all(&[settings]).remove(0).unwrap_err().to_string()
}

#[test]
fn a_port_that_does_not_open_is_reported_in_one_sentence_with_what_to_do() {
    let missing =
        "link /dev/nowhere: there is no such serial port; plug it in, or give one that `facewire devices` lists";
    assert_eq!(trouble(Path::new("/dev/nowhere")), missing);
    let file = tempfile::NamedTempFile::new().unwrap();
    for path in [file.path(), Path::new("/dev/null"), Path::new("/tmp")] {
        let text = trouble(path);
        assert!(text.ends_with("not a serial port; give one that `facewire devices` lists"), "{text}");
    }
    let board = Board::plugged_in();
    let other_program = board.port();
    flock(&other_program, FlockOperation::NonBlockingLockExclusive).unwrap();
    let busy = trouble(&board.device);
    assert!(busy.contains("another program has it open") && busy.contains("systemctl stop facewire"), "{busy}");
}
