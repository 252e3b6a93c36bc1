//! The service as a process, observed from outside.

use std::fs::{self, File};
use std::io::{BufRead as _, BufReader, Write as _};
use std::net::UdpSocket;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use facewire_packet::{PACKET_BYTES, Packet};
use rustix::process::{Pid, Signal, kill_process};
use tempfile::{NamedTempFile, TempDir};

use super::SERVICE;
use super::common::program::{settings, text};
use super::common::stuck::thread_called;

/// The threads that handle a frame.
const HOT_THREADS: [&str; 2] = ["fw-hot", "fw-sender"];
/// Fields of a thread's `stat`, counted after its name: minor and major page faults.
const FAULT_FIELDS: [usize; 2] = [7, 9];

/// A packet and when it came.
pub type Arrival = (Instant, Packet);

/// The service, with its log in a file and a receiver that never goes away.
pub struct Service {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    arrivals: Arc<Mutex<Vec<Arrival>>>,
    threads: [i32; 2],
    folder: TempDir,
    settings: NamedTempFile,
    /// The link to the receiver, as written in the settings.
    link: String,
}

/// Measurements of the process at one moment.
#[derive(Debug, Clone)]
pub struct Sample {
    pub at: Instant,
    /// Counts of the hot loop and the sender since they started.
    pub allocations: [u64; 2],
    pub page_faults: [u64; 2],
    pub resident_kib: u64,
    pub descriptors: usize,
}

impl Service {
    /// Starts the service with these settings and another link, to the receiver.
    pub fn start(toml: &str) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        let link = format!("[[link]]\naddress = \"{}\"\n", socket.local_addr().unwrap());
        let (settings, folder) = (settings(&(toml.to_owned() + &link)), tempfile::tempdir().unwrap());
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["run", "--config", text(settings.path())]).env(SERVICE, "1");
        let log = File::create(folder.path().join("log")).unwrap();
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(log).spawn().unwrap();
        let arrivals = Arc::default();
        collect(socket, &arrivals);
        let (requests, answers) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        let threads = HOT_THREADS.map(|name| thread_called(&mut child, name));
        Self { child, requests, answers, arrivals, threads, folder, settings, link }
    }

    /// Writes these settings with the link to the receiver, and tells the service to read them.
    pub fn change(&self, toml: &str) {
        fs::write(self.settings.path(), toml.to_owned() + &self.link).unwrap();
        kill_process(Pid::from_child(&self.child), Signal::HUP).unwrap();
    }

    /// Returns the number of the thread that runs the frames.
    pub fn hot_thread(&self) -> i32 {
        self.threads[0]
    }

    /// Returns the packets that came since the last call.
    pub fn packets(&mut self) -> Vec<Arrival> {
        std::mem::take(&mut self.arrivals.lock().unwrap())
    }

    pub fn sample(&mut self) -> Sample {
        self.requests.write_all(b"\n").unwrap();
        let mut answer = String::new();
        self.answers.read_line(&mut answer).unwrap();
        Sample {
            at: Instant::now(),
            allocations: self.threads.map(|thread| allocations(&answer, thread)),
            page_faults: self.threads.map(|thread| self.page_faults(thread)),
            resident_kib: self.resident_kib(),
            descriptors: fs::read_dir(self.proc("fd")).unwrap().count(),
        }
    }

    /// Stops the service. Returns the packets that came meanwhile, and the log.
    pub fn stop(mut self) -> (Vec<Arrival>, String) {
        kill_process(Pid::from_child(&self.child), Signal::TERM).unwrap();
        let status = self.child.wait().unwrap();
        thread::sleep(Duration::from_millis(300));
        let log = fs::read_to_string(self.folder.path().join("log")).unwrap();
        assert!(status.success(), "{log}");
        (self.packets(), log)
    }

    fn proc(&self, what: &str) -> String {
        format!("/proc/{}/{what}", self.child.id())
    }

    fn page_faults(&self, thread: i32) -> u64 {
        let stat = fs::read_to_string(self.proc(&format!("task/{thread}/stat"))).unwrap();
        let fields: Vec<&str> = stat.rsplit_once(')').unwrap().1.split_whitespace().collect();
        FAULT_FIELDS.iter().map(|field| fields[*field].parse::<u64>().unwrap()).sum()
    }

    fn resident_kib(&self) -> u64 {
        let status = fs::read_to_string(self.proc("status")).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).unwrap();
        line.trim().trim_end_matches(" kB").parse().unwrap()
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if thread::panicking() {
            let log = fs::read_to_string(self.folder.path().join("log")).unwrap_or_default();
            let lines: Vec<&str> = log.lines().rev().take(20).collect();
            eprintln!("the end of the service's log, newest first:\n{}", lines.join("\n"));
        }
    }
}

/// Collects valid packets until the test ends.
fn collect(socket: UdpSocket, arrivals: &Arc<Mutex<Vec<Arrival>>>) {
    let arrivals = Arc::clone(arrivals);
    thread::spawn(move || {
        let mut bytes = [0; PACKET_BYTES + 1];
        while let Ok((length, _)) = socket.recv_from(&mut bytes) {
            let packet = Packet::decode(&bytes[..length]).unwrap();
            arrivals.lock().unwrap().push((Instant::now(), packet));
        }
    });
}

/// Returns how often the thread has allocated memory, from an answer of the service.
fn allocations(answer: &str, thread: i32) -> u64 {
    let wanted = thread.to_string();
    let mut pairs = answer.split_whitespace().filter_map(|pair| pair.split_once(':'));
    pairs.find(|(thread, _)| *thread == wanted).map_or(0, |(_, count)| count.parse().unwrap())
}
