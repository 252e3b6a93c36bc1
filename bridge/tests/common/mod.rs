//! The bridge, simulated boards, and a broker.
#![allow(dead_code, reason = "each file of tests uses a part")]

#[path = "../../../tests/common/eventually.rs"]
mod eventually;
#[path = "../../../tests/common/ports.rs"]
pub mod ports;
#[path = "../../../tests/common/skip.rs"]
pub mod skip;

use std::{
    fs,
    io::{BufRead as _, BufReader, Read},
    net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, channel},
    },
    thread,
    time::{Duration, Instant},
};

use facewire_packet::{BLENDSHAPES, Packet, Reason, State};
use serde_json::Value;

#[allow(unused_imports, reason = "each file of tests uses a part")]
pub use self::eventually::{PATIENCE, eventually};
use self::ports::{HeldPort, udp_port_of};

/// How to get what tests need.
pub const SETUP: &str = "run scripts/setup tests";
/// A program whose lines of output are kept, and which ends with its test.
pub struct Program {
    pub child: Child,
    lines: Receiver<String>,
    pub seen: Vec<String>,
}

impl Program {
    /// Starts a program and reads what it writes to standard output and standard error.
    pub fn start(command: &mut Command) -> Self {
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let (sender, lines) = channel();
        let outputs: [Box<dyn Read + Send>; 2] =
            [Box::new(child.stdout.take().unwrap()), Box::new(child.stderr.take().unwrap())];
        for output in outputs {
            let sender = sender.clone();
            thread::spawn(move || {
                for line in BufReader::new(output).lines().map_while(Result::ok) {
                    if sender.send(line).is_err() {
                        return;
                    }
                }
            });
        }
        Self { child, lines, seen: Vec::new() }
    }

    /// Waits for a line that this finds something in.
    pub fn wait_for<T>(&mut self, what: &str, find: impl Fn(&str) -> Option<T>) -> T {
        let end = Instant::now() + PATIENCE;
        loop {
            let Ok(line) = self.lines.recv_timeout(end.saturating_duration_since(Instant::now())) else {
                panic!("no {what} in\n{}", self.seen.join("\n"));
            };
            let found = find(&line);
            self.seen.push(line);
            if let Some(found) = found {
                return found;
            }
        }
    }

    /// Waits for a line that contains this.
    pub fn wait_for_text(&mut self, text: &str) {
        self.wait_for(text, |line| line.contains(text).then_some(()));
    }

    pub fn read_for(&mut self, time: Duration) {
        let end = Instant::now() + time;
        while let Ok(line) = self.lines.recv_timeout(end.saturating_duration_since(Instant::now())) {
            self.seen.push(line);
        }
    }

    pub fn signal(&self, name: &str) {
        let status = Command::new("kill").args([&format!("-{name}"), &self.child.id().to_string()]).status();
        assert!(status.unwrap().success());
    }

    pub fn ends(&mut self) -> ExitStatus {
        self.child.wait().unwrap()
    }

    /// The memory that the program occupies.
    pub fn resident_kb(&self) -> u64 {
        let status = fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The bridge, at a port that the system chooses.
pub struct Bridge {
    pub program: Program,
}

impl Bridge {
    pub fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_facewire-bridge"));
        command.args(["--udp", "127.0.0.1:0"]).args(arguments);
        Self { program: Program::start(&mut command) }
    }

    /// The port at which the bridge receives, once it does.
    pub fn port(&self) -> u16 {
        udp_port_of(self.program.child.id())
    }

    pub fn board(&self, last: u8) -> Board {
        Board::new(last, self.port())
    }

    /// Waits until the bridge has read all that has come to its port.
    pub fn reads_all(&self) {
        let address = format!("0100007F:{:04X}", self.port());
        eventually("that the bridge reads", || {
            let table = fs::read_to_string("/proc/net/udp").unwrap();
            let line = table.lines().find(|line| line.contains(&address)).unwrap();
            // What is still to be sent, and what is still to be read, bytes.
            line.split_whitespace().nth(4) == Some("00000000:00000000")
        });
    }
}

/// A simulated board with the address 127.0.1.x.
pub struct Board {
    socket: UdpSocket,
    to: SocketAddr,
    pub packet: Packet,
}

impl Board {
    pub fn new(last: u8, port: u16) -> Self {
        let socket = UdpSocket::bind((Ipv4Addr::new(127, 0, 1, last), 0)).unwrap();
        let packet = Packet { state: State::Live, reason: Reason::None, age_us: 20_000, ..Packet::NEUTRAL };
        Self { socket, to: (Ipv4Addr::LOCALHOST, port).into(), packet }
    }

    pub fn set(&mut self, shape: &str, value: f32) {
        self.packet.coefficients[BLENDSHAPES.iter().position(|known| *known == shape).unwrap()] = value;
    }

    pub fn send(&mut self) {
        self.packet.sequence = self.packet.sequence.wrapping_add(1);
        self.send_bytes(&self.packet.encode());
    }

    pub fn send_bytes(&self, bytes: &[u8]) {
        // Once the bridge has ended, the system reports that nobody listens.
        let _ = self.socket.send_to(bytes, self.to);
    }
}

/// Boards that send 60 times a second until this is dropped.
pub struct Sending(Arc<AtomicBool>, Option<thread::JoinHandle<()>>);

pub fn sending(mut boards: Vec<Board>) -> Sending {
    let is_over = Arc::new(AtomicBool::new(false));
    let watched = Arc::clone(&is_over);
    let send = move || {
        while !watched.load(Ordering::Relaxed) {
            boards.iter_mut().for_each(Board::send);
            thread::sleep(Duration::from_micros(16_667));
        }
    };
    Sending(is_over, Some(thread::spawn(send)))
}

impl Drop for Sending {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
        if let Some(thread) = self.1.take() {
            thread.join().unwrap();
        }
    }
}

/// A broker with its files.
pub struct Broker {
    pub folder: tempfile::TempDir,
    port: HeldPort,
    program: Option<Program>,
}

impl Broker {
    /// Starts mosquitto, or notes that it is not there.
    pub fn start() -> Option<Self> {
        let mut broker = Self::absent()?;
        broker.come();
        Some(broker)
    }

    /// A broker that is yet to come.
    pub fn absent() -> Option<Self> {
        if mosquitto().is_none() {
            skip::skip("mosquitto and mosquitto-clients are not there: run scripts/setup tests");
            return None;
        }
        let broker = Self { folder: tempfile::tempdir().unwrap(), port: HeldPort::new(), program: None };
        broker.configure("allow_anonymous true\n");
        Some(broker)
    }

    pub fn configure(&self, lines: &str) {
        let text = format!("listener {} 127.0.0.1\nuser root\n{lines}", self.port());
        fs::write(self.folder.path().join("mosquitto.conf"), text).unwrap();
    }

    pub fn come(&mut self) {
        let mut command = Command::new(mosquitto().unwrap());
        self.program = Some(Program::start(command.arg("-c").arg(self.folder.path().join("mosquitto.conf"))));
        eventually("mosquitto", || TcpStream::connect(self.port.address()).is_ok());
    }

    pub fn signal(&self, name: &str) {
        self.program.as_ref().unwrap().signal(name);
    }

    pub fn go(&mut self) {
        self.program = None;
    }

    pub fn port(&self) -> u16 {
        self.port.address().port()
    }

    pub fn address(&self) -> String {
        self.port.address().to_string()
    }

    /// Subscribes to topics with mosquitto's own client, and waits until it has done so.
    pub fn subscribe(&self, topic: &str) -> Program {
        // Into a pipe it writes whole blocks otherwise.
        let mut command = Command::new("stdbuf");
        command.args(["-oL", "mosquitto_sub", "-h", "127.0.0.1", "-p", &self.port().to_string(), "-t", topic]);
        command.args(["-F", "%r %t %p", "-d"]);
        let mut program = Program::start(&mut command);
        program.wait_for_text("received SUBACK");
        program
    }

    pub fn publish(&self, topic: &str, payload: &str, options: &[&str]) {
        let mut command = Command::new("mosquitto_pub");
        command.args(["-h", "127.0.0.1", "-p", &self.port().to_string(), "-t", topic, "-m", payload]).args(options);
        assert!(command.status().unwrap().success());
    }
}

/// Debian puts the broker where only root looks.
fn mosquitto() -> Option<PathBuf> {
    let works = |program: &&str| Command::new(program).arg("-h").output().is_ok();
    let program = ["mosquitto", "/usr/sbin/mosquitto"].into_iter().find(works)?;
    works(&"mosquitto_sub").then(|| program.into())
}

impl Program {
    /// Waits for a message to a topic, whose payload this accepts. The lines are those of [`Broker::subscribe`].
    pub fn wait_for_message(&mut self, topic: &str, accepts: impl Fn(&str) -> bool) -> String {
        self.wait_for(topic, |line| {
            let (found, payload) = message(line)?;
            (found == topic && accepts(payload)).then(|| payload.to_owned())
        })
    }

    /// The payloads that have come to a topic so far.
    pub fn payloads(&self, topic: &str) -> Vec<&str> {
        let messages = self.seen.iter().filter_map(|line| message(line));
        messages.filter(|(found, _)| *found == topic).map(|(_, payload)| payload).collect()
    }

    pub fn wait_for_json(&mut self, topic: &str, accepts: impl Fn(&Value) -> bool) -> Value {
        let parsed = |payload: &str| serde_json::from_str::<Value>(payload).ok();
        let payload = self.wait_for_message(topic, |payload| parsed(payload).is_some_and(|value| accepts(&value)));
        serde_json::from_str(&payload).unwrap()
    }
}

/// The topic and the payload of a line of [`Broker::subscribe`]. Other lines have topics that nobody asks for.
fn message(line: &str) -> Option<(&str, &str)> {
    let (_retained, rest) = line.split_once(' ')?;
    rest.split_once(' ')
}

/// The Python of `scripts/setup`, if it has these libraries of other implementations.
pub fn python(libraries: &str, remedy: &str) -> Option<PathBuf> {
    let cache = std::env::var_os("XDG_CACHE_HOME").map(PathBuf::from);
    let cache = cache.or_else(|| Some(PathBuf::from(std::env::var_os("HOME")?).join(".cache")))?;
    let python = cache.join("facewire/venv-tests/bin/python");
    let imported = Command::new(&python).args(["-c", &format!("import {libraries}")]).output();
    if imported.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    skip::skip(&format!("Python cannot import {libraries}: {remedy}"));
    None
}

/// A Python program of these tests.
pub fn listener(python: &Path, arguments: &[&str]) -> Program {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/listen.py");
    Program::start(Command::new(python).arg(script).args(arguments))
}
