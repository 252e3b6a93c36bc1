//! `facewire run` from camera to receivers, and `facewire monitor`.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]
#![allow(clippy::float_cmp, reason = "a neutral face is 0 exactly")]

mod common;

use std::fs;
use std::io::{PipeReader, PipeWriter, Write as _, pipe};
use std::net::UdpSocket;
use std::process::{Command, Stdio};

use common::ports::udp_port_of;
use common::program::{Run, facewire, text};
use common::service::{DEMO, NO_CAMERA, Receiver, Service, counted};
use common::slew::assert_slew;
use common::stuck::Stuck;
use common::{PATIENCE, eventually, project, skip};
use facewire_packet::{BLENDSHAPES, Packet, Reason, State};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::Signal;
use serde_json::Value;

/// Checks that no packet was lost and none came twice, from the very first.
fn assert_numbered(packets: &[Packet]) {
    assert!(packets.iter().map(|packet| usize::from(packet.sequence)).eq(0..packets.len()));
}

/// Checks that the face went to neutral without a step, that the last word was three neutral faces, and how the process
/// ended.
fn assert_stopped(packets: &[Packet], run: Run) -> String {
    packets.windows(2).for_each(|pair| assert_slew(&pair[0], &pair[1]));
    let is_last_word = |packet: &&Packet| packet.reason == Reason::Stopping && packet.state == State::Neutral;
    assert_eq!(packets.iter().filter(is_last_word).count(), 3);
    for packet in &packets[packets.len() - 3..] {
        assert_eq!((packet.state, packet.reason), (State::Neutral, Reason::Stopping));
        assert_eq!((packet.rotation, packet.coefficients), ([0.0, 0.0, 0.0, 1.0], [0.0; BLENDSHAPES.len()]));
    }
    run.succeeded().err
}

#[test]
fn every_receiver_sees_the_face_go_live_and_stop_neutral() {
    let [first, second] = [Receiver::new(), Receiver::new()];
    let service = Service::start(DEMO, &[first.address(), format!("localhost:{}", second.port())]);
    let mut of_second = Vec::new();
    // A socket that nobody reads for seconds loses packets.
    let mut next = || {
        of_second.extend(second.rest());
        first.packet()
    };
    let mut packets = vec![next()];
    eventually("a face", || {
        let is_live = packets.last().is_some_and(|packet| packet.state == State::Live);
        packets.extend((!is_live).then(&mut next));
        is_live
    });
    assert!(packets.split_last().unwrap().1.iter().all(|packet| packet.state == State::Neutral));
    let changes = |packets: &[Packet], differ: fn(&Packet, &Packet) -> bool| {
        packets.windows(2).filter(|pair| differ(&pair[0], &pair[1])).count()
    };
    while changes(&packets, |a, b| a.capture_us != b.capture_us) < 20 {
        packets.push(next());
    }
    let moves = changes(&packets, |a, b| a.coefficients != b.coefficients);
    assert!(moves > 10, "{moves} moves in {} packets", packets.len());
    for packet in packets.iter().filter(|packet| packet.state == State::Live) {
        assert!(packet.reason == Reason::None && packet.age_us < 1_000_000, "{packet:?}");
        let length = packet.rotation.iter().map(|part| part * part).sum::<f32>();
        assert!((length - 1.0).abs() < 1e-3, "{packet:?}");
        assert!(packet.position_mm[2] > 100.0, "in front of the camera: {packet:?}");
    }
    // The way from neutral to the face is over.
    let last = packets.last().unwrap();
    assert!(last.coefficients.iter().any(|value| *value > 0.02), "{last:?}");
    let ended = service.stop(Signal::TERM);
    packets.extend(first.rest());
    assert_numbered(&packets);
    // Until the name of its host is found, the second receiver gets nothing.
    of_second.extend(second.rest());
    assert!(of_second.iter().any(|packet| packet.state == State::Live), "{of_second:?}");
    assert!(packets.ends_with(&of_second), "to the second receiver go the same packets");
    let log = assert_stopped(&packets, ended);
    assert!(log.contains("camera opened: demo: MJPEG 640x480 at 30 fps"), "{log}");
    // Every frame and every packet is in one of the counts of the last line.
    let count = |key| counted(&log, key);
    assert!(count("faces") > 0 && count("frames") == count("faces") + count("no_face") + count("rejected"), "{log}");
    assert_eq!(count("packets"), count("sent") + count("dropped"), "{log}");
}

/// The sender's own tests check how often.
#[test]
fn without_a_camera_a_neutral_face_is_sent_again_and_again_and_the_log_says_why() {
    let (service, receiver) = Service::with_receiver(NO_CAMERA);
    let mut packets: Vec<Packet> = (0..20).map(|_| receiver.packet()).collect();
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
    let disk = tempfile::tempdir().unwrap();
    let model = disk.path().join("mounted/blendshapes.toml");
    let (service, receiver) = Service::with_receiver(&format!("{DEMO}[solver]\nmodel = \"{}\"\n", text(&model)));
    for packet in receiver.until(|packet| packet.reason == Reason::BadResult) {
        assert_eq!((packet.state, packet.coefficients), (State::Neutral, [0.0; BLENDSHAPES.len()]));
    }
    (0..15).for_each(|_| assert_eq!(receiver.packet().state, State::Neutral));
    fs::create_dir(model.parent().unwrap()).unwrap();
    let whole = fs::read(project("models/blendshapes.toml")).unwrap();
    let replace = |bytes: &[u8]| {
        fs::write(model.with_extension("part"), bytes).unwrap();
        fs::rename(model.with_extension("part"), &model).unwrap();
    };
    // As a copy in progress leaves it.
    replace(&whole[..whole.len() / 2]);
    eventually("another reason", || {
        assert_eq!(receiver.packet().state, State::Neutral);
        service.logged("no model: ") == 2
    });
    replace(&whole);
    receiver.live();
    let log = service.stopped();
    assert_eq!(log.matches("blendshapes.toml cannot be read (No such file or directory").count(), 1, "{log}");
    assert_eq!(log.matches("no model: ").count(), 2, "once for each reason: {log}");
}

/// The service runs in a network namespace whose only interface is down.
#[test]
fn a_headset_that_a_reload_names_covers_the_eyes_at_once_and_no_longer_after_the_next_one() {
    let (service, receiver) = Service::live(DEMO);
    service.reload(&format!("{DEMO}[wearer]\nwears = \"headset\"\n"));
    receiver.until(|packet| packet.state == State::Live && packet.visibility.left_eye < 0.1);
    service.reload(DEMO);
    receiver.until(|packet| packet.state == State::Live && packet.visibility.left_eye > 0.5);
    service.stopped();
}

#[test]
fn a_network_that_takes_no_packets_is_told_once() {
    let unshare = ["--user", "--map-root-user", "--net"];
    if !Command::new("unshare").args(unshare).arg("true").output().is_ok_and(|run| run.status.success()) {
        return skip("unshare cannot make a network namespace here");
    }
    let mut command = Command::new("unshare");
    command.args(unshare).arg(env!("CARGO_BIN_EXE_facewire"));
    let service = Service::of(command, NO_CAMERA, &["192.0.2.1:5252".to_owned()], |command| command);
    let refusal = "link 192.0.2.1:5252: the network takes no packets (Network is unreachable";
    service.await_log(refusal);
    assert_eq!(counted(&service.status(), "links_open"), 0);
    assert_eq!(service.stopped().matches(refusal).count(), 1);
}

#[test]
fn a_receiver_that_is_not_there_is_told_once_gets_the_face_when_it_comes_and_is_no_longer_told() {
    let [near, late] = [Receiver::new(), Receiver::new()];
    let address = late.address();
    drop(late);
    let service = Service::start(NO_CAMERA, &[near.address(), address.clone()]);
    let (host, port) = address.rsplit_once(':').unwrap();
    let words = format!("link {address}: nobody listens on port {port} of {host}; start the receiver there");
    service.await_log(&words);
    let counts =
        |service: &Service| ["links_unheard", "links_open", "dropped"].map(|name| counted(&service.status(), name));
    eventually("the count", || counts(&service) == [1, 2, 0]);
    let late = Receiver(UdpSocket::bind(&address).unwrap());
    late.0.set_read_timeout(Some(PATIENCE)).unwrap();
    late.packet();
    eventually("no word", || counts(&service) == [0, 2, 0]);
    assert_eq!(service.stopped().matches(&words).count(), 1);
}

/// Waits until a service has ended, although one of its threads is stuck.
fn ended(service: Service, stuck: Stuck) -> Run {
    // The process stays a zombie until this one lets go of the stuck thread.
    eventually("the end", || service.proc("status").contains("State:\tZ"));
    drop(stuck);
    service.stop(Signal::TERM)
}

/// The thread that reads the camera is stopped, as if its driver did not return.
#[test]
fn a_hung_camera_does_not_keep_the_service_from_stopping() {
    let (mut service, receiver) = Service::with_receiver(DEMO);
    let mut packets = receiver.live();
    let stuck = Stuck::stop(service.thread("fw-hot"));
    service.signal(Signal::TERM);
    let ended = ended(service, stuck);
    packets.extend(receiver.rest());
    let log = assert_stopped(&packets, ended);
    assert!(log.contains("is left behind"), "{log}");
}

/// The sender is stuck, so that the first signal alone does not end the service.
#[test]
fn a_second_signal_ends_the_service_at_once() {
    let (mut service, _receiver) = Service::live(DEMO);
    let stuck = Stuck::stop(service.thread("fw-sender"));
    service.signal(Signal::TERM);
    // Two signals at the same moment may reach two threads, of which neither sees that the other is stopping the service.
    service.await_log("stopping");
    service.signal(Signal::INT);
    let run = ended(service, stuck);
    assert_eq!(run.status, Some(130), "{}", run.err);
}

/// Starts a service that logs into this pipe, asks it for a line, and checks that it runs and stops all the same.
fn assert_undisturbed(log: PipeWriter) {
    let receiver = Receiver::new();
    let service = Service::start_with(DEMO, &[receiver.address()], |command| command.stderr(log));
    let mut packets = receiver.live();
    service.signal(Signal::USR1);
    packets.extend((0..10).map(|_| receiver.packet()));
    let ended = service.stop(Signal::INT);
    packets.extend(receiver.rest());
    assert_stopped(&packets, ended);
}

#[test]
fn a_log_whose_reader_has_gone_ends_no_service() {
    assert_undisturbed(pipe().unwrap().1);
}

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
    let (_reader, log) = full();
    assert_undisturbed(log);
}

#[test]
fn the_monitor_shows_packets_and_fails_at_a_silent_or_taken_port_with_what_to_check() {
    let receiver = Receiver::new();
    let run = Run::of(&mut facewire(["monitor", "--listen", &receiver.address()]));
    assert!(run.sentence(1).contains("give --listen another address"), "{}", run.err);
    let run = Run::of(&mut facewire(["monitor", "--listen", "127.0.0.1:0", "--seconds", "0.2"]));
    assert!(run.sentence(1).contains("no packet came to "), "{}", run.err);
    let mut monitor = facewire(["monitor", "--json", "--packets", "5", "--seconds", "60", "--listen", "127.0.0.1:0"]);
    let monitor = monitor.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let _service = Service::start(DEMO, &[format!("127.0.0.1:{}", udp_port_of(monitor.id()))]);
    let run = Run::ended(&monitor.wait_with_output().unwrap()).succeeded();
    assert!(run.err.starts_with("5 packets in "), "{}", run.err);
    let lines: Vec<Value> = run.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let sequences = lines.iter().map(|line| line["sequence"].as_u64().unwrap());
    assert!(lines.len() == 5 && sequences.eq((lines[0]["sequence"].as_u64().unwrap()..).take(5)), "{}", run.out);
}
