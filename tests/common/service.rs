//! A running service and a receiver of its packets.

use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use facewire_packet::{PACKET_BYTES, Packet};
use rustix::process::{Pid, Signal, kill_process};
use tempfile::NamedTempFile;

use super::program::{Run, facewire, settings, text};
use super::stuck::thread_called;

/// Longer than anything in these tests takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);

/// `facewire run` in the background. It is killed when the test ends, even if the test fails.
pub struct Service {
    child: Option<Child>,
    settings: NamedTempFile,
}

impl Service {
    /// Starts a service with these settings and one link to each receiver.
    pub fn start(toml: &str, addresses: &[String]) -> Self {
        Self::start_logging_to(toml, addresses, Stdio::piped())
    }

    /// Starts a service that writes its log to `log`.
    pub fn start_logging_to(toml: &str, addresses: &[String], log: Stdio) -> Self {
        Self::start_with(toml, addresses, |command| command.stderr(log))
    }

    /// Starts a service after `prepare` has changed its command.
    pub fn start_with(toml: &str, addresses: &[String], prepare: impl FnOnce(&mut Command) -> &mut Command) -> Self {
        let links: Vec<String> =
            addresses.iter().map(|address| format!("[[link]]\naddress = \"{address}\"\n")).collect();
        let settings = settings(&[toml, &links.concat()].concat());
        let mut command = facewire(["run", "--config", text(settings.path())]);
        Self { child: Some(started(prepare(&mut command))), settings }
    }

    /// Returns the number of the thread with this name.
    pub fn thread(&mut self, name: &str) -> i32 {
        thread_called(self.child.as_mut().unwrap(), name)
    }

    /// Gives the service other settings.
    pub fn reload(&self, toml: &str) {
        std::fs::write(self.settings.path(), toml).unwrap();
        self.signal(Signal::HUP);
    }

    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(self.child.as_ref().unwrap()), signal).unwrap();
    }

    /// Sends the signal and waits for the end. Returns the run, and how long the end took.
    pub fn stop(mut self, signal: Signal) -> (Run, Duration) {
        self.signal(signal);
        let mut child = self.child.take().unwrap();
        let told = Instant::now();
        while child.try_wait().unwrap().is_none() {
            if told.elapsed() > PATIENCE {
                child.kill().unwrap();
            }
            sleep(Duration::from_millis(5));
        }
        let took = told.elapsed();
        (Run::ended(&child.wait_with_output().unwrap()), took)
    }

    pub fn pid(&self) -> u32 {
        self.child.as_ref().unwrap().id()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        if let Some(child) = &mut self.child {
            child.kill().unwrap();
            child.wait().unwrap();
        }
    }
}

fn started(command: &mut Command) -> Child {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().unwrap()
}

/// Returns this counter of the last status line in a log.
pub fn counted(log: &str, key: &str) -> u64 {
    let line =
        log.lines().rfind(|line| line.contains(" cameras_opened=")).unwrap_or_else(|| panic!("no status: {log}"));
    let value = line.split_whitespace().find_map(|part| part.strip_prefix(key)?.strip_prefix('='));
    value.unwrap_or_else(|| panic!("no {key}: {line}")).parse().unwrap()
}

/// A receiver of packets at a UDP port of its own.
pub struct Receiver(UdpSocket);

impl Receiver {
    pub fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        Self(socket)
    }

    pub fn port(&self) -> u16 {
        self.0.local_addr().unwrap().port()
    }

    pub fn address(&self) -> String {
        self.0.local_addr().unwrap().to_string()
    }

    /// Returns the next packet, which must be valid and come within 5 seconds.
    pub fn packet(&self) -> Packet {
        let mut bytes = [0; PACKET_BYTES + 1];
        let length = self.0.recv(&mut bytes).unwrap_or_else(|error| panic!("no packet came: {error}"));
        Packet::decode(&bytes[..length]).unwrap()
    }

    /// Returns the packets up to and including the first that is wanted.
    pub fn until(&self, wanted: impl Fn(&Packet) -> bool) -> Vec<Packet> {
        let begun = Instant::now();
        let mut packets = vec![self.packet()];
        while !packets.last().is_some_and(&wanted) {
            assert!(begun.elapsed() < PATIENCE, "{:?}", packets.last());
            packets.push(self.packet());
        }
        packets
    }

    /// Returns the packets that have come and were not taken yet.
    pub fn rest(&self) -> Vec<Packet> {
        self.0.set_nonblocking(true).unwrap();
        let waits = || self.0.peek(&mut [0; PACKET_BYTES]).is_ok();
        let rest = std::iter::from_fn(|| waits().then(|| self.packet())).collect();
        self.0.set_nonblocking(false).unwrap();
        rest
    }
}
