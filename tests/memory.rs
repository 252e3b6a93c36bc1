//! `facewire run` allocates no memory for a frame, holds little memory in all, and with locked memory waits for no page,
//! whether the page is on a disk or has never been touched.
//!
//! A preloaded library (`tests/hooks/allocations.c`) counts the calls that allocate or free memory in every thread, those of
//! C code included. The tests build it with the C compiler that also builds libjpeg-turbo. The kernel tells which memory of
//! a process is locked and resident (`/proc/PID/smaps`), and how many page faults each of its threads has had
//! (`/proc/PID/task/TID/stat`); see `man 5 proc`.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::Command;

use common::service::{DEMO, Receiver, Service};
use common::{eventually, project};
use rustix::process::Signal;
use tempfile::TempDir;

/// Live packets before the count begins. The first frame of the camera allocates the camera's memory.
const WARM_UP: usize = 30;
/// Frames that are counted. The clip has 240, so it starts over in between.
const FRAMES: usize = 300;
/// Functions of libjpeg-turbo that allocate and free memory for each image. Which of them call the C library depends on what
/// the compiler inlines. A program that decodes into planes with libjpeg-turbo cannot avoid these calls.
const JPEG_FUNCTIONS: &str = "alloc_small alloc_large free_pool jpeg_get_small jpeg_get_large jpeg_free_small \
                              jpeg_free_large tj3DecompressToYUVPlanes8";
/// The number of calls that these functions make for an image of three components.
const JPEG_CALLS: usize = 14;
const MAX_KIB: usize = 30_000_000 / 1024;
/// Leaves 8 of the 30 MB to pages of files, such as the program. An unoptimised build has more of them than a package.
const MAX_ANONYMOUS_KIB: usize = 22_000_000 / 1024;
const RELOADS: usize = 200;
/// Live packets of one count of page faults: as many as come in a second and a half.
const COUNTED_FRAMES: usize = 40;
/// Counts of page faults, of which one may show minor faults, because the kernel may move a page of its own accord.
const COUNTS: usize = 9;

/// The folder of the preloaded library and of the file in which it counts the calls.
struct Hook(TempDir);

impl Hook {
    /// Builds the library, and starts a service with it.
    fn start(receiver: &Receiver) -> (Self, Service) {
        let hook = Self(tempfile::tempdir().unwrap());
        let [library, counters] = ["allocations.so", "counters"].map(|name| hook.0.path().join(name));
        let mut compiler = Command::new("cc");
        compiler.args(["-O2", "-shared", "-fPIC", "-o"]).arg(&library).arg(project("tests/hooks/allocations.c"));
        assert!(compiler.status().unwrap().success());
        fs::write(&counters, []).unwrap();
        let service = Service::start_with(DEMO, &[receiver.address()], |command| {
            command.env("LD_PRELOAD", library).env("ALLOCATIONS_FILE", counters)
        });
        (hook, service)
    }

    /// Returns the calls so far, by thread and return address.
    fn read(&self) -> BTreeMap<(u64, u64), u64> {
        let bytes = fs::read(self.0.path().join("counters")).unwrap();
        let numbers: Vec<u64> = bytes.as_chunks().0.iter().map(|bytes| u64::from_ne_bytes(*bytes)).collect();
        let counters = numbers.as_chunks::<3>().0.iter();
        counters.filter(|[thread, ..]| *thread != 0).map(|&[thread, caller, calls]| ((thread, caller), calls)).collect()
    }
}

struct Functions {
    /// The address at which the program begins in the memory of the service.
    base: u64,
    names: BTreeMap<u64, String>,
}

impl Functions {
    fn of(service: &Service) -> Self {
        let program = env!("CARGO_BIN_EXE_facewire");
        let listed = Command::new("nm").arg(program).output().unwrap();
        let symbol = |line: &str| {
            let mut words = line.split_whitespace();
            let address = u64::from_str_radix(words.next()?, 16).ok()?;
            Some((address, words.nth(1)?.to_owned()))
        };
        let names = String::from_utf8(listed.stdout).unwrap().lines().filter_map(symbol).collect();
        let maps = service.proc("maps");
        let first = maps.lines().find(|line| line.ends_with(program)).unwrap_or_else(|| panic!("{maps}"));
        let base = u64::from_str_radix(first.split('-').next().unwrap(), 16).unwrap();
        Self { base, names }
    }

    fn at(&self, address: u64) -> &str {
        let offset = address.wrapping_sub(self.base);
        self.names.range(..offset).next_back().map_or("?", |(_, name)| name.as_str())
    }
}

#[test]
fn frames_allocate_nothing_in_rust_or_c_except_what_libjpeg_turbo_needs_to_decode() {
    let receiver = Receiver::new();
    let (hook, mut service) = Hook::start(&receiver);
    receiver.live_packets(WARM_UP);
    let (before, mapped) = (hook.read(), service.proc("maps"));
    // On a busy machine, frames are left out, and packets repeat the frame before.
    let (mut frames, mut last_us) = (0, 0);
    while frames < FRAMES {
        let captured_us = receiver.live().pop().unwrap().capture_us;
        frames += usize::from(captured_us != std::mem::replace(&mut last_us, captured_us));
    }
    let (after, mapped_later) = (hook.read(), service.proc("maps"));

    let functions = Functions::of(&service);
    let threads = ["fw-hot", "fw-sender"].map(|name| u64::try_from(service.thread(name)).unwrap());
    assert!(
        threads.iter().all(|thread| before.keys().any(|(of, _)| of == thread)),
        "no calls were counted while the service started: {before:?}"
    );
    let of_frames: Vec<(&str, u64)> = after
        .iter()
        .filter(|((thread, _), _)| threads.contains(thread))
        .map(|(key, calls)| (functions.at(key.1), calls - before.get(key).unwrap_or(&0)))
        .filter(|(_, calls)| *calls > 0)
        .collect();
    let decodes = |(name, _): &&(&str, u64)| JPEG_FUNCTIONS.split(' ').any(|function| function == *name);
    let (decoding, other): (Vec<_>, Vec<_>) = of_frames.iter().partition(decodes);
    assert!(other.is_empty(), "calls that allocate or free memory: {other:?}");
    // The calls of libjpeg-turbo are all counted, which shows that the library sees C code.
    let calls = usize::try_from(decoding.iter().map(|(_, calls)| calls).sum::<u64>()).unwrap();
    let images = calls as f64 / JPEG_CALLS as f64;
    assert!((images - FRAMES as f64).abs() < 0.1 * FRAMES as f64, "{decoding:?}");
    assert_eq!(mapped, mapped_later, "the process has mapped or unmapped memory");
}

/// Each reload of the networks loads the new ones before the old ones are freed, on as many threads as the settings want.
#[test]
fn a_service_holds_at_most_30_mb_at_first_and_after_200_random_reloads() {
    let (service, receiver) = Service::live(DEMO);
    receiver.live_packets(WARM_UP);
    let peak_kib = service.kib("VmHWM:");
    assert!(peak_kib <= MAX_KIB, "{peak_kib} KiB, at most {MAX_KIB} KiB are allowed");
    let mut random = fastrand::Rng::with_seed(21);
    let answered = || service.logged("settings changed") + service.logged("settings are unchanged");
    for reload in 1..=RELOADS {
        // The last one is that of the beginning again: more threads need more memory.
        let threads = if reload == RELOADS { 1 } else { random.u32(1..=8) };
        let rate_hz = random.u32(10..=240);
        let filter = random.choice(["kalman", "one-euro", "low-pass"]).unwrap();
        let smoothing = format!("[smoothing]\nbrows = \"{filter}\"\n");
        service.reload(&format!("{DEMO}[networks]\nthreads = {threads}\n{smoothing}[send]\nrate_hz = {rate_hz}\n"));
        while answered() < reload {
            receiver.packet();
        }
    }
    receiver.live_packets(WARM_UP);
    let held_kib = service.kib("RssAnon:");
    assert!(held_kib <= MAX_ANONYMOUS_KIB, "{held_kib} KiB, at most {MAX_ANONYMOUS_KIB} KiB are allowed");
}

/// Minor and major page faults of a thread so far.
fn page_faults(thread: &Path) -> [u64; 2] {
    let stat = fs::read_to_string(thread.join("stat")).unwrap();
    // Field 2, the name, may have spaces.
    let fields: Vec<&str> = stat.rsplit_once(") ").unwrap().1.split(' ').collect();
    [10, 12].map(|field| fields[field - 3].parse().unwrap())
}

/// Returns the parts of the memory that the process has mapped itself and may use, and that are not locked or not resident.
fn unlocked(service: &Service) -> Vec<String> {
    let maps = service.proc("smaps");
    // Each part ends with its flags.
    let parts: Vec<&str> = maps.split_inclusive("VmFlags:").collect();
    let flags = |part: &str| part.lines().next().unwrap_or_default().split(' ').any(|flag| flag == "lo");
    let mut unlocked = Vec::new();
    for (part, next) in parts.iter().zip(&parts[1..]) {
        let number = |key: &str| part.lines().find_map(|line| line.strip_prefix(key)).map(str::trim);
        // [vdso] and [vvar] are the kernel's.
        let is_own = !part.contains(" ---p ") && !part.contains("[v");
        if is_own && !(flags(next) && number("Size:") == number("Rss:")) {
            unlocked.push((*part).to_owned());
        }
    }
    assert!(parts.len() > 20, "{maps}");
    unlocked
}

#[test]
fn locked_memory_is_all_resident_and_frames_fault_no_page() {
    let (mut service, receiver) = Service::live(&format!("{DEMO}[realtime]\nlock_memory = true\n"));
    receiver.live_packets(WARM_UP);
    let (at_first_kib, lines) = (service.kib("VmLck:"), service.logged("fps="));
    // A thread that begins late has a heap of its own, which the next status line locks.
    service.signal(Signal::USR1);
    eventually("a status line", || service.logged("fps=") > lines);
    let (locked_kib, unlocked) = (service.kib("VmLck:"), unlocked(&service));
    let threads = ["fw-hot", "fw-sender"].map(|name| service.thread(name));
    let faults = || threads.map(|thread| page_faults(Path::new(&format!("/proc/{thread}/task/{thread}"))));
    let counted = [(); COUNTS].map(|()| {
        let before = faults();
        receiver.live_packets(COUNTED_FRAMES);
        [before, faults()]
    });
    let log = service.stopped();
    if !log.contains("INFO memory locked") {
        return common::skip(&format!("this machine locks no memory: {log}"));
    }
    assert!(10 * at_first_kib > 9 * locked_kib, "at first {at_first_kib} of {locked_kib} KiB were locked");
    assert!(unlocked.is_empty(), "memory that may fault: {unlocked:?}");
    let has_major = |[before, after]: &[[[u64; 2]; 2]; 2]| [0, 1].map(|thread| after[thread][1] > before[thread][1]);
    assert!(counted.iter().all(|count| has_major(count) == [false; 2]), "hot and sender: {counted:?}");
    let clean = counted.iter().filter(|[before, after]| before == after).count();
    assert!(clean + 1 >= COUNTS, "hot and sender: {counted:?}");
}
