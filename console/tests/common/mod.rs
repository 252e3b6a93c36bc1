//! Helpers of the whole-program tests.
#![allow(dead_code, reason = "each test uses some of them")]

#[path = "../../../tests/common/answers.rs"]
pub mod answers;
#[path = "../../../tests/common/board.rs"]
pub mod board;
pub mod browser;
#[path = "../../../tests/common/eventually.rs"]
mod eventually;
#[path = "../../../tests/common/hooks.rs"]
pub mod hooks;
#[path = "../../../tests/common/interface.rs"]
pub mod interface;
#[path = "../../../tests/common/maestro.rs"]
pub mod maestro;
#[path = "../../../tests/common/python.rs"]
mod python;
pub mod service;
#[path = "../../../tests/common/skip.rs"]
mod skip;

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::{SocketAddr, TcpStream, UdpSocket},
    path::{Path, PathBuf},
    process::{Child, ChildStdout, Command, Stdio},
    sync::mpsc,
    thread,
    time::Duration,
};

#[allow(unused_imports, reason = "each test uses some of them")]
pub use self::{
    eventually::{PATIENCE, eventually},
    python::python_with,
    skip::skip,
};
use facewire_packet::{BLENDSHAPES, Packet, State};

/// The path of a file of the project.
pub fn project(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(path)
}

/// Returns a command that runs the program.
pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_facewire-console"));
    command.args(arguments).stdin(Stdio::null());
    command
}

/// A running program.
pub struct Viewer {
    child: Child,
    output: BufReader<ChildStdout>,
    /// The address that it prints.
    pub url: String,
    /// Where it expects packets, as it prints it.
    pub place: String,
}

impl Viewer {
    /// Starts the program on free loopback ports.
    pub fn start() -> Self {
        Self::with(&["--listen", "127.0.0.1:0", "--udp", "127.0.0.1:0"])
    }

    pub fn with(arguments: &[&str]) -> Self {
        Self::spawn(&mut command(arguments))
    }

    /// Starts the program on a port that another one had. It tries again while a test beside this one has been given the port.
    pub fn again(arguments: &[&str]) -> Self {
        let mut again = None;
        eventually("the port", || {
            again = Self::try_to_spawn(&mut command(arguments)).ok();
            again.is_some()
        });
        again.unwrap()
    }

    pub fn spawn(command: &mut Command) -> Self {
        Self::try_to_spawn(command).unwrap_or_else(|urls| panic!("it ended: {urls:?}"))
    }

    /// If the program ends before it says where it expects packets, returns the addresses that it has printed.
    fn try_to_spawn(command: &mut Command) -> Result<Self, Vec<String>> {
        let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut output = BufReader::new(child.stdout.take().unwrap());
        let mut urls = Vec::new();
        let place = loop {
            let mut line = String::new();
            if output.read_line(&mut line).unwrap() == 0 {
                let _ = child.wait();
                return Err(urls);
            }
            let place = line.strip_prefix("Waiting for packets at ").or(line.strip_prefix("Operating the service of "));
            if let Some(place) = place {
                break place.split_once(". Ctrl-C").unwrap().0.to_owned();
            }
            urls.push(line.strip_prefix("Open ").unwrap().strip_suffix(" in a browser.\n").unwrap().to_owned());
        };
        Ok(Self { child, output, url: urls.remove(0), place })
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Waits for the end of the program and returns its exit status.
    pub fn ended(&mut self) -> Option<i32> {
        self.child.wait().unwrap().code()
    }

    /// The UDP address that packets go to.
    pub fn packets_to(&self) -> SocketAddr {
        self.place.strip_prefix("UDP ").unwrap().parse().unwrap()
    }

    /// The host and port of the page.
    pub fn host(&self) -> &str {
        self.url.strip_prefix("http://").unwrap().split('/').next().unwrap()
    }

    /// The path of a part of the page, with the token if there is one.
    pub fn path(&self, part: &str) -> String {
        let (_, below) = self.url.strip_prefix("http://").unwrap().split_once('/').unwrap();
        format!("/{below}{part}")
    }

    pub fn connect(&self) -> TcpStream {
        let port = self.host().rsplit_once(':').unwrap().1.parse().unwrap();
        let stream = TcpStream::connect(SocketAddr::from(([127, 0, 0, 1], port))).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        stream
    }

    /// Sends a request for a path with these headers and returns the whole answer.
    pub fn get(&self, path: &str, headers: &str) -> String {
        let mut stream = self.connect();
        write!(stream, "GET {path} HTTP/1.1\r\n{headers}Connection: close\r\n\r\n").unwrap();
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).unwrap();
        String::from_utf8(answer).unwrap()
    }

    /// Requests a part of the page as a browser does.
    pub fn part(&self, part: &str) -> String {
        self.get(&self.path(part), &format!("Host: {}\r\n", self.host()))
    }

    /// Opens a stream of events on this machine.
    pub fn events(&self) -> EventLines {
        let mut stream = self.connect();
        let _ = write!(stream, "GET {} HTTP/1.1\r\nHost: localhost\r\n\r\n", self.path("api/1/events"));
        EventLines(BufReader::new(stream))
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The lines of a stream of events.
pub struct EventLines(BufReader<TcpStream>);

impl EventLines {
    /// Returns the first line of the answer.
    pub fn status(&mut self) -> String {
        let mut line = String::new();
        // A connection beyond the limit is reset.
        let _ = self.0.read_line(&mut line);
        line
    }

    /// Returns the next event.
    pub fn next(&mut self) -> serde_json::Value {
        loop {
            let mut line = String::new();
            assert!(self.0.read_line(&mut line).unwrap() > 0, "the stream ended");
            if let Some(data) = line.strip_prefix("data: ") {
                return serde_json::from_str(data).unwrap();
            }
        }
    }

    /// Returns the next event that fits.
    pub fn until(&mut self, fits: impl Fn(&serde_json::Value) -> bool) -> serde_json::Value {
        loop {
            let event = self.next();
            if fits(&event) {
                return event;
            }
        }
    }
}

/// Returns a live packet with these coefficients.
pub fn packet(coefficients: &[(&str, f32)]) -> Packet {
    let mut packet = Packet { state: State::Live, age_us: 20_000, ..Packet::NEUTRAL };
    for (name, value) in coefficients {
        packet.coefficients[BLENDSHAPES.iter().position(|known| known == name).unwrap()] = *value;
    }
    packet
}

/// Sends the same pose 60 times a second, as a sender does, until another pose replaces it.
pub struct Sending {
    poses: mpsc::Sender<Packet>,
}

impl Sending {
    pub fn to(address: SocketAddr, first: Packet) -> Self {
        let (poses, changes) = mpsc::channel();
        let socket = UdpSocket::bind(if address.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" }).unwrap();
        thread::spawn(move || {
            let mut packet = first;
            loop {
                socket.send_to(&packet.encode(), address).unwrap();
                let sequence = packet.sequence.wrapping_add(1);
                match changes.recv_timeout(Duration::from_micros(16_667)) {
                    Ok(next) => packet = next,
                    Err(mpsc::RecvTimeoutError::Timeout) => {}
                    Err(mpsc::RecvTimeoutError::Disconnected) => return,
                }
                packet.sequence = sequence;
            }
        });
        Self { poses }
    }

    pub fn show(&self, packet: Packet) {
        self.poses.send(packet).unwrap();
    }
}

/// Returns a line of `/proc/PID/status`, such as `VmRSS`, in KB.
pub fn memory_kb(pid: u32, key: &str) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let line = status.lines().find(|line| line.starts_with(key)).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}
