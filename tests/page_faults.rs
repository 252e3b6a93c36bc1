//! With locked memory, no frame waits for a page, whether the page is on a disk or has never been touched.
//!
//! The kernel tells which memory of a process is locked and resident (`/proc/PID/smaps`), and how many page faults each
//! of its threads has had (`/proc/PID/task/TID/stat`); see `man 5 proc`.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::fs;
use std::hint::black_box;
use std::path::{Path, PathBuf};

use common::service::{Receiver, Service};
use facewire_packet::{Packet, State};
use rustix::process::Signal;

const LOCKED: &str = "[camera]\ndevice = \"demo\"\n[realtime]\nlock_memory = true\n";
/// Live packets before anything is counted. The camera's memory is allocated with its first frame.
const WARM_UP: usize = 30;
/// Live packets of one count: as many as come in a second and a half.
const FRAMES: usize = 40;
/// Counts, of which one may show minor faults, because the kernel may move a page of its own accord.
const COUNTS: usize = 9;

/// Returns the folder of the service's thread of this name.
fn thread(service: &Service, name: &str) -> PathBuf {
    let threads = fs::read_dir(format!("/proc/{}/task", service.pid())).unwrap().map(|thread| thread.unwrap().path());
    let is_called = |thread: &PathBuf| fs::read_to_string(thread.join("comm")).is_ok_and(|found| found.trim() == name);
    threads.into_iter().find(is_called).unwrap_or_else(|| panic!("no thread {name}"))
}

/// Page faults of a thread so far.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PageFaults {
    minor: u64,
    major: u64,
}

impl PageFaults {
    fn of(thread: &Path) -> Self {
        let stat = fs::read_to_string(thread.join("stat")).unwrap();
        // Field 2, the name, may have spaces.
        let fields: Vec<&str> = stat.rsplit_once(") ").unwrap().1.split(' ').collect();
        let [minor, major] = [10, 12].map(|field| fields[field - 3].parse().unwrap());
        Self { minor, major }
    }
}

/// A part of a process's memory.
#[derive(Debug, Default)]
struct Mapping {
    /// Addresses, permissions and file.
    header: String,
    size: String,
    resident: String,
    flags: String,
}

impl Mapping {
    fn all_of(pid: u32) -> Vec<Self> {
        let mut mappings: Vec<Self> = Vec::new();
        for line in fs::read_to_string(format!("/proc/{pid}/smaps")).unwrap().lines() {
            let Some((key, value)) = line.split_once(": ").filter(|(key, _)| !key.contains(' ')) else {
                mappings.push(Self { header: line.to_owned(), ..Self::default() });
                continue;
            };
            let mapping = mappings.last_mut().unwrap();
            match key {
                "Size" => value.trim().clone_into(&mut mapping.size),
                "Rss" => value.trim().clone_into(&mut mapping.resident),
                "VmFlags" => value.clone_into(&mut mapping.flags),
                _ => {}
            }
        }
        mappings
    }

    /// Whether the process may use this memory and has mapped it itself, unlike [vdso] and [vvar].
    fn is_used(&self) -> bool {
        !self.header.contains(" ---p ") && !self.header.contains("[v")
    }

    fn is_locked_and_resident(&self) -> bool {
        self.flags.split(' ').any(|flag| flag == "lo") && self.resident == self.size
    }
}

/// Waits until so many live packets have come.
fn live_packets(receiver: &Receiver, count: usize) {
    (0..count).for_each(|_| _ = receiver.until(|packet: &Packet| packet.state == State::Live));
}

#[test]
fn locked_memory_is_all_resident_and_frames_fault_no_page() {
    let receiver = Receiver::new();
    let service = Service::start(LOCKED, &[receiver.address()]);
    live_packets(&receiver, WARM_UP);
    let mappings: Vec<Mapping> = Mapping::all_of(service.pid()).into_iter().filter(Mapping::is_used).collect();
    let threads = ["fw-hot", "fw-sender"].map(|name| thread(&service, name));
    let counted = [(); COUNTS].map(|()| {
        let before = threads.each_ref().map(|thread| PageFaults::of(thread));
        live_packets(&receiver, FRAMES);
        [before, threads.each_ref().map(|thread| PageFaults::of(thread))]
    });
    let log = service.stop(Signal::TERM).0.succeeded().err;
    if !log.contains("INFO memory locked") {
        return common::skip(&format!("this machine locks no memory: {log}"));
    }
    assert!(mappings.len() > 20, "{mappings:?}");
    let unlocked: Vec<&Mapping> = mappings.iter().filter(|mapping| !mapping.is_locked_and_resident()).collect();
    assert!(unlocked.is_empty(), "memory that may fault: {unlocked:?}");
    let major =
        |[before, after]: &[[PageFaults; 2]; 2]| [0, 1].map(|thread| after[thread].major - before[thread].major);
    assert!(counted.iter().all(|count| major(count) == [0, 0]), "hot and sender: {counted:?}");
    let clean = counted.iter().filter(|[before, after]| before == after).count();
    assert!(clean + 1 >= COUNTS, "hot and sender: {counted:?}");
}

/// The count can fail: it shows the pages that a thread touches for the first time.
#[test]
fn the_kernel_counts_the_pages_that_a_thread_touches_first() {
    let me = PathBuf::from("/proc/thread-self").canonicalize().unwrap();
    let before = PageFaults::of(&me);
    let pages = vec![1_u8; 4 << 20];
    assert!(PageFaults::of(&me).minor > before.minor + 100, "of {} bytes", black_box(pages).len());
}
