//! `facewire run` touches nothing that is not configured: no other address, no file for writing, no other program.
//!
//! The kernel's own record of its calls is read (strace), libraries of others included.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use common::program::{settings, text};
use common::service::Receiver;
use facewire_packet::State;
use rustix::process::{Pid, Signal, kill_process};

/// Calls that open, make, remove or rename something, start a program, or concern the network.
const CALLS: &str = "trace=%network,open,openat,openat2,creat,mkdir,mkdirat,unlink,unlinkat,rename,renameat2,execve";
/// What every program reads: its libraries, and what the system says of itself.
const SYSTEM: [&str; 7] = ["/lib", "/lib64", "/usr/lib", "/etc/ld.so", "/etc/localtime", "/proc", "/sys"];
/// Packets that are awaited once the face is live: ten seconds, past the first status line.
const PACKETS: usize = 300;

/// The calls of a service that played the built-in clip to the receiver, one a line; `None` where strace cannot trace.
fn traced(receiver: &Receiver, folder: &Path) -> Option<String> {
    let (record, log) = (folder.join("calls"), folder.join("log"));
    let toml = format!("[camera]\ndevice = \"demo\"\n[[link]]\naddress = \"{}\"\n", receiver.address());
    let settings = settings(&toml);
    let mut strace = Command::new("strace");
    strace.args(["-f", "-qq", "-s", "256", "-e", CALLS, "-o", text(&record), env!("CARGO_BIN_EXE_facewire")]);
    strace.args(["run", "--config", text(settings.path())]);
    // cargo points the loader to its build folders.
    strace.env_remove("LD_LIBRARY_PATH");
    let strace = strace.stdin(Stdio::null()).stderr(fs::File::create(&log).unwrap());
    let Ok(mut strace) = strace.spawn() else {
        common::skip("silence", "there is no strace");
        return None;
    };
    let Some(service) = child_of(&mut strace, &record) else {
        common::skip("silence", &format!("strace cannot trace here: {}", fs::read_to_string(&log).unwrap()));
        return None;
    };
    receiver.until(|packet| packet.state == State::Live);
    for _ in 0..PACKETS {
        receiver.packet();
    }
    kill_process(service, Signal::TERM).unwrap();
    assert!(strace.wait().unwrap().success(), "{}", fs::read_to_string(&log).unwrap());
    fs::read_to_string(record).ok()
}

/// The process that strace started, once it runs; none if strace ends without.
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

/// The path in a call, if it has one.
fn path_of(call: &str) -> Option<&str> {
    call.split('"').nth(1)
}

#[test]
fn run_speaks_to_its_receiver_only_and_writes_no_file() {
    let (receiver, folder) = (Receiver::new(), tempfile::tempdir().unwrap());
    let Some(record) = traced(&receiver, folder.path()) else { return };
    let networks = common::networks::installed();
    let calls: Vec<_> = record.lines().filter_map(|line| line.split_once(' ')).map(|(_, call)| call.trim()).collect();
    let to_receiver = format!("sin_port=htons({}), sin_addr=inet_addr(\"127.0.0.1\")", receiver.port());
    let mut sent = 0;
    for call in calls {
        let name = call.split('(').next().unwrap();
        let allowed = match name {
            "open" | "openat" => {
                let path = Path::new(path_of(call).unwrap());
                let known = SYSTEM.iter().any(|system| path.starts_with(system) || text(path).starts_with(system));
                let reads = !["O_WRONLY", "O_RDWR", "O_CREAT"].iter().any(|flag| call.contains(flag));
                let configured = path.starts_with(&networks) || path.extension().is_some_and(|ending| ending == "toml");
                reads && (known || configured)
            }
            "socket" => call.contains("AF_INET, SOCK_DGRAM"),
            "bind" => call.contains("sin_port=htons(0)"),
            "sendto" => {
                sent += 1;
                call.contains(&to_receiver)
            }
            "setsockopt" => call.contains("SO_BROADCAST"),
            "execve" => call.contains(env!("CARGO_BIN_EXE_facewire")),
            // A call that was interrupted in the record, or a signal: its beginning was judged.
            _ => call.starts_with("<...") || call.starts_with("---") || call.starts_with("+++"),
        };
        assert!(allowed, "not configured: {call}");
    }
    assert!(sent > PACKETS, "the record shows {sent} packets");
}
