//! With locked memory no frame waits for a page: neither from a disk nor from the kernel's stock.
//!
//! The kernel counts page faults for each thread (`/proc/PID/task/TID/stat`, see `man 5 proc`).
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

use common::service::{Receiver, Service};
use facewire_packet::{Packet, State};
use rustix::process::Signal;

const LOCKED: &str = "[camera]\ndevice = \"demo\"\n[realtime]\nlock_memory = true\n";
/// Live packets before anything is counted: the camera's memory is there after the first.
const WARM_UP: usize = 30;
/// Live packets of one count.
const FRAMES: usize = 120;
/// Counts, of which one must be clean: the kernel may move a page of its own accord.
const COUNTS: usize = 3;

/// The folder of the thread of this name.
fn thread(service: &Service, name: &str) -> PathBuf {
    let threads = fs::read_dir(format!("/proc/{}/task", service.pid())).unwrap().map(|thread| thread.unwrap().path());
    let is_called = |thread: &PathBuf| fs::read_to_string(thread.join("comm")).is_ok_and(|found| found.trim() == name);
    threads.into_iter().find(is_called).unwrap_or_else(|| panic!("no thread {name}"))
}

/// Minor and major page faults of a thread so far: fields 10 and 12; the name, field 2, may have spaces.
fn faults(thread: &Path) -> [u64; 2] {
    let stat = fs::read_to_string(thread.join("stat")).unwrap();
    let fields: Vec<&str> = stat.rsplit_once(") ").unwrap().1.split(' ').collect();
    [10, 12].map(|field| fields[field - 3].parse().unwrap())
}

fn live_packets(receiver: &Receiver, count: usize) {
    (0..count).for_each(|_| _ = receiver.until(|packet: &Packet| packet.state == State::Live));
}

#[test]
fn frames_fault_no_page_where_memory_is_locked() {
    let receiver = Receiver::new();
    let service = Service::start(LOCKED, &[receiver.address()]);
    live_packets(&receiver, WARM_UP);
    let threads = ["fw-hot", "fw-sender"].map(|name| thread(&service, name));
    let counted = [(); COUNTS].map(|()| {
        let before = threads.each_ref().map(|thread| faults(thread));
        live_packets(&receiver, FRAMES);
        [before, threads.each_ref().map(|thread| faults(thread))]
    });
    let log = service.stop(Signal::TERM).0.succeeded().err;
    if !log.contains("INFO memory locked") {
        return common::skip(&format!("this machine locks no memory: {log}"));
    }
    assert!(counted.iter().any(|[before, after]| before == after), "hot and sender, minor and major: {counted:?}");
}

/// The count can fail: what a thread touches for the first time is seen in it.
#[test]
fn the_kernel_counts_the_pages_that_a_thread_touches_first() {
    let me = PathBuf::from("/proc/thread-self").canonicalize().unwrap();
    let before = faults(&me);
    let pages = vec![1_u8; 4 << 20];
    sleep(Duration::from_millis(1));
    assert!(faults(&me)[0] > before[0] + 100, "of {} bytes", pages.len());
}
