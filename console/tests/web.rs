//! The program over HTTP and UDP, without a browser.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::{
    fs,
    io::{Read as _, Write as _},
    net::UdpSocket,
    os::fd::OwnedFd,
    process::Output,
};

use common::{Sending, Viewer, command, memory_kb, packet};
use facewire_packet::{Packet, State};
use rustix::{
    fs::{Mode, OFlags},
    process::{Pid, Signal, kill_process},
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{OptionalActions, tcgetattr, tcsetattr},
};

/// Runs the program to its end.
fn ended(arguments: &[&str]) -> (Option<i32>, String) {
    let Output { status, stderr, .. } = command(arguments).output().unwrap();
    (status.code(), String::from_utf8(stderr).unwrap())
}

fn is_shown(event: &serde_json::Value, coefficient: usize, want: f64) -> bool {
    event["packet"]["coefficients"][coefficient].as_f64().is_some_and(|value| (value - want).abs() < 1e-4)
}

#[test]
fn every_answer_allows_the_page_nothing_from_elsewhere() {
    let viewer = Viewer::start();
    for part in ["", "app.js", "face/face.js", "style.css", "icon.svg", "nothing"] {
        let answer = viewer.part(part).to_lowercase();
        for header in [
            "content-security-policy: default-src 'none'; script-src 'self'",
            "x-content-type-options: nosniff",
            "referrer-policy: no-referrer",
            "cross-origin-resource-policy: same-origin",
        ] {
            assert!(answer.contains(header), "{part}: {answer}");
        }
    }
    assert!(viewer.part("").starts_with("HTTP/1.1 200"));
    assert!(viewer.part("nothing").starts_with("HTTP/1.1 404"));
}

#[test]
fn other_hosts_and_other_pages_get_nothing() {
    let viewer = Viewer::start();
    let rebound = viewer.get("/", "Host: evil.example:5252\r\n");
    assert!(rebound.starts_with("HTTP/1.1 421") && rebound.contains("Open the address that"), "{rebound}");
    let host = viewer.host();
    let foreign = viewer.get("/api/1/events", &format!("Host: {host}\r\nOrigin: http://evil.example\r\n"));
    assert!(foreign.starts_with("HTTP/1.1 403"), "{foreign}");
    let hidden = viewer.get("/api/1/events", &format!("Host: {host}\r\nSec-Fetch-Site: cross-site\r\n"));
    assert!(hidden.starts_with("HTTP/1.1 403"), "{hidden}");
}

#[test]
fn a_page_for_other_machines_needs_the_token_that_was_printed() {
    let viewer = Viewer::with(&["--listen", "0.0.0.0:0", "--udp", "127.0.0.1:0"]);
    let token = viewer.path("");
    assert_eq!(token.len(), 34, "{token}");
    assert!(viewer.part("").starts_with("HTTP/1.1 200"));
    assert!(viewer.part("app.js").starts_with("HTTP/1.1 200"));
    assert_eq!(viewer.events().status(), "HTTP/1.1 200 OK\r\n");
    let other = Viewer::with(&["--listen", "0.0.0.0:0", "--udp", "127.0.0.1:0"]).path("");
    assert_ne!(token, other);
    for path in ["/", "/api/1/events", "/app.js", &other, &format!("{other}api/1/events"), &token[..20]] {
        let answer = viewer.get(path, &format!("Host: {}\r\n", viewer.host()));
        assert!(answer.starts_with("HTTP/1.1 403") && answer.contains("lacks the token"), "{path}: {answer}");
    }
}

#[test]
fn packets_are_shown_with_their_losses() {
    let viewer = Viewer::start();
    let mut events = viewer.events();
    assert_eq!(events.next()["names"].as_array().unwrap().len(), 52);
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    for sequence in [65_534, 65_535, 2] {
        let packet = Packet { sequence, ..packet(&[("jawOpen", 0.5)]) };
        socket.send_to(&packet.encode(), viewer.packets_to()).unwrap();
    }
    let event = events.until(|event| event["packets"] == 3);
    assert!(is_shown(&event, 17, 0.5), "{event}");
    assert_eq!((&event["lost"], &event["packet"]["number"]), (&2.into(), &5.into()));
    assert_eq!(event["packet"]["from"], socket.local_addr().unwrap().to_string());
}

#[test]
fn ten_thousand_hostile_datagrams_are_refused_and_the_next_packet_is_shown() {
    let viewer = Viewer::start();
    let mut events = viewer.events();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut random = fastrand::Rng::with_seed(52);
    let valid = packet(&[("jawOpen", 1.0)]).encode();
    for round in 0..10_000_u32 {
        let mut bytes: Vec<u8> = (0..random.usize(0..2000)).map(|_| random.u8(..)).collect();
        if round % 3 == 0 {
            // Almost a packet: one bit differs.
            bytes = valid.to_vec();
            bytes[random.usize(0..valid.len())] ^= 1 << random.u32(0..8);
        }
        socket.send_to(&bytes, viewer.packets_to()).unwrap();
        if round % 64 == 0 {
            // Waits until they are counted, because the system drops what a full buffer cannot hold.
            events.until(|event| event["refused"].as_u64() > Some(u64::from(round)));
        }
    }
    let sending = Sending::to(viewer.packets_to(), packet(&[("jawOpen", 0.25)]));
    let event = events.until(|event| is_shown(event, 17, 0.25));
    assert!(event["refused"].as_u64() > Some(9_900), "{event}");
    drop(sending);
}

#[test]
fn a_browser_that_never_reads_delays_nobody_and_takes_no_memory() {
    let viewer = Viewer::start();
    let sending = Sending::to(viewer.packets_to(), packet(&[]));
    // They ask for events and do not read a byte of them.
    let stuck: Vec<_> = (0..8)
        .map(|_| {
            let mut stream = viewer.connect();
            write!(stream, "GET /api/1/events HTTP/1.1\r\nHost: {}\r\n\r\n", viewer.host()).unwrap();
            stream
        })
        .collect();
    let mut events = viewer.events();
    events.until(|event| event["packets"].as_u64() > Some(60));
    let before = memory_kb(viewer.pid(), "VmRSS");
    let counted = events.until(|event| event["packets"].as_u64() > Some(600));
    assert!(
        memory_kb(viewer.pid(), "VmRSS") < before + 4096,
        "{before} KB before, {} KB after",
        memory_kb(viewer.pid(), "VmRSS")
    );
    sending.show(packet(&[("jawOpen", 0.75)]));
    let shown = events.until(|event| is_shown(event, 17, 0.75));
    let late = shown["packets"].as_u64().unwrap() - counted["packets"].as_u64().unwrap();
    assert!(late < 600, "{late} packets later");
    drop(stuck);
}

#[test]
fn a_slow_browser_sees_the_newest_and_at_most_60_events_a_second() {
    let viewer = Viewer::start();
    let begin = std::time::Instant::now();
    let mut events = viewer.events();
    events.next();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    for sequence in 0..2000 {
        socket.send_to(&Packet { sequence, ..packet(&[]) }.encode(), viewer.packets_to()).unwrap();
    }
    let newest = packet(&[("jawOpen", 1.0)]).encode();
    let count = std::cell::Cell::new(0_u32);
    events.until(|event| {
        count.set(count.get() + 1);
        assert!(event["packet"].is_object() || event["packets"] == 0);
        // Sent again after each event, because the system drops packets while the buffer of the socket is full.
        socket.send_to(&newest, viewer.packets_to()).unwrap();
        is_shown(event, 17, 1.0)
    });
    assert!(count.get() < 500, "{} events before the newest packet", count.get());
    for _ in 0..30 {
        socket.send_to(&packet(&[]).encode(), viewer.packets_to()).unwrap();
        events.next();
    }
    let count = count.get() + 30;
    assert!(begin.elapsed().as_secs_f64() > f64::from(count - 1) / 61.0, "{count} events in {:?}", begin.elapsed());
}

#[test]
fn many_clients_are_refused_politely_and_served_again_later() {
    let viewer = Viewer::start();
    let mut open: Vec<_> = (0..16).map(|_| viewer.events()).collect();
    for events in &mut open {
        assert_eq!(events.status(), "HTTP/1.1 200 OK\r\n");
    }
    let refused = viewer.part("api/1/events");
    assert!(refused.starts_with("HTTP/1.1 503") && refused.contains("Close one of them"), "{refused}");
    // Connections beyond the limit are closed at once, and those that are open go on.
    let mut idle: Vec<_> = (0..100).map(|_| viewer.connect()).collect();
    let closed = idle.iter_mut().rev().take(20).all(|stream| stream.read(&mut [0; 1]).is_ok_and(|length| length == 0));
    assert!(closed, "there is no limit");
    drop(idle);
    for events in &mut open {
        assert!(events.next().is_object());
    }
    drop(open);
    while !viewer.events().status().starts_with("HTTP/1.1 200") {}
}

#[test]
fn damaged_requests_do_no_harm() {
    let viewer = Viewer::start();
    let mut random = fastrand::Rng::with_seed(5);
    for _ in 0..200 {
        let mut stream = viewer.connect();
        let bytes: Vec<u8> = (0..random.usize(1..40_000)).map(|_| random.u8(..)).collect();
        // The program may close the connection before it has read everything.
        let _ = stream.write_all(&bytes);
    }
    assert!(viewer.part("").starts_with("HTTP/1.1 200"));
}

#[test]
fn a_serial_line_is_waited_for_read_and_waited_for_again() {
    let folder = tempfile::tempdir().unwrap();
    let link = folder.path().join("port");
    let viewer = Viewer::with(&["--listen", "127.0.0.1:0", "--serial", link.to_str().unwrap()]);
    assert_eq!(viewer.place, format!("{} with 115200 baud", link.display()));
    let mut events = viewer.events();
    let trouble = events.until(|event| event["trouble"].is_string());
    assert!(trouble["trouble"].as_str().unwrap().contains("there is no such serial port"), "{trouble}");
    for open in [0.25, 0.5] {
        let (port, name) = pseudo_terminal();
        std::os::unix::fs::symlink(name, &link).unwrap();
        events.until(|event| event["trouble"].is_null());
        let frame = packet(&[("jawOpen", open)]).encode_frame();
        // The rest of a frame, and the start-up message of a board, are skipped.
        rustix::io::write(&port, &[&frame[100..], b"Booting\r\n\0", &frame[..], &frame[..]].concat()).unwrap();
        events.until(|event| is_shown(event, 17, open.into()));
        fs::remove_file(&link).unwrap();
        drop(port);
        events.until(|event| event["trouble"].is_string());
    }
}

#[test]
fn what_cannot_be_opened_is_named_with_the_remedy() {
    let viewer = Viewer::start();
    let udp = viewer.packets_to().to_string();
    let (status, error) = ended(&["--listen", "127.0.0.1:0", "--udp", &udp]);
    assert_eq!(status, Some(1));
    assert!(
        error.starts_with("facewire-console: cannot receive packets at") && error.contains("give --udp another"),
        "{error}"
    );
    let (status, error) = ended(&["--listen", viewer.host(), "--udp", "127.0.0.1:0"]);
    assert_eq!(status, Some(1));
    assert!(error.contains("cannot serve the page") && error.contains("give --listen another"), "{error}");
    assert_eq!(ended(&["--listen", "here"]).0, Some(2));
    assert_eq!(ended(&["--serial", "/dev/ttyUSB0", "--udp", "[::]:1"]).0, Some(2));
}

#[test]
fn signals_end_the_program_with_success() {
    for signal in [Signal::INT, Signal::TERM] {
        let mut viewer = Viewer::start();
        let _events = viewer.events().next();
        kill_process(Pid::from_raw(viewer.pid().try_into().unwrap()).unwrap(), signal).unwrap();
        assert_eq!(viewer.ended(), Some(0), "{signal:?}");
    }
}

#[test]
fn the_state_and_the_reason_are_named() {
    let viewer = Viewer::start();
    let mut events = viewer.events();
    let held = Packet { state: State::Hold, reason: facewire_packet::Reason::NoCamera, ..packet(&[]) };
    let sending = Sending::to(viewer.packets_to(), held);
    let event = events.until(|event| event["packet"].is_object());
    assert_eq!((&event["packet"]["state"], &event["packet"]["reason"]), (&"hold".into(), &"no camera".into()));
    drop(sending);
}

/// Returns one end of a pseudo-terminal, and the name of the other, which passes bytes on unchanged.
fn pseudo_terminal() -> (OwnedFd, String) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap().into_string().unwrap();
    let slave = rustix::fs::open(name.as_str(), OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).unwrap();
    let mut modes = tcgetattr(&slave).unwrap();
    modes.make_raw();
    tcsetattr(&slave, OptionalActions::Now, &modes).unwrap();
    (master, name)
}
