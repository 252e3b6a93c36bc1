//! `facewire run` uses nothing that is not configured: no other address, no file for writing, no other program.
//!
//! strace records the calls of the whole process, of libraries too.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::path::Path;
use std::process::{Child, Command};

use common::board::Board;
use common::program::text;
use common::service::{DEMO, Receiver, Service};
use common::{eventually, skip};
use rustix::process::{Pid, Signal, kill_process};
use tempfile::NamedTempFile;

/// Calls that open, make, remove or rename a file, start a program, or use the network.
const CALLS: &str = "trace=%network,open,openat,openat2,creat,mkdir,mkdirat,unlink,unlinkat,rename,renameat2,execve";
/// Files that every program reads: its libraries, and facts about the system.
const SYSTEM: [&str; 7] = ["/lib", "/lib64", "/usr/lib", "/etc/ld.so", "/etc/localtime", "/proc", "/sys"];
/// How many packets to wait for once the face is live. They take four seconds, in which the service does all that it does again
/// and again, except for the status line, which is asked for.
const PACKETS: usize = 120;
/// strace may delay a frame for seconds.
const PATIENT: &str = "[failsafe]\nlive_ms = 5000\nhold_ms = 6000\nneutral_ms = 7000\n";

struct Traced {
    strace: Service,
    service: Pid,
    record: NamedTempFile,
}

impl Traced {
    /// Starts the service under strace. Returns `None` if strace cannot trace it.
    fn start(toml: &str, addresses: &[String], manager: Option<&Path>) -> Option<Self> {
        if Command::new("strace").arg("-V").output().is_err() {
            skip("there is no strace");
            return None;
        }
        let (record, mut command) = (NamedTempFile::new().unwrap(), Command::new("strace"));
        command.args(["-f", "-qq", "-s", "256", "-e", CALLS, "-o", text(record.path())]);
        // cargo sets the variable, so that the loader searches the build folders, too.
        command.arg(env!("CARGO_BIN_EXE_facewire")).env_remove("LD_LIBRARY_PATH");
        command.envs(manager.map(|socket| ("NOTIFY_SOCKET", socket)));
        let mut strace = Service::of(command, toml, addresses, |command| command);
        let Some(service) = child_of(&mut strace.child, record.path()) else {
            skip(&format!("strace cannot trace here: {}", strace.log()));
            return None;
        };
        Some(Self { strace, service, record })
    }

    fn signal(&self, signal: Signal) {
        kill_process(self.service, signal).unwrap();
    }

    /// Stops the service, and fails the test at the first call that is not allowed. The second halves of interrupted calls
    /// are left out, and what strace could not read of a thread that ended meanwhile.
    fn assert_calls(mut self, mut is_allowed: impl FnMut(&Call) -> bool) {
        self.signal(Signal::TERM);
        assert!(self.strace.child.wait().unwrap().success(), "{}", self.strace.log());
        let record = fs::read_to_string(self.record.path()).unwrap();
        let calls = record.lines().filter_map(|line| Some(line.split_once(' ')?.1.trim()));
        for call in calls.filter(|call| !["<...", "---", "+++", "???("].iter().any(|other| call.starts_with(other))) {
            assert!(is_allowed(&Call(call)), "not configured: {call}");
        }
    }
}

struct Call<'a>(&'a str);

impl Call<'_> {
    fn name(&self) -> &str {
        self.0.split('(').next().unwrap()
    }

    fn is_at(&self, path: &Path) -> bool {
        self.0.split('"').nth(1).map(Path::new) == Some(path)
    }

    /// The port of its address.
    fn port(&self) -> Option<String> {
        let (_, rest) = self.0.split_once("sin_port=htons(")?;
        Some(rest.split(')').next()?.to_owned())
    }

    fn says(&self, part: &str) -> bool {
        self.0.contains(part)
    }

    /// Whether the call reads a file that every service reads: one of the system, the networks, the built-in clip, or the
    /// settings.
    fn reads_what_is_known(&self, settings: &Path) -> bool {
        let path = Path::new(self.0.split('"').nth(1).unwrap());
        let is_system = SYSTEM.iter().any(|system| text(path).starts_with(system));
        let is_known = is_system || path == settings || path.ends_with("src/capture/demo.avi");
        let reads = !["O_WRONLY", "O_RDWR", "O_CREAT"].iter().any(|flag| self.says(flag));
        reads && (is_known || path.starts_with(common::networks::installed()))
    }
}

/// Waits for the process that strace starts. Returns `None` if strace ends without starting one.
fn child_of(strace: &mut Child, record: &Path) -> Option<Pid> {
    let children = format!("/proc/{0}/task/{0}/children", strace.id());
    while strace.try_wait().unwrap().is_none() {
        // Before strace records anything, it starts children of its own to find out what it can trace.
        let has_begun = fs::metadata(record).is_ok_and(|record| record.len() > 0);
        let child = fs::read_to_string(&children).ok().and_then(|pids| pids.split_whitespace().next()?.parse().ok());
        if has_begun && child.is_some() {
            return Pid::from_raw(child?);
        }
    }
    None
}

#[test]
fn run_speaks_to_its_receiver_only_and_writes_no_file() {
    let receiver = Receiver::new();
    let Some(service) = Traced::start(&[DEMO, PATIENT].concat(), &[receiver.address()], None) else { return };
    let settings = service.strace.settings();
    receiver.live();
    service.signal(Signal::USR1);
    service.strace.await_log(" cameras_opened=");
    (0..PACKETS).for_each(|_| _ = receiver.packet());
    let to_receiver = format!("sin_port=htons({}), sin_addr=inet_addr(\"127.0.0.1\")", receiver.port());
    let mut sent = 0;
    let mut own_port = None;
    service.assert_calls(|call| match call.name() {
        "open" | "openat" => call.reads_what_is_known(&settings),
        "socket" => call.says("AF_INET, SOCK_DGRAM"),
        "getsockname" => {
            own_port = call.port();
            true
        }
        // What comes back from the receiver arrives at a second socket with the port of the first.
        "bind" => call.says("sin_port=htons(0)") || (own_port.is_some() && call.port() == own_port),
        "connect" => call.says(&to_receiver),
        "recvfrom" | "recv" | "getsockopt" => true,
        "sendto" => {
            sent += 1;
            call.says(&to_receiver)
        }
        "setsockopt" => call.says("SO_BROADCAST") || call.says("SO_REUSEADDR"),
        "execve" => call.says(env!("CARGO_BIN_EXE_facewire")),
        _ => false,
    });
    assert!(sent > PACKETS, "strace recorded {sent} packets");
}

/// Configures everything else: a serial line, metrics, a service manager, and settings that change.
#[test]
fn run_with_a_serial_line_metrics_and_a_manager_opens_these_only() {
    let (mut board, folder) = (Board::plugged_in(), tempfile::tempdir().unwrap());
    let [manager, metrics] = ["manager", "metrics"].map(|name| folder.path().join(name));
    let _manager = UnixDatagram::bind(&manager).unwrap();
    let toml = |fps: u32| {
        let (device, socket) = (text(&board.device), text(&metrics));
        let link = format!("[[link]]\nkind = \"serial\"\ndevice = \"{device}\"\n");
        format!("{DEMO}fps = {fps}\n[metrics]\nlisten = \"unix:{socket}\"\n{link}")
    };
    let (first, changed) = (toml(30), toml(25));
    let Some(service) = Traced::start(&first, &[], Some(&manager)) else { return };
    let settings = service.strace.settings();
    board.next();
    eventually("metrics", || UnixStream::connect(&metrics).is_ok());
    fs::write(&settings, changed).unwrap();
    service.signal(Signal::HUP);
    (0..100).for_each(|_| _ = board.next());
    let mut opened = 0;
    service.assert_calls(|call| match call.name() {
        "open" | "openat" if call.is_at(&board.device) => {
            opened += 1;
            true
        }
        "open" | "openat" => call.reads_what_is_known(&settings),
        "socket" => call.says("AF_UNIX, SOCK_DGRAM") || call.says("AF_UNIX, SOCK_STREAM"),
        "bind" | "unlink" => call.is_at(&metrics),
        // Without an address, the data go to the peer of a connected socket, which is a reader of the metrics.
        "sendto" if call.says(", NULL, 0") => true,
        "connect" | "sendto" | "sendmsg" => call.is_at(&manager),
        "listen" | "accept4" | "setsockopt" | "recvfrom" | "recv" => true,
        "execve" => call.says(env!("CARGO_BIN_EXE_facewire")),
        _ => false,
    });
    assert!(opened > 0, "strace did not record the serial line");
}
