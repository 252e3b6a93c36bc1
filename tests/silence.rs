//! `facewire run` uses nothing that is not configured: no other address, no file for writing, no other program.
//!
//! strace records the calls of the whole process, of libraries too.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod board;
mod common;

use std::fs;
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use board::{Board, eventually};
use common::program::{settings, text};
use common::service::Receiver;
use facewire_packet::State;
use rustix::process::{Pid, Signal, kill_process};
use tempfile::TempDir;

/// Calls that open, make, remove or rename a file, start a program, or use the network.
const CALLS: &str = "trace=%network,open,openat,openat2,creat,mkdir,mkdirat,unlink,unlinkat,rename,renameat2,execve";
/// Files that every program reads: its libraries, and facts about the system.
const SYSTEM: [&str; 7] = ["/lib", "/lib64", "/usr/lib", "/etc/ld.so", "/etc/localtime", "/proc", "/sys"];
/// How many packets to wait for once the face is live. They take ten seconds, in which the first status line is written.
const PACKETS: usize = 300;

/// A service under strace.
struct Traced {
    strace: Child,
    service: Pid,
    folder: TempDir,
}

impl Traced {
    /// Starts the service. Returns `None` if strace cannot trace it.
    fn start(settings: &Path, manager: Option<&Path>) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let (record, log) = (folder.path().join("calls"), folder.path().join("log"));
        let mut strace = Command::new("strace");
        strace.args(["-f", "-qq", "-s", "256", "-e", CALLS, "-o", text(&record), env!("CARGO_BIN_EXE_facewire")]);
        strace.args(["run", "--config", text(settings)]);
        // cargo sets it, so that the loader searches the build folders, too.
        strace.env_remove("LD_LIBRARY_PATH");
        strace.envs(manager.map(|socket| ("NOTIFY_SOCKET", socket)));
        let strace = strace.stdin(Stdio::null()).stderr(fs::File::create(&log).unwrap());
        let Ok(mut strace) = strace.spawn() else {
            common::skip("there is no strace");
            return None;
        };
        let Some(service) = child_of(&mut strace, &record) else {
            common::skip(&format!("strace cannot trace here: {}", fs::read_to_string(&log).unwrap()));
            return None;
        };
        Some(Self { strace, service, folder })
    }

    fn signal(&self, signal: Signal) {
        kill_process(self.service, signal).unwrap();
    }

    /// Stops the service and returns its calls. The second halves of interrupted calls are left out.
    fn calls(mut self) -> Vec<Call> {
        self.signal(Signal::TERM);
        let ended = self.strace.wait().unwrap();
        assert!(ended.success(), "{}", fs::read_to_string(self.folder.path().join("log")).unwrap());
        let record = fs::read_to_string(self.folder.path().join("calls")).unwrap();
        let calls = record.lines().filter_map(|line| line.split_once(' ')).map(|(_, call)| call.trim());
        let calls = calls.filter(|call| !["<...", "---", "+++"].iter().any(|other| call.starts_with(other)));
        calls.map(|call| Call(call.to_owned())).collect()
    }
}

/// A line of strace's record.
struct Call(String);

impl Call {
    fn name(&self) -> &str {
        self.0.split('(').next().unwrap()
    }

    /// Returns the first path among the arguments.
    fn path(&self) -> Option<&Path> {
        self.0.split('"').nth(1).map(Path::new)
    }

    fn says(&self, part: &str) -> bool {
        self.0.contains(part)
    }

    /// Whether the call reads a file that every service reads: one of the system, the networks, the built-in clip, or the
    /// settings.
    fn reads_what_is_known(&self, settings: &Path) -> bool {
        let path = self.path().unwrap();
        let known = SYSTEM.iter().any(|system| path.starts_with(system) || text(path).starts_with(system));
        let reads = !["O_WRONLY", "O_RDWR", "O_CREAT"].iter().any(|flag| self.says(flag));
        reads
            && (known
                || path.starts_with(common::networks::installed())
                || path == settings
                || path.ends_with("src/capture/demo.avi"))
    }
}

/// Waits for the process that strace starts. Returns `None` if strace ends without starting one.
fn child_of(strace: &mut Child, record: &Path) -> Option<Pid> {
    let children = format!("/proc/{0}/task/{0}/children", strace.id());
    loop {
        let begun = fs::metadata(record).is_ok_and(|record| record.len() > 0);
        let child = fs::read_to_string(&children).ok().and_then(|pids| pids.split_whitespace().next()?.parse().ok());
        if let (true, Some(child)) = (begun, child) {
            return Pid::from_raw(child);
        }
        if strace.try_wait().unwrap().is_some() {
            return None;
        }
    }
}

#[test]
fn run_speaks_to_its_receiver_only_and_writes_no_file() {
    let receiver = Receiver::new();
    let settings = settings(&format!("[camera]\ndevice = \"demo\"\n[[link]]\naddress = \"{}\"\n", receiver.address()));
    let Some(service) = Traced::start(settings.path(), None) else { return };
    receiver.until(|packet| packet.state == State::Live);
    for _ in 0..PACKETS {
        receiver.packet();
    }
    let to_receiver = format!("sin_port=htons({}), sin_addr=inet_addr(\"127.0.0.1\")", receiver.port());
    let mut sent = 0;
    for call in service.calls() {
        let allowed = match call.name() {
            "open" | "openat" => call.reads_what_is_known(settings.path()),
            "socket" => call.says("AF_INET, SOCK_DGRAM"),
            "bind" => call.says("sin_port=htons(0)"),
            "sendto" => {
                sent += 1;
                call.says(&to_receiver)
            }
            "setsockopt" => call.says("SO_BROADCAST"),
            "execve" => call.says(env!("CARGO_BIN_EXE_facewire")),
            _ => false,
        };
        assert!(allowed, "not configured: {}", call.0);
    }
    assert!(sent > PACKETS, "strace recorded {sent} packets");
}

/// Configures everything else: a serial line, metrics, a service manager, and settings that change.
#[test]
fn run_with_a_serial_line_metrics_and_a_manager_opens_these_only() {
    let (mut board, folder) = (Board::plugged_in(), tempfile::tempdir().unwrap());
    let [manager, metrics] = ["manager", "metrics"].map(|name| folder.path().join(name));
    let _manager = UnixDatagram::bind(&manager).unwrap();
    let toml = |fps: u32| {
        let link = format!("[[link]]\nkind = \"serial\"\ndevice = \"{}\"\n", text(&board.device));
        let metrics = format!("[metrics]\nlisten = \"unix:{}\"\n", text(&metrics));
        format!("[camera]\ndevice = \"demo\"\nfps = {fps}\n{metrics}{link}")
    };
    let (first, changed) = (toml(30), toml(25));
    let settings = settings(&first);
    let Some(service) = Traced::start(settings.path(), Some(&manager)) else { return };
    board.next();
    eventually("metrics", || UnixStream::connect(&metrics).is_ok());
    fs::write(settings.path(), changed).unwrap();
    service.signal(Signal::HUP);
    (0..100).for_each(|_| _ = board.next());
    let mut opened = 0;
    for call in service.calls() {
        let is_at = |path: &Path| call.path() == Some(path);
        let allowed = match call.name() {
            "open" | "openat" if is_at(&board.device) => {
                opened += 1;
                true
            }
            "open" | "openat" => call.reads_what_is_known(settings.path()),
            "socket" => call.says("AF_UNIX, SOCK_DGRAM") || call.says("AF_UNIX, SOCK_STREAM"),
            "bind" | "unlink" => is_at(&metrics),
            // Without an address, the data go to the peer of a connected socket, which is a reader of the metrics.
            "sendto" if call.says(", NULL, 0") => true,
            "connect" | "sendto" | "sendmsg" => is_at(&manager),
            "listen" | "accept4" | "setsockopt" | "recvfrom" | "recv" => true,
            "execve" => call.says(env!("CARGO_BIN_EXE_facewire")),
            _ => false,
        };
        assert!(allowed, "not configured: {}", call.0);
    }
    assert!(opened > 0, "strace did not record the serial line");
}
