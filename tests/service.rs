//! `facewire run` from camera to receivers, and `facewire monitor`.
//!
//! Times have wide margins: the machine may be busy.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]
#![allow(clippy::float_cmp, reason = "a neutral face is 0 exactly")]

mod common;

use std::fs;
use std::io::{BufRead as _, BufReader, PipeReader, PipeWriter, Write as _, pipe};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use common::program::{Run, facewire, settings, text};
use common::service::{Receiver, Service, counted};
use common::slew::assert_slew;
use facewire_packet::{BLENDSHAPES, Packet, Reason, State};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;

const DEMO: &str = "[camera]\ndevice = \"demo\"\n";
const NO_CAMERA: &str = "[camera]\ndevice = \"/dev/video99\"\n";
/// From the signal to the end of the process.
const LONGEST_STOP: Duration = Duration::from_secs(3);

/// Checks that no packet was lost and none came twice, from the very first.
fn assert_numbered(packets: &[Packet]) {
    assert!(packets.iter().map(|packet| usize::from(packet.sequence)).eq(0..packets.len()));
}

/// Checks that the face went to neutral without a step, that the last word was three neutral faces, and how the process
/// ended.
fn assert_stopped(packets: &[Packet], (run, took): (Run, Duration)) -> String {
    assert!(took < LONGEST_STOP, "{took:?}");
    packets.windows(2).for_each(|pair| assert_slew(&pair[0], &pair[1]));
    let is_last_word = |packet: &&Packet| packet.reason == Reason::Stopping && packet.state == State::Neutral;
    assert_eq!(packets.iter().filter(is_last_word).count(), 3);
    for packet in &packets[packets.len() - 3..] {
        assert_eq!((packet.state, packet.reason), (State::Neutral, Reason::Stopping));
        assert_eq!((packet.rotation, packet.coefficients), ([0.0, 0.0, 0.0, 1.0], [0.0; BLENDSHAPES.len()]));
    }
    run.succeeded().err
}

/// Checks that every frame and every packet is in one of the counts of the last line.
fn assert_adds_up(log: &str) {
    let count = |key| counted(log, key);
    assert!(count("faces") > 0 && count("frames") >= count("faces"), "{log}");
    assert_eq!(count("frames"), count("faces") + count("no_face") + count("rejected"), "{log}");
    assert_eq!(count("packets"), count("sent") + count("dropped"), "{log}");
}

#[test]
fn every_receiver_sees_the_face_go_live_and_stop_neutral() {
    let [first, second] = [Receiver::new(), Receiver::new()];
    let service = Service::start(DEMO, &[first.address(), format!("localhost:{}", second.port())]);
    let mut packets = first.until(|packet| packet.state == State::Live);
    assert!(packets.split_last().unwrap().1.iter().all(|packet| packet.state == State::Neutral));
    packets.extend((0..40).map(|_| first.packet()));
    let ended = service.stop(Signal::TERM);
    packets.extend(first.rest());

    assert_numbered(&packets);
    assert_eq!(packets, second.rest(), "to the second receiver go the same packets");
    let log = assert_stopped(&packets, ended);
    assert!(log.contains("camera opened: demo: MJPEG 640x480 at 30 fps"), "{log}");
    assert_adds_up(&log);
}

#[test]
fn live_packets_follow_the_face() {
    let receiver = Receiver::new();
    let _service = Service::start(DEMO, &[receiver.address()]);
    let mut packets: Vec<Packet> = Vec::new();
    let changes = |packets: &[Packet], differ: fn(&Packet, &Packet) -> bool| {
        packets.windows(2).filter(|pair| differ(&pair[0], &pair[1])).count()
    };
    while changes(&packets, |a, b| a.capture_us != b.capture_us) < 20 {
        packets.extend(receiver.until(|packet| packet.state == State::Live).pop());
    }
    let moves = changes(&packets, |a, b| a.coefficients != b.coefficients);
    assert!(moves > 10, "{moves} moves in {} packets", packets.len());
    for packet in &packets {
        assert_eq!(packet.reason, Reason::None);
        assert!(packet.age_us < 1_000_000, "{packet:?}");
        assert!(packet.coefficients.iter().any(|value| *value > 0.02), "{packet:?}");
        let [x, y, z, w] = packet.rotation;
        assert!((x * x + y * y + z * z + w * w - 1.0).abs() < 1e-3, "{packet:?}");
        assert!(packet.position_mm[2] > 100.0, "in front of the camera: {packet:?}");
    }
}

#[test]
fn without_a_camera_the_face_is_neutral_10_times_a_second_and_the_log_says_why() {
    let receiver = Receiver::new();
    let service = Service::start(NO_CAMERA, &[receiver.address()]);
    let mut packets = vec![receiver.packet()];
    let begun = Instant::now();
    packets.extend((0..20).map(|_| receiver.packet()));
    let took_s = begun.elapsed().as_secs_f64();
    assert!((1.5..4.0).contains(&took_s), "20 packets in {took_s} s");
    for packet in &packets {
        assert_eq!((packet.state, packet.reason), (State::Neutral, Reason::NoCamera));
        assert_eq!(packet.coefficients, [0.0; BLENDSHAPES.len()]);
    }
    let ended = service.stop(Signal::TERM);
    packets.extend(receiver.rest());
    assert_numbered(&packets);
    let log = assert_stopped(&packets, ended);
    assert_eq!(log.matches("no camera: no camera is called /dev/video99").count(), 1, "told once: {log}");
}

#[test]
fn a_model_file_that_is_not_mounted_yet_is_waited_for_with_a_neutral_face() {
    let (receiver, disk) = (Receiver::new(), tempfile::tempdir().unwrap());
    let model = disk.path().join("mounted/blendshapes.toml");
    let service = Service::start(&format!("{DEMO}[solver]\nmodel = \"{}\"\n", text(&model)), &[receiver.address()]);
    for packet in receiver.until(|packet| packet.reason == Reason::BadResult) {
        assert_eq!((packet.state, packet.coefficients), (State::Neutral, [0.0; BLENDSHAPES.len()]));
    }
    for _ in 0..30 {
        assert_eq!(receiver.packet().state, State::Neutral);
    }
    fs::create_dir(model.parent().unwrap()).unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/blendshapes.toml");
    let whole = fs::read(shipped).unwrap();
    // A copy in progress. Within 2 s, which are 20 packets, the service tries to read it.
    fs::write(&model, &whole[..whole.len() / 2]).unwrap();
    for _ in 0..20 {
        assert_eq!(receiver.packet().state, State::Neutral);
    }
    fs::write(model.with_extension("part"), &whole).unwrap();
    fs::rename(model.with_extension("part"), &model).unwrap();
    receiver.until(|packet| packet.state == State::Live);
    let log = service.stop(Signal::TERM).0.succeeded().err;
    assert_eq!(log.matches("blendshapes.toml cannot be read (No such file or directory").count(), 1, "{log}");
    assert_eq!(log.matches("no model: ").count(), 2, "once for each reason: {log}");
}

/// Starts the service in a network namespace whose only interface is down. Returns `None` if none can be made.
fn cut_off(settings: &Path) -> Option<Child> {
    let unshare = ["--user", "--map-root-user", "--net"];
    let works = Command::new("unshare").args(unshare).arg("true").output().is_ok_and(|run| run.status.success());
    let mut command = Command::new("unshare");
    command.args(unshare).arg(env!("CARGO_BIN_EXE_facewire")).args(["run", "--config", text(settings)]);
    works.then(|| command.stderr(Stdio::piped()).spawn().unwrap())
}

#[test]
fn a_network_that_takes_no_packets_is_told_once() {
    let settings = settings(&[NO_CAMERA, "[[link]]\naddress = \"192.0.2.1:5252\"\n"].concat());
    let Some(mut service) = cut_off(settings.path()) else {
        return common::skip("unshare cannot make a network namespace here");
    };
    let mut log = BufReader::new(service.stderr.take().unwrap()).lines().map(Result::unwrap);
    let refusal = "link 192.0.2.1:5252: the network takes no packets (Network is unreachable";
    let status = log.by_ref().take_while(|line| !line.contains(refusal)).last().unwrap();
    assert!(status.contains(" links_open=0 "), "{status}");
    let pid = Pid::from_child(&service);
    kill_process(pid, Signal::USR1).unwrap();
    log.by_ref().find(|line| line.contains(" links_open=0 ")).unwrap();
    kill_process(pid, Signal::TERM).unwrap();
    assert_eq!(log.filter(|line| line.contains(refusal)).count(), 0);
    assert!(service.wait().unwrap().success());
}

/// The age of the last pose that tells that the camera hangs, even on a busy machine, microseconds.
const HUNG_US: u32 = 3_000_000;

/// Starts a service whose camera hangs in the kernel, and returns it with the packets so far.
fn hung(receiver: &Receiver) -> (Service, Vec<Packet>) {
    let service = Service::start("[camera]\ndevice = \"rehearsal: live 2, hung 60\"\n", &[receiver.address()]);
    let mut packets = receiver.until(|packet| packet.state == State::Live);
    packets.extend(receiver.until(|packet| packet.age_us > HUNG_US));
    (service, packets)
}

#[test]
fn a_hung_camera_does_not_keep_the_service_from_stopping() {
    let receiver = Receiver::new();
    let (service, mut packets) = hung(&receiver);
    let (run, took) = service.stop(Signal::TERM);
    packets.extend(receiver.rest());
    let log = assert_stopped(&packets, (run, took));
    assert!(log.contains("is left behind"), "{log}");
}

#[test]
fn a_second_signal_ends_the_service_at_once() {
    let receiver = Receiver::new();
    let (service, _) = hung(&receiver);
    service.signal(Signal::TERM);
    receiver.until(|packet| packet.reason == Reason::Stopping);
    let (run, took) = service.stop(Signal::INT);
    assert_eq!(run.status, Some(130), "{}", run.err);
    assert!(took < Duration::from_secs(1), "{took:?}");
    assert!(!run.err.contains("is left behind"), "the first signal was obeyed: {}", run.err);
}

#[test]
fn a_log_whose_reader_has_gone_ends_no_service() {
    let receiver = Receiver::new();
    let service = Service::start_logging_to(DEMO, &[receiver.address()], pipe().unwrap().1.into());
    let mut packets = receiver.until(|packet| packet.state == State::Live);
    let ended = service.stop(Signal::INT);
    packets.extend(receiver.rest());
    assert_stopped(&packets, ended);
}

/// Returns a full pipe.
fn full() -> (PipeReader, PipeWriter) {
    let (reader, mut writer) = pipe().unwrap();
    let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
    while poll(&mut [PollFd::new(&writer, PollFlags::OUT)], Some(&at_once)).unwrap() > 0 {
        writer.write_all(&[b'.'; 4096]).unwrap();
    }
    (reader, writer)
}

#[test]
fn a_log_that_nobody_reads_holds_up_nothing() {
    let (receiver, (_reader, log)) = (Receiver::new(), full());
    let service = Service::start_logging_to(DEMO, &[receiver.address()], log.into());
    let mut packets = receiver.until(|packet| packet.state == State::Live);
    service.signal(Signal::USR1);
    packets.extend((0..10).map(|_| receiver.packet()));
    let ended = service.stop(Signal::TERM);
    packets.extend(receiver.rest());
    assert_stopped(&packets, ended);
}

#[test]
fn the_monitor_writes_each_packet_as_a_line_of_json() {
    let port = Receiver::new().port();
    let address = format!("127.0.0.1:{port}");
    let _service = Service::start(DEMO, std::slice::from_ref(&address));
    let mut monitor = facewire(["monitor", "--json", "--packets", "5", "--seconds", "20", "--listen", &address]);
    let run = Run::of(&mut monitor).succeeded();
    assert!(run.err.starts_with("5 packets in "), "{}", run.err);
    let lines: Vec<Value> = run.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 5);
    for (line, before) in lines.iter().zip(lines[0]["sequence"].as_u64().unwrap()..) {
        assert_eq!(line["sequence"], before);
        assert!(["live", "hold", "decay", "neutral"].contains(&line["state"].as_str().unwrap()), "{line}");
        let names = line["coefficients"].as_object().unwrap();
        assert!(names.len() == BLENDSHAPES.len() && BLENDSHAPES.iter().all(|name| names.contains_key(*name)), "{line}");
    }
}

#[test]
fn the_monitor_of_a_silent_or_taken_port_fails_with_what_to_check() {
    let receiver = Receiver::new();
    let run = Run::of(&mut facewire(["monitor", "--listen", &receiver.address()]));
    assert!(run.sentence(1).contains("give --listen another address"), "{}", run.err);
    let run = Run::of(&mut facewire(["monitor", "--listen", "127.0.0.1:0", "--seconds", "0.2"]));
    assert!(run.sentence(1).contains("no packet came to "), "{}", run.err);
}
