//! The metrics of `facewire run`, read by Prometheus' own parser, and faults that must not stop the service.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::io::{self, Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command;

use common::ports::HeldPort;
use common::program::{Run, text};
use common::service::{DEMO, NO_CAMERA, Receiver, Service};
use common::{PATIENCE, eventually, project};
use facewire_packet::Reason;
use rustix::process::{Resource, Rlimit, Signal, getrlimit, prlimit};
use serde_json::Value;

/// Settings with this camera, under which the metrics are served at `listen`.
fn settings(camera: &str, listen: &str) -> String {
    format!("{camera}[metrics]\nlisten = \"{listen}\"\n")
}

/// Starts a service that plays the built-in clip and serves its metrics at `listen`.
fn start(listen: &str) -> (Service, Receiver) {
    Service::live(&settings(DEMO, listen))
}

/// What Python's client says if the connection was closed before its request came.
const TOO_LATE: [&str; 3] = ["RemoteDisconnected", "ConnectionResetError", "BrokenPipeError"];
/// How often a request is made that a busy machine may let come too late.
const TRIES: usize = 3;

/// Reads the metrics by Python. Repeats the request if the service closed the connection before it came.
fn samples(python: &Path, listen: &str) -> Value {
    let read = || Run::of(Command::new(python).arg(project("tests/metrics_reader.py")).arg(listen));
    let mut run = read();
    for _ in 1..TRIES {
        if TOO_LATE.iter().any(|error| run.err.contains(error)) {
            run = read();
        }
    }
    serde_json::from_str(&run.succeeded().out).unwrap()
}

/// Makes a request, and returns what comes back before the connection is closed.
fn answer_once(address: &str, request: &[u8]) -> io::Result<String> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.write_all(request)?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    Ok(answer)
}

/// As [`answer_once`]. Repeats the request if the service closed the connection before it came.
fn answer(address: &str, request: &[u8]) -> String {
    let mut answer = answer_once(address, request);
    for _ in 1..TRIES {
        let is_too_late = match &answer {
            Ok(text) => text.is_empty(),
            Err(error) => matches!(error.kind(), io::ErrorKind::ConnectionReset | io::ErrorKind::BrokenPipe),
        };
        if is_too_late {
            answer = answer_once(address, request);
        }
    }
    answer.unwrap()
}

#[test]
fn prometheus_parser_reads_the_metrics_by_tcp_and_by_unix_socket() {
    let Some(python) = common::python_with("venv-tests", "prometheus_client") else {
        return common::skip("Prometheus' parser is not there; run scripts/setup tests");
    };
    let folder = tempfile::tempdir().unwrap();
    let port = HeldPort::new();
    for listen in [port.address().to_string(), format!("unix:{}", text(&folder.path().join("metrics.sock")))] {
        let (service, receiver) = start(&listen);
        // Without a camera, no frame is on its way.
        service.change(&settings(NO_CAMERA, &listen));
        receiver.until(|packet| packet.reason == Reason::NoCamera);
        let samples = samples(&python, &listen);
        let value = |name: &str| samples[name].as_f64().unwrap_or_else(|| panic!("no {name} in {samples}"));

        let solved = value("facewire_frames_total{result=solved}");
        assert!(solved > 0.0, "{samples}");
        for (name, label) in [("stage", "stage=wait"), ("stage", "stage=mesh"), ("stage", "stage=solve"), ("work", "")]
        {
            let count = value(&format!("facewire_{name}_seconds_count{{{label}}}"));
            assert!(count == solved, "{name} {label}: {samples}");
            assert!(value(&format!("facewire_{name}_seconds_sum{{{label}}}")) > 0.0, "{name} {label}: {samples}");
        }
        // On a busy machine, a newer pose may come before the sender has seen the last one.
        let sent = value("facewire_age_seconds_count{}");
        assert!(sent > 0.0 && sent <= solved, "{samples}");
        assert!(value("facewire_age_seconds_sum{}") > 0.0, "{samples}");
        let states =
            ["live", "hold", "decay", "neutral"].map(|state| format!("facewire_failsafe_state{{state={state}}}"));
        assert!((states.iter().map(|state| value(state)).sum::<f64>() - 1.0).abs() < 1e-9, "{samples}");
        assert!(value("facewire_resident_memory_bytes{}") > 10e6);
        service.stopped();
    }
    assert!(!folder.path().join("metrics.sock").exists(), "it goes with the service");
}

#[test]
fn a_port_in_use_is_told_once_stops_no_face_and_is_taken_when_it_is_free() {
    let port = HeldPort::new();
    let address = port.address().to_string();
    let other = TcpListener::bind(&address).unwrap();
    let (service, receiver) = start(&address);
    (0..60).for_each(|_| _ = receiver.packet());
    drop(other);
    eventually("metrics", || TcpStream::connect(&address).is_ok());
    let log = service.stopped();
    let told = format!(
        "no metrics at {address} (Address already in use (os error 98)): free the address or change metrics.listen"
    );
    assert_eq!(log.matches(&told).count(), 1, "{log}");
}

#[test]
fn the_socket_that_a_killed_service_left_behind_is_taken_by_the_next() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("metrics.sock");
    for _ in 0..2 {
        let (service, _receiver) = start(&format!("unix:{}", text(&path)));
        eventually("metrics", || UnixStream::connect(&path).is_ok());
        assert_eq!(service.stop(Signal::KILL).status, None);
        assert!(path.exists());
    }
}

/// Returns the CPU time of a thread in ticks, of which there are 100 a second.
fn ticks(thread: i32) -> u64 {
    let stat = std::fs::read_to_string(format!("/proc/{thread}/task/{thread}/stat")).unwrap();
    let fields: Vec<_> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
    fields[11..=12].iter().map(|field| field.parse::<u64>().unwrap()).sum()
}

#[test]
fn wrong_requests_are_answered_a_silent_reader_delays_no_other_and_one_without_a_descriptor_waits_and_costs_nothing() {
    let port = HeldPort::new();
    let address = port.address().to_string();
    let (mut service, receiver) = start(&address);
    eventually("metrics", || TcpStream::connect(&address).is_ok());
    let _silent = TcpStream::connect(&address).unwrap();
    let good = b"GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n";
    for (request, status) in [
        (&good[..], "200 OK\r\n"),
        (b"GET /metrics HTTP/1.1\r\nHost: evil.example\r\n\r\n", "421 "),
        (b"GET / HTTP/1.1\r\n\r\n", "404 "),
        (b"DELETE /metrics HTTP/1.1\r\n\r\n", "405 "),
        (&[0; 64], "400 "),
        (&[b"GET /".as_slice(), &[b'x'; 4091]].concat(), "431 "),
    ] {
        let answer = answer(&address, request);
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{answer}");
    }
    let thread = service.thread("fw-control");
    let own = getrlimit(Resource::Nofile);
    prlimit(Some(service.pid()), Resource::Nofile, Rlimit { current: Some(3), ..own }).unwrap();
    let reader = std::thread::spawn(move || answer_once(&address, good).unwrap());
    let before = ticks(thread);
    // Two seconds of the clip.
    receiver.rest();
    receiver.live_packets(60);
    let took = ticks(thread) - before;
    assert!(took < 10, "{took} of 200 ticks");
    prlimit(Some(service.pid()), Resource::Nofile, own).unwrap();
    assert!(reader.join().unwrap().starts_with("HTTP/1.1 200 OK"));
    receiver.live();
}
