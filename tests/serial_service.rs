//! `facewire run`, `check` and `monitor` with serial lines.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod board;
#[path = "common/program.rs"]
#[allow(dead_code, reason = "each test uses a part")]
mod program;
#[path = "board/service.rs"]
#[allow(dead_code, reason = "each test uses a part")]
mod service;
#[path = "common/skip.rs"]
mod skip;

use std::net::UdpSocket;
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use board::{Board, StablePath, eventually};
use facewire_packet::{PACKET_BYTES, Packet, Reason, State};
use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};
use service::{Service, configuration};
use skip::skip;

/// `facewire` with these arguments, whose output is kept.
fn facewire<'a>(arguments: impl IntoIterator<Item = &'a str>) -> Command {
    let mut command = program::facewire(arguments);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

/// The service with the built-in clip as its camera, and these links.
fn serve(links: &str) -> Service {
    Service::with(&demo_with(links))
}

fn demo_with(links: &str) -> String {
    format!("[camera]\ndevice = \"demo\"\n{links}")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn serial(device: &Path) -> String {
    format!("[[link]]\nkind = \"serial\"\ndevice = \"{}\"\n", device.display())
}

fn udp(socket: &UdpSocket) -> String {
    format!("[[link]]\naddress = \"{}\"\n", socket.local_addr().unwrap())
}

fn udp_socket() -> UdpSocket {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    socket.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    socket
}

/// Receives packets until so many of them were live. Returns how many came.
fn until_live(socket: &UdpSocket, wanted: usize) -> usize {
    let (mut received, mut live) = (0, 0);
    while live < wanted {
        let mut bytes = [0; PACKET_BYTES];
        socket.recv(&mut bytes).unwrap();
        received += 1;
        live += usize::from(Packet::decode(&bytes).unwrap().state == State::Live);
    }
    received
}

/// Counts the datagrams that arrive in this time.
fn count(socket: &UdpSocket, span: Duration) -> usize {
    let end = Instant::now() + span;
    let mut bytes = [0; PACKET_BYTES + 1];
    std::iter::repeat_with(|| socket.recv(&mut bytes).unwrap()).take_while(|_| Instant::now() < end).count()
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
    let stopping = thread::spawn(|| service.stop());
    let is_last_word = |packet: &&Packet| packet.reason == Reason::Stopping && packet.state == State::Neutral;
    eventually("the last word, three times", || {
        packets.extend(board.packets());
        packets.iter().filter(is_last_word).count() == 3
    });
    let log = stopping.join().unwrap();
    drop(port);
    let steps = packets.windows(2).map(|pair| pair[1].sequence.wrapping_sub(pair[0].sequence));
    assert!(steps.clone().all(|step| step >= 1), "packets came in another order");
    assert!(steps.filter(|step| *step == 1).count() > packets.len() / 2, "most packets were lost");
    assert!(log.contains(&format!("link opened: {} at 115200 baud", board.device.display())), "{log}");
}

#[test]
fn a_board_that_stops_reading_does_not_disturb_another_receiver() {
    let (board, socket) = (Board::plugged_in(), udp_socket());
    let _full = board.stall();
    let service = serve(&(serial(&board.device) + &udp(&socket)));
    let mut received = until_live(&socket, 50);
    let log = service.stop();
    socket.set_nonblocking(true).unwrap();
    received += std::iter::repeat_with(|| socket.recv(&mut [0; 256])).take_while(Result::is_ok).count();
    let value = |key: &str| -> usize { log.rsplit_once(key).unwrap().1.split(' ').next().unwrap().parse().unwrap() };
    assert!(value(" faces=") > 0, "{log}");
    assert_eq!(value(" packets="), value(" sent=") + value(" dropped="), "{log}");
    let packets = value(" packets=") / 2;
    assert!(packets * 10 >= value(" faces=") * 9, "poses were not sent: {log}");
    assert_eq!(received, packets, "{log}");
    assert!(value(" dropped=") + 3 >= packets, "{log}");
    assert!(log.contains("it takes no packets; check that the receiver reads"), "{log}");
}

#[test]
fn a_board_pulled_and_plugged_in_again_is_back_within_1_5_s_and_nothing_else_stops() {
    let (stable, socket) = (StablePath::new(), udp_socket());
    let mut board = Board::plugged_in();
    stable.leads_to(&board);
    let service = serve(&(serial(&stable.path()) + &udp(&socket)));
    board.next();
    for _ in 0..2 {
        stable.pull(std::mem::replace(&mut board, Board::plugged_in()));
        assert!(count(&socket, Duration::from_secs(2)) > 10, "UDP stopped with the board");
        stable.leads_to(&board);
        let back = Instant::now();
        board.next();
        assert!(back.elapsed() < Duration::from_millis(1500), "{:?}", back.elapsed());
    }
    let log = service.stop();
    assert_eq!(log.matches("link opened").count(), 3, "{log}");
    assert_eq!(log.matches("no link ").count(), 4, "lost and not found, each told once: {log}");
}

#[test]
fn without_a_board_the_service_says_so_once_and_counts_nothing_as_dropped() {
    if Path::new("/dev/serial").exists() {
        return skip("this machine has a USB serial port");
    }
    let socket = udp_socket();
    let service = serve(&(udp(&socket) + "[[link]]\nkind = \"serial\"\n"));
    eventually("the reason", || service.logged("link auto: waits for a microcontroller board; none of a known") > 0);
    // Three attempts, at least.
    (0..60).for_each(|_| assert_eq!(socket.recv(&mut [0; PACKET_BYTES]).unwrap(), PACKET_BYTES));
    let log = service.stop();
    assert_eq!(log.matches("link auto").count(), 1, "{log}");
    assert_eq!((counted(&log, " dropped="), counted(&log, " packets=")), (0, counted(&log, " sent=")), "{log}");
}

#[test]
fn a_host_that_does_not_resolve_is_an_error_where_there_is_no_other_link() {
    let folder = tempfile::tempdir().unwrap();
    let config = configuration(folder.path(), "[[link]]\naddress = \"nowhere.invalid:5252\"\n");
    let output = facewire(["run", "--config", config.to_str().unwrap()]).output().unwrap();
    assert_eq!(output.status.code(), Some(68), "{}", text(&output.stderr));
}

#[test]
fn a_host_that_does_not_resolve_does_not_disturb_the_serial_line() {
    let mut board = Board::plugged_in();
    let service = serve(&(serial(&board.device) + "[[link]]\naddress = \"nowhere.invalid:5252\"\n"));
    board.next();
    let log = service.stop();
    assert!(log.contains("no link nowhere.invalid:5252: the host does not resolve ("), "{log}");
}

#[test]
fn a_reload_moves_the_stream_to_another_board() {
    let [mut old, mut new] = [Board::plugged_in(), Board::plugged_in()];
    let service = serve(&serial(&old.device));
    old.next();
    service.reload(&demo_with(&serial(&new.device)));
    new.next();
    eventually("the end of the old stream", || old.is_closed());
    let log = service.stop();
    assert_eq!(log.matches("link opened").count(), 2, "{log}");
    assert_eq!(log.matches("camera opened").count(), 1, "the camera was not touched: {log}");
}

#[test]
fn two_names_of_one_device_at_the_start_stop_nothing_and_the_second_link_gets_its_own_device_later() {
    let (stable, socket) = (StablePath::new(), udp_socket());
    let (mut shared, mut own) = (Board::plugged_in(), Board::plugged_in());
    stable.leads_to(&shared);
    let service = serve(&(serial(&shared.device) + &serial(&stable.path()) + &udp(&socket)));
    socket.recv(&mut [0; PACKET_BYTES]).unwrap();
    shared.next();
    let told =
        format!("no link {}: it is the same device as {} at the", stable.path().display(), shared.device.display());
    eventually("the reason why the second link waits", || service.logged(&told) > 0);
    socket.recv(&mut [0; PACKET_BYTES]).unwrap();
    stable.leads_elsewhere(&own);
    own.next();
    let log = service.stop();
    assert_eq!(log.matches(&told).count(), 1, "{log}");
    assert_eq!(log.matches("link opened").count(), 2, "{log}");
}

/// Returns the number after this key in the last line of the log.
fn counted(log: &str, key: &str) -> u64 {
    log.lines().last().unwrap().rsplit_once(key).unwrap().1.split(' ').next().unwrap().parse().unwrap()
}

#[test]
fn a_reload_leaves_an_unchanged_port_open_and_reopens_a_changed_one_without_a_warning() {
    let (stable, mut board, sockets) = (StablePath::new(), Board::plugged_in(), [udp_socket(), udp_socket()]);
    stable.leads_to(&board);
    let service = serve(&(serial(&board.device) + &udp(&sockets[0])));
    board.next();
    // Another receiver and another pace; another baud rate; the same port by another name.
    let others = [
        (udp(&sockets[1]) + &serial(&board.device) + "pace = \"change\"\n", 1),
        (udp(&sockets[1]) + &serial(&board.device) + "baud = 230400\n", 2),
        (udp(&sockets[1]) + &serial(&stable.path()), 3),
    ];
    for (links, opened) in others {
        service.reload(&demo_with(&links));
        eventually("the port", || {
            board.packets();
            service.logged("link opened") == opened
        });
        sockets[1].recv(&mut [0; PACKET_BYTES]).unwrap();
        (0..10).for_each(|_| drop(board.next()));
    }
    let log = service.stop();
    assert_eq!(log.matches("link opened").count(), 3, "{log}");
    assert_eq!(log.matches("no link").count(), 0, "{log}");
    assert_eq!(counted(&log, " packets="), counted(&log, " sent=") + counted(&log, " dropped="), "{log}");
}

/// Runs `facewire check` with these links. Returns its exit status and its output.
fn check(links: &str) -> (Option<i32>, String) {
    let folder = tempfile::tempdir().unwrap();
    let config = configuration(folder.path(), &format!("[camera]\ndevice = \"demo\"\n{links}"));
    let output = facewire(["check", "--config", config.to_str().unwrap()]).output().unwrap();
    (output.status.code(), text(&output.stdout) + &text(&output.stderr))
}

#[test]
fn check_reports_for_each_link_whether_it_works_and_two_names_of_one_device() {
    let (stable, board) = (StablePath::new(), Board::plugged_in());
    stable.leads_to(&board);
    let device = board.device.display();
    let (status, told) = check(&(serial(&board.device) + &serial(&stable.path()) + &serial(Path::new("/dev/nowhere"))));
    assert_eq!(status, Some(69));
    for line in [
        format!("link      ok: {device} at 115200 baud\n"),
        format!("link      FAILED: link {}: it is the same device as {device} at the moment", stable.path().display()),
        "link      FAILED: link /dev/nowhere: there is no such serial port; plug it in, or".to_owned(),
    ] {
        assert!(told.contains(&line), "{told}");
    }
}

#[test]
fn the_monitor_reads_a_serial_port_that_it_joins_in_the_middle_of_a_frame_and_counts_damaged_frames() {
    let board = Board::plugged_in();
    let command =
        ["monitor", "--serial", board.device.to_str().unwrap(), "--seconds", "20", "--json", "--packets", "49"];
    let child = facewire(command).spawn().unwrap();
    let port = board.port();
    eventually("the monitor", || !tcgetattr(&port).unwrap().local_modes.contains(LocalModes::ICANON));
    let frame = |sequence| Packet { sequence, ..Packet::NEUTRAL }.encode_frame();
    board.send(&frame(0)[50..]);
    // These bytes damage the first whole frame.
    board.send(&[7; 3]);
    (1..=50).for_each(|sequence| board.send(&frame(sequence)));
    let output = child.wait_with_output().unwrap();
    let lines = text(&output.stdout);
    assert_eq!((output.status.code(), lines.lines().count()), (Some(0), 49), "{}", text(&output.stderr));
    assert!(lines.starts_with(r#"{"from":"/dev/pts/"#), "{lines}");
    assert!(lines.lines().last().unwrap().contains(r#""sequence":50,"lost_before":0,"#));
    assert!(text(&output.stderr).contains(" 0 lost, 1 refused"), "{}", text(&output.stderr));
}

#[test]
fn the_monitor_reports_a_silent_a_missing_and_a_disappearing_line() {
    let board = Board::plugged_in();
    let device = board.device.to_str().unwrap().to_owned();
    let device = device.as_str();
    let run = |device: &str, seconds| {
        facewire(["monitor", "--serial", device, "--seconds", seconds]).spawn().unwrap().wait_with_output().unwrap()
    };
    let silent = text(&run(device, "0.2").stderr);
    let wires = "check the wires, and that both sides have the same baud rate";
    assert_eq!(silent, format!("facewire: no packet came by {device}; {wires}\n"));
    let missing = text(&run("/dev/nowhere", "0.2").stderr);
    assert!(missing.starts_with("facewire: cannot listen to /dev/nowhere: there is no such serial port"), "{missing}");
    let port = board.port();
    let mut modes = tcgetattr(&port).unwrap();
    modes.local_modes |= LocalModes::ICANON;
    tcsetattr(&port, OptionalActions::Now, &modes).unwrap();
    let gone = thread::scope(|scope| {
        let running = scope.spawn(|| run(device, "20"));
        eventually("the monitor", || !tcgetattr(&port).unwrap().local_modes.contains(LocalModes::ICANON));
        drop((port, board));
        text(&running.join().unwrap().stderr)
    });
    assert!(gone.contains(&format!("cannot listen to {device}: went away (")), "{gone}");
}
