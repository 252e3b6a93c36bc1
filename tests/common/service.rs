//! A running service and a receiver of its packets.

use std::fs;
use std::io::Read as _;
use std::net::UdpSocket;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::thread::{panicking, sleep};
use std::time::{Duration, Instant};

use facewire_packet::{PACKET_BYTES, Packet, State};
use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

use super::program::{Run, facewire, text};
use super::stuck::thread_called;
use super::{PATIENCE, eventually};

pub const DEMO: &str = "[camera]\ndevice = \"demo\"\n";
pub const NO_CAMERA: &str = "[camera]\ndevice = \"/dev/video99\"\n";

/// `facewire run` in the background, with its settings and its log. It is killed when the test ends, even if the test fails.
pub struct Service {
    pub child: Child,
    folder: TempDir,
    /// The links that are added to all settings.
    links: String,
}

impl Service {
    /// Starts a service with these settings and one link to each receiver.
    pub fn start(toml: &str, addresses: &[String]) -> Self {
        Self::start_with(toml, addresses, |command| command)
    }

    /// Starts a service with these settings and a link to a receiver.
    pub fn with_receiver(toml: &str) -> (Self, Receiver) {
        let receiver = Receiver::new();
        (Self::start(toml, &[receiver.address()]), receiver)
    }

    /// Starts a service with a receiver, and waits until its face is live.
    pub fn live(toml: &str) -> (Self, Receiver) {
        let (service, receiver) = Self::with_receiver(toml);
        receiver.live();
        (service, receiver)
    }

    /// Starts a service after `prepare` has changed its command.
    pub fn start_with(toml: &str, addresses: &[String], prepare: impl FnOnce(&mut Command) -> &mut Command) -> Self {
        Self::of(facewire::<&str>([]), toml, addresses, prepare)
    }

    /// Starts a service by this command, which takes the arguments of `facewire`.
    pub fn of(
        mut command: Command,
        toml: &str,
        addresses: &[String],
        prepare: impl FnOnce(&mut Command) -> &mut Command,
    ) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let links: String = addresses.iter().map(|address| format!("[[link]]\naddress = \"{address}\"\n")).collect();
        let settings = folder.path().join("facewire.toml");
        fs::write(&settings, [toml, &links].concat()).unwrap();
        let log = fs::File::options().append(true).create(true).open(folder.path().join("log")).unwrap();
        // Services that tests run side by side must not meet at one control socket.
        command.env_remove("RUNTIME_DIRECTORY").env("XDG_RUNTIME_DIR", "");
        command.args(["run", "--config", text(&settings)]).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(log);
        Self { child: prepare(&mut command).spawn().unwrap(), folder, links }
    }

    pub fn thread(&mut self, name: &str) -> i32 {
        thread_called(&mut self.child, name)
    }

    /// The path of the settings.
    pub fn settings(&self) -> PathBuf {
        self.folder.path().join("facewire.toml")
    }

    pub fn pid(&self) -> Pid {
        Pid::from_child(&self.child)
    }

    /// Reads a file of the process in `/proc`.
    pub fn proc(&self, file: &str) -> String {
        fs::read_to_string(format!("/proc/{}/{file}", self.child.id())).unwrap()
    }

    /// A line of `/proc/PID/status`, in KiB.
    pub fn kib(&self, line: &str) -> usize {
        let status = self.proc("status");
        let value = status.lines().find_map(|it| it.strip_prefix(line)).unwrap();
        value.trim().trim_end_matches(" kB").parse().unwrap()
    }

    pub fn log(&self) -> String {
        fs::read_to_string(self.folder.path().join("log")).unwrap()
    }

    pub fn logged(&self, text: &str) -> usize {
        self.log().matches(text).count()
    }

    pub fn await_log(&self, text: &str) {
        let begun = Instant::now();
        while self.logged(text) == 0 {
            assert!(begun.elapsed() < PATIENCE, "no {text}: {}", self.log());
            sleep(Duration::from_millis(5));
        }
    }

    /// Gives the service other settings, with the links to its receivers.
    pub fn reload(&self, toml: &str) {
        fs::write(self.settings(), [toml, &self.links].concat()).unwrap();
        self.signal(Signal::HUP);
    }

    /// Gives the service other settings, and waits until it has taken them.
    pub fn change(&self, toml: &str) {
        let before = self.logged("settings changed");
        self.reload(toml);
        eventually("the new settings", || self.logged("settings changed") > before);
    }

    pub fn signal(&self, signal: Signal) {
        kill_process(self.pid(), signal).unwrap();
    }

    /// Asks for a status line, and waits for it. Call this only after the first packet: before, the service may not handle the
    /// signal yet, which then kills it.
    pub fn status(&self) -> String {
        let before = status_lines(&self.log()).count();
        self.signal(Signal::USR1);
        eventually("a status line", || status_lines(&self.log()).count() > before);
        status_lines(&self.log()).next_back().unwrap().to_owned()
    }

    /// Sends the signal and waits for the end.
    pub fn stop(mut self, signal: Signal) -> Run {
        self.signal(signal);
        eventually("the end", || self.child.try_wait().unwrap().is_some());
        let status = self.child.wait().unwrap().code();
        let mut out = String::new();
        self.child.stdout.take().map(|mut stdout| stdout.read_to_string(&mut out).unwrap());
        let err = self.log();
        assert!(!err.contains("panicked"), "{err}");
        Run { status, out, err }
    }

    /// Stops the service as systemd does, which must succeed. Returns its log.
    pub fn stopped(self) -> String {
        self.stop(Signal::TERM).succeeded().err
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if panicking() {
            let log = self.log();
            let lines: Vec<&str> = log.lines().rev().take(20).collect();
            eprintln!("the end of the service's log, newest first:\n{}", lines.join("\n"));
        }
    }
}

fn status_lines(log: &str) -> impl DoubleEndedIterator<Item = &str> {
    log.lines().filter(|line| line.contains(" cameras_opened="))
}

/// Returns this counter of the last status line in a log.
pub fn counted(log: &str, key: &str) -> u64 {
    let line = status_lines(log).next_back().unwrap_or_else(|| panic!("no status: {log}"));
    let value = line.split_whitespace().find_map(|part| part.strip_prefix(key)?.strip_prefix('='));
    value.unwrap_or_else(|| panic!("no {key}: {line}")).parse().unwrap()
}

pub struct Receiver(pub UdpSocket);

impl Receiver {
    pub fn new() -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.set_read_timeout(Some(PATIENCE)).unwrap();
        Self(socket)
    }

    pub fn port(&self) -> u16 {
        self.0.local_addr().unwrap().port()
    }

    pub fn address(&self) -> String {
        self.0.local_addr().unwrap().to_string()
    }

    /// Waits for the next datagram.
    pub fn datagram(&self) -> Vec<u8> {
        let mut bytes = vec![0; 2048];
        let length = self.0.recv(&mut bytes).unwrap_or_else(|error| panic!("nothing came: {error}"));
        bytes.truncate(length);
        bytes
    }

    /// Waits for the next packet, which must be valid.
    pub fn packet(&self) -> Packet {
        Packet::decode(&self.datagram()).unwrap()
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

    pub fn until_state(&self, state: State) -> Vec<Packet> {
        self.until(|packet| packet.state == state)
    }

    pub fn live(&self) -> Vec<Packet> {
        self.until_state(State::Live)
    }

    pub fn live_packets(&self, count: usize) {
        (0..count).for_each(|_| drop(self.live()));
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
