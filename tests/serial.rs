//! What a serial link promises, and `facewire run`, `check` and `monitor` with serial lines. The test is the board, at the
//! other end of a pseudo-terminal.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::io::Write as _;
use std::path::Path;
use std::process::Stdio;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;

use allocation_counter::measure;
use common::board::{Board, StablePath};
use common::program::{Run, facewire, settings, text};
use common::service::{DEMO, Receiver, Service, counted};
use common::{eventually, skip};
use facewire::config::{LinkKind, LinkSettings, SerialDevice, SerialSettings};
use facewire::link::{Background, Link, Panel, serial_carrier};
use facewire_packet::{Packet, Reason, State};
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

struct Serial {
    carrier: Background,
    panel: Arc<Panel>,
}

impl Serial {
    fn open(board: &Board, baud: u32) -> Self {
        let device = SerialDevice::Path(board.device.clone());
        let kind = LinkKind::Serial(SerialSettings { device, baud });
        let panel = Arc::<Panel>::default();
        let carrier = serial_carrier(&kind, Arc::clone(&panel)).unwrap().unwrap();
        eventually("the port", || carrier.is_open());
        Self { carrier, panel }
    }

    fn assert_counts(&self, sent: u64, dropped: u64) {
        let counts = || [&self.panel.sent, &self.panel.dropped].map(|count| count.load(Relaxed));
        eventually("the counts", || counts() == [sent, dropped]);
    }

    /// Drops the link and waits until its thread has closed the port.
    fn close(self) {
        let panel = Arc::downgrade(&self.panel);
        drop(self);
        eventually("the end of the thread", || panel.strong_count() == 0);
    }
}

/// The board may send as well: what it sends is discarded, so that it never waits.
#[test]
fn packets_arrive_as_frames_whatever_their_bytes_and_sending_allocates_nothing() {
    let mut board = Board::plugged_in();
    let mut link = Serial::open(&board, 115_200);
    for sequence in 0..200 {
        let frame = packet(sequence).encode_frame();
        assert_eq!(measure(|| link.carrier.send(&frame)).count_total, 0);
        assert_eq!(board.next(), [packet(sequence)]);
        assert_eq!(board.master.write(&[b'x'; 1000]).unwrap(), 1000);
    }
    link.assert_counts(200, 0);
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
        Serial::open(&board, 460_800).close();
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
fn a_port_that_does_not_open_and_a_second_name_of_one_are_reported_in_one_sentence_with_what_to_do() {
    let stable = StablePath::new();
    let board = Board::plugged_in();
    let busy = Board::plugged_in();
    stable.leads_to(&board);
    let other_program = busy.port();
    flock(&other_program, FlockOperation::NonBlockingLockExclusive).unwrap();
    let file = tempfile::NamedTempFile::new().unwrap();
    let stable = stable.path();
    let cases = [
        (&*board.device, "ok"),
        (&*stable, "it is the same device as"),
        (
            Path::new("/dev/nowhere"),
            "there is no such serial port; plug it in, or give one that `facewire devices` lists",
        ),
        (file.path(), "not a serial port; give one that `facewire devices` lists"),
        (Path::new("/dev/null"), "not a serial port; give one that `facewire devices` lists"),
        (&*busy.device, "another program has it open"),
    ];
    let links = cases.map(|(path, _)| {
        let serial = SerialSettings { device: SerialDevice::Path(path.to_owned()), ..SerialSettings::default() };
        LinkSettings { kind: LinkKind::Serial(serial), ..LinkSettings::default() }
    });
    for ((path, want), checked) in cases.iter().zip(Link::check_all(&links)) {
        let told = checked.map_or_else(|error| error.to_string(), |_| "ok".to_owned());
        assert!(told.contains(want), "{}: {told}", path.display());
    }
}

fn serial(device: &Path) -> String {
    format!("[[link]]\nkind = \"serial\"\ndevice = \"{}\"\n", device.display())
}

fn udp(receiver: &Receiver) -> String {
    format!("[[link]]\naddress = \"{}\"\n", receiver.address())
}

fn demo(links: &str) -> String {
    [DEMO, links].concat()
}

fn serve(links: &str) -> Service {
    Service::start(&demo(links), &[])
}

#[test]
fn a_board_reads_the_packets_of_the_built_in_clip_up_to_the_last_neutral_one() {
    let mut board = Board::plugged_in();
    let service = serve(&serial(&board.device));
    let mut packets = Vec::new();
    eventually("a face", || {
        packets.extend(board.packets());
        packets.len() > 30 && packets.iter().any(|packet| packet.coefficients.iter().any(|value| *value > 0.2))
    });
    // Held open so that the last packets outlive the service.
    let port = board.port();
    let stopping = thread::spawn(|| service.stopped());
    let is_last_word = |packet: &Packet| packet.reason == Reason::Stopping && packet.state == State::Neutral;
    eventually("the last word", || {
        packets.extend(board.packets());
        packets.last().is_some_and(is_last_word)
    });
    let log = stopping.join().unwrap();
    packets.extend(board.packets());
    drop(port);
    assert!(packets.is_sorted_by_key(|packet| packet.sequence), "packets came in another order");
    assert_eq!(packets.len() as u64, counted(&log, "sent"), "{log}");
    assert!(log.contains(&format!("link opened: {} at 115200 baud", board.device.display())), "{log}");
}

#[test]
fn a_board_that_stops_reading_does_not_disturb_another_receiver() {
    let board = Board::plugged_in();
    let receiver = Receiver::new();
    let _full = board.stall();
    let service = serve(&(serial(&board.device) + &udp(&receiver)));
    let mut received: usize = (0..50).map(|_| receiver.live().len()).sum();
    eventually("a word about the board", || {
        received += receiver.rest().len();
        service.logged("it takes no packets; check that the receiver reads") > 0
    });
    let log = service.stopped();
    let received = (received + receiver.rest().len()) as u64;
    let [packets, sent, dropped] = ["packets", "sent", "dropped"].map(|key| counted(&log, key));
    assert_eq!(packets, sent + dropped, "{log}");
    assert!(received == packets / 2 && dropped + 3 >= packets / 2, "{received} received: {log}");
}

#[test]
fn a_board_pulled_and_plugged_in_again_is_back_and_nothing_else_stops() {
    let stable = StablePath::new();
    let receiver = Receiver::new();
    let mut board = Board::plugged_in();
    stable.leads_to(&board);
    let service = serve(&(serial(&stable.path()) + &udp(&receiver)));
    for told in [2, 4] {
        // What is lost within a second is a fault that repeats itself.
        let mut seen_us = || board.next().last().map_or(0, |packet| packet.capture_us);
        let first_us = seen_us();
        while seen_us().wrapping_sub(first_us) < 1_200_000 {}
        stable.pull(std::mem::replace(&mut board, Board::plugged_in()));
        eventually("that it is lost, and not found", || {
            receiver.packet();
            service.logged("no link ") == told
        });
        stable.leads_to(&board);
    }
    board.next();
    let log = service.stopped();
    assert_eq!(log.matches("link opened").count(), 3, "{log}");
    assert_eq!(log.matches("no link ").count(), 4, "each told once: {log}");
}

#[test]
fn without_a_board_the_service_says_so_once_and_counts_nothing_as_dropped() {
    if Path::new("/dev/serial").exists() {
        return skip("this machine has a USB serial port");
    }
    let receiver = Receiver::new();
    let service = serve(&(udp(&receiver) + "[[link]]\nkind = \"serial\"\n"));
    service.await_log("link auto: waits for a microcontroller board; none of a known");
    // Three attempts, at least.
    (0..60).for_each(|_| _ = receiver.packet());
    let log = service.stopped();
    assert_eq!(log.matches("link auto").count(), 1, "{log}");
    assert_eq!((counted(&log, "dropped"), counted(&log, "packets")), (0, counted(&log, "sent")), "{log}");
}

#[test]
fn a_host_that_does_not_resolve_is_an_error_of_check_and_run_waits_for_it_also_as_the_only_link() {
    let toml = "[[link]]\naddress = \"nowhere.invalid:5252\"\n";
    let file = settings(&demo(toml));
    let check = Run::of(&mut facewire(["check", "--config", text(file.path())]));
    assert!(check.sentence(68).starts_with("link nowhere.invalid:5252: the host does not resolve"), "{}", check.err);
    let service = serve(toml);
    service.await_log("no link nowhere.invalid:5252: the host does not resolve (");
    // It looks the name up every second at least, and says so once.
    eventually("dropped packets", || counted(&service.status(), "dropped") > 60);
    let log = service.stopped();
    assert_eq!(log.matches("does not resolve").count(), 1, "{log}");
}

#[test]
fn a_host_that_does_not_resolve_does_not_disturb_the_serial_line() {
    let mut board = Board::plugged_in();
    let service = serve(&(serial(&board.device) + "[[link]]\naddress = \"nowhere.invalid:5252\"\n"));
    board.next();
    // The name is looked up meanwhile, which may take longer.
    service.await_log("no link nowhere.invalid:5252: the host does not resolve (");
    board.next();
}

#[test]
fn two_names_of_one_device_at_the_start_stop_nothing_and_the_second_link_gets_its_own_device_later() {
    let stable = StablePath::new();
    let receiver = Receiver::new();
    let mut shared = Board::plugged_in();
    let mut own = Board::plugged_in();
    stable.leads_to(&shared);
    let service = serve(&(serial(&shared.device) + &serial(&stable.path()) + &udp(&receiver)));
    receiver.packet();
    shared.next();
    let told =
        format!("no link {}: it is the same device as {} at the", stable.path().display(), shared.device.display());
    service.await_log(&told);
    receiver.packet();
    stable.leads_elsewhere(&own);
    own.next();
    let log = service.stopped();
    assert_eq!((log.matches(&told).count(), log.matches("link opened").count()), (1, 2), "{log}");
}

#[test]
fn a_reload_leaves_an_unchanged_port_open_and_reopens_a_changed_one_without_a_warning() {
    let stable = StablePath::new();
    let receivers = [Receiver::new(), Receiver::new()];
    let [mut board, mut other] = [Board::plugged_in(), Board::plugged_in()];
    stable.leads_to(&board);
    let service = serve(&(serial(&board.device) + &udp(&receivers[0])));
    board.next();
    // These change the receiver and the pace, then the baud rate, then the name of the same port.
    for (link, opened) in [
        (serial(&board.device) + "pace = \"change\"\n", 1),
        (serial(&board.device) + "baud = 230400\n", 2),
        (serial(&stable.path()), 3),
    ] {
        service.change(&demo(&(udp(&receivers[1]) + &link)));
        eventually("the port", || {
            board.packets();
            service.logged("link opened") == opened
        });
        receivers[1].packet();
        (0..10).for_each(|_| drop(board.next()));
    }
    service.change(&demo(&serial(&other.device)));
    other.next();
    eventually("the end of the former stream", || board.is_closed());
    let log = service.stopped();
    let told = ["link opened", "camera opened", "no link"].map(|text| log.matches(text).count());
    assert_eq!(told, [4, 1, 0], "{log}");
    assert_eq!(counted(&log, "packets"), counted(&log, "sent") + counted(&log, "dropped"), "{log}");
}

/// Starts `facewire monitor` at a serial port and lets `play` act as the board once it listens.
fn monitor(device: &Path, arguments: &[&str], play: impl FnOnce()) -> Run {
    let mut command = facewire(["monitor", "--serial", text(device)].iter().chain(arguments));
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    play();
    Run::ended(&child.wait_with_output().unwrap())
}

/// Waits until a monitor has opened the port. It sets the baud rate last; until then, it discards whatever arrives.
fn await_monitor(port: &impl std::os::fd::AsFd) {
    eventually("the monitor", || tcgetattr(port).unwrap().output_speed() == 115_200);
}

#[test]
fn the_monitor_reads_a_serial_port_that_it_joins_in_the_middle_of_a_frame_and_counts_damaged_frames() {
    let board = Board::plugged_in();
    let port = board.port();
    let run = monitor(&board.device, &["--seconds", "60", "--json", "--packets", "49"], || {
        await_monitor(&port);
        board.send(&packet(0).encode_frame()[50..]);
        // These bytes damage the first whole frame.
        board.send(&[7; 3]);
        (1..=50).for_each(|sequence| board.send(&packet(sequence).encode_frame()));
    });
    let run = run.succeeded();
    assert_eq!(run.out.lines().count(), 49, "{}", run.out);
    assert!(run.out.starts_with(r#"{"from":"/dev/pts/"#), "{}", run.out);
    assert!(run.out.lines().last().unwrap().contains(r#""sequence":50,"lost_before":0,"#));
    assert!(run.err.contains(" 0 lost, 1 refused"), "{}", run.err);
}

#[test]
fn the_monitor_reports_a_silent_a_missing_and_a_disappearing_line() {
    let board = Board::plugged_in();
    let device = board.device.clone();
    let silent = monitor(&device, &["--seconds", "0.2"], || {});
    let wires = "check the wires, and that both sides have the same baud rate";
    assert_eq!(silent.sentence(1), format!("no packet came by {}; {wires}", device.display()));
    let missing = monitor(Path::new("/dev/nowhere"), &["--seconds", "0.2"], || {});
    assert!(missing.sentence(69).starts_with("cannot listen to /dev/nowhere: there is no such serial port"));
    let port = board.port();
    let mut modes = tcgetattr(&port).unwrap();
    modes.set_speed(9_600).unwrap();
    tcsetattr(&port, OptionalActions::Now, &modes).unwrap();
    let gone = monitor(&device, &["--seconds", "60"], || {
        await_monitor(&port);
        drop((port, board));
    });
    assert!(gone.sentence(69).starts_with(&format!("cannot listen to {}: went away (", device.display())));
}
