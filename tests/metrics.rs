//! The metrics of `facewire run`, read by Prometheus' own parser, and faults that must not stop the service.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::os::unix::net::UnixStream;
use std::path::Path;
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

use common::program::{Run, text};
use common::service::{DEMO, Receiver, Service};
use common::{PATIENCE, eventually, project};
use rustix::process::{Resource, Rlimit, Signal, getrlimit, prlimit};
use serde_json::Value;

/// How far counters may differ: frames that are solved but not sent yet, or that come while the page is written.
const FRAMES_BETWEEN: f64 = 30.0;

/// Starts a service that plays the built-in clip and serves its metrics at `listen`.
fn start(listen: &str) -> (Service, Receiver) {
    Service::live(&format!("{DEMO}[metrics]\nlisten = \"{listen}\"\n"))
}

fn free_address() -> String {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().to_string()
}

fn samples(python: &Path, listen: &str) -> Value {
    let run = Run::of(Command::new(python).arg(project("tests/metrics_reader.py")).arg(listen)).succeeded();
    serde_json::from_str(&run.out).unwrap()
}

fn answer(address: &str, request: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(PATIENCE)).unwrap();
    stream.write_all(request).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn prometheus_parser_reads_the_metrics_by_tcp_and_by_unix_socket() {
    let Some(python) = common::python_with("venv-tests", "prometheus_client") else {
        return common::skip("Prometheus' parser is not there; run scripts/setup tests");
    };
    let folder = tempfile::tempdir().unwrap();
    for listen in [free_address(), format!("unix:{}", text(&folder.path().join("metrics.sock")))] {
        let (service, _receiver) = start(&listen);
        let before = samples(&python, &listen);
        let samples = samples(&python, &listen);
        let value = |name: &str| samples[name].as_f64().unwrap_or_else(|| panic!("no {name} in {samples}"));

        let solved = value("facewire_frames_total{result=solved}");
        assert!(solved > before["facewire_frames_total{result=solved}"].as_f64().unwrap(), "they go on");
        for [count, sum, longest_s] in [
            ["facewire_stage_seconds_count{stage=wait}", "facewire_stage_seconds_sum{stage=wait}", "1"],
            ["facewire_stage_seconds_count{stage=mesh}", "facewire_stage_seconds_sum{stage=mesh}", "1"],
            ["facewire_stage_seconds_count{stage=solve}", "facewire_stage_seconds_sum{stage=solve}", "0.1"],
            ["facewire_work_seconds_count{}", "facewire_work_seconds_sum{}", "1"],
            ["facewire_age_seconds_count{}", "facewire_age_seconds_sum{}", "1"],
        ] {
            assert!((value(count) - solved).abs() <= FRAMES_BETWEEN, "{count}: {samples}");
            let mean_s = value(sum) / value(count);
            assert!(mean_s > 0.0 && mean_s < longest_s.parse().unwrap(), "{sum}: {mean_s} s in the mean");
        }
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
    let other = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = other.local_addr().unwrap().to_string();
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
        assert_eq!(service.stop(Signal::KILL).0.status, None);
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
    let address = free_address();
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
    let (thread, own) = (service.thread("fw-control"), getrlimit(Resource::Nofile));
    prlimit(Some(service.pid()), Resource::Nofile, Rlimit { current: Some(3), ..own }).unwrap();
    let reader = std::thread::spawn(move || answer(&address, good));
    let begun = ticks(thread);
    sleep(Duration::from_secs(2));
    let took = ticks(thread) - begun;
    assert!(took < 10, "{took} of 200 ticks");
    prlimit(Some(service.pid()), Resource::Nofile, own).unwrap();
    assert!(reader.join().unwrap().starts_with("HTTP/1.1 200 OK"));
    receiver.live();
}
