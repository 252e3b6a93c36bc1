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
use std::ffi::OsStr;
use std::fs;
use std::process::Command;

use common::camera::{Camera, Cameras};
use common::project;
use common::service::{DEMO, Receiver, Service, counted};
use tempfile::TempDir;

/// Live packets before the count begins. The first frame of the camera allocates the camera's memory.
const WARM_UP: usize = 30;
/// How many status lines may come until the memory of threads that start late is locked, too.
const LATE_THREADS: usize = 3;
/// A busy machine may take seconds for a frame.
const CAMERA: &str = "[camera]\ndevice = \"auto\"\n[failsafe]\nlive_ms = 5000\nhold_ms = 6000\nneutral_ms = 7000\n";
/// Frames that are counted. The clip has 240, so it starts over in between.
const FRAMES: u64 = 300;
/// Frames of a camera that are counted. It shows 20 in turn.
const CAMERA_FRAMES: u64 = 100;
/// Functions of libjpeg-turbo that allocate and free memory for each image. Which of them call the C library depends on what
/// the compiler inlines. A program that decodes into planes with libjpeg-turbo cannot avoid these calls.
const JPEG_FUNCTIONS: [&str; 8] = [
    "alloc_small",
    "alloc_large",
    "free_pool",
    "jpeg_get_small",
    "jpeg_get_large",
    "jpeg_free_small",
    "jpeg_free_large",
    "tj3DecompressToYUVPlanes8",
];
/// The number of calls that these functions make for an image of three components.
const JPEG_CALLS: u64 = 14;
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
    /// Builds the library, and starts a service with it, and with those that are to be loaded before it.
    fn start(toml: &str, receiver: &Receiver, prepare: impl FnOnce(&mut Command) -> &mut Command) -> (Self, Service) {
        let hook = Self(tempfile::tempdir().unwrap());
        let [library, counters] = ["allocations.so", "counters"].map(|name| hook.0.path().join(name));
        let mut compiler = Command::new("cc");
        compiler.args(["-O2", "-shared", "-fPIC", "-o"]).arg(&library).arg(project("tests/hooks/allocations.c"));
        assert!(compiler.status().unwrap().success());
        fs::write(&counters, []).unwrap();
        let service = Service::start_with(toml, &[receiver.address()], |command| {
            prepare(command);
            let is_preload = |(name, _): &(&OsStr, _)| *name == "LD_PRELOAD";
            let before = command.get_envs().find(is_preload).and_then(|(_, value)| value).unwrap_or_default();
            let preloaded = format!("{} {}", before.display(), library.display());
            command.env("LD_PRELOAD", preloaded).env("ALLOCATIONS_FILE", counters)
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

/// The functions that allocated or freed memory in the threads that handle frames, with their calls, while the service
/// processed so many frames. It mapped and unmapped no memory.
fn calls_for(frames: u64, hook: &Hook, service: &mut Service, receiver: &Receiver) -> Vec<(String, u64)> {
    receiver.live_packets(WARM_UP);
    let before = hook.read();
    let mapped = mappings(service);
    let frames_before = counted(&service.status(), "frames");
    // On a busy machine, the service leaves most frames out.
    while counted(&service.status(), "frames") <= frames_before + frames {
        receiver.live_packets(20);
    }
    let after = hook.read();
    assert_eq!(mapped, mappings(service), "the process has mapped or unmapped memory");
    let functions = Functions::of(service);
    let threads = threads(service);
    assert!(
        threads.iter().all(|thread| before.keys().any(|(of, _)| of == thread)),
        "no calls were counted while the service started: {before:?}"
    );
    after
        .iter()
        .filter(|((thread, _), _)| threads.contains(thread))
        .map(|(key, calls)| (functions.at(key.1).to_owned(), calls - before.get(key).unwrap_or(&0)))
        .filter(|(_, calls)| *calls > 0)
        .collect()
}

/// The threads that handle frames.
fn threads(service: &mut Service) -> [u64; 2] {
    ["fw-hot", "fw-sender"].map(|name| u64::try_from(service.thread(name)).unwrap())
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
    let (hook, mut service) = Hook::start(DEMO, &receiver, |command| command);
    let of_frames = calls_for(FRAMES, &hook, &mut service, &receiver);
    let decodes = |name: &str| JPEG_FUNCTIONS.contains(&name);
    let other: Vec<_> = of_frames.iter().filter(|(name, _)| !decodes(name)).collect();
    assert!(other.is_empty(), "calls that allocate or free memory: {other:?}");

    let functions = Functions::of(&service);
    let threads = threads(&mut service);
    // The calls of libjpeg-turbo are all counted, which shows that the library sees C code: those of each frame, and of the
    // first one of each camera, which is discarded.
    let log = service.stopped();
    let images = counted(&log, "frames") + counted(&log, "cameras_opened");
    let of_hot = hook.read().into_iter().filter(|((thread, _), _)| *thread == threads[0]);
    let calls: u64 = of_hot.filter(|((_, caller), _)| decodes(functions.at(*caller))).map(|(_, calls)| calls).sum();
    assert!(calls.abs_diff(JPEG_CALLS * images) <= JPEG_CALLS, "{calls} calls for {images} images");
}

#[test]
fn frames_of_a_camera_allocate_nothing_in_rust_or_c_by_either_interface_of_the_kernel() {
    let camera = Camera { formats: &["NV12"], ..Camera::default() };
    for camera in [camera.clone(), Camera { data_offset: 64, ..camera }.multi_planar()] {
        let machine = Cameras::with(&[]);
        machine.show_clip(camera);
        let receiver = Receiver::new();
        let (hook, mut service) = Hook::start(CAMERA, &receiver, |command| machine.prepare(command));
        assert_eq!(calls_for(CAMERA_FRAMES, &hook, &mut service, &receiver), []);
    }
}

/// The memory that the process has mapped, apart from the stacks and heaps of its threads, which come and go with other work
/// than that on frames. What the threads that handle frames allocate is counted by the calls.
fn mappings(service: &Service) -> Vec<String> {
    let maps = service.proc("maps");
    let mut mappings = Vec::new();
    let mut lines = maps.lines().peekable();
    let mut guard_end = "";
    while let Some(line) = lines.next() {
        let (range, rest) = line.split_once(' ').unwrap();
        let (begin, end) = range.split_once('-').unwrap();
        // There is memory without any permission below each stack, and above each heap, which grows into it.
        let is_above_guard = begin == guard_end;
        let is_guard = |line: &str| line.contains(" ---p ");
        let is_below_guard = lines.peek().is_some_and(|next| is_guard(next) && next.starts_with(end));
        if is_guard(line) {
            guard_end = end;
        }
        let is_stack_or_heap = line.ends_with("[heap]") || line.ends_with("[stack]");
        // Permissions, offset, device and inode, without a name.
        let is_anonymous = rest.split_whitespace().count() == 4;
        if !is_stack_or_heap && !(is_anonymous && (is_guard(line) || is_above_guard || is_below_guard)) {
            mappings.push(line.to_owned());
        }
    }
    assert!(mappings.len() > 10, "{maps}");
    mappings
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

/// Page faults of a thread so far.
#[derive(Debug)]
struct Faults {
    minor: u64,
    major: u64,
}

impl Faults {
    fn of(service: &Service, thread: i32) -> Self {
        let stat = service.proc(&format!("task/{thread}/stat"));
        // Field 2, the name, may have spaces.
        let fields: Vec<&str> = stat.rsplit_once(") ").unwrap().1.split(' ').collect();
        let field = |number: usize| fields[number - 3].parse().unwrap();
        Self { minor: field(10), major: field(12) }
    }
}

/// A part of the memory that the process has mapped itself and may use.
struct Part {
    range: String,
    size_kib: u64,
    resident_kib: u64,
    is_locked: bool,
}

impl Part {
    fn all(service: &Service) -> Vec<Self> {
        let maps = service.proc("smaps");
        let mut parts = Vec::new();
        let mut lines = maps.lines();
        // Each part begins with its range and permissions, and ends with its flags.
        while let Some(range) = lines.next() {
            let mut size_kib = 0;
            let mut resident_kib = 0;
            let flags = lines.find_map(|line| {
                let (key, value) = line.split_once(':').unwrap();
                let kib = || value.trim().trim_end_matches(" kB").parse().unwrap();
                match key {
                    "Size" => size_kib = kib(),
                    "Rss" => resident_kib = kib(),
                    "VmFlags" => return Some(value),
                    _ => {}
                }
                None
            });
            // [vdso] and [vvar] are the kernel's.
            if !range.contains(" ---p ") && !range.contains("[v") {
                let is_locked = flags.unwrap().split(' ').any(|flag| flag == "lo");
                parts.push(Self { range: range.to_owned(), size_kib, resident_kib, is_locked });
            }
        }
        assert!(parts.len() > 20, "{maps}");
        parts
    }

    fn may_fault(&self) -> bool {
        !self.is_locked || self.resident_kib < self.size_kib
    }
}

#[test]
fn locked_memory_is_all_resident_and_frames_fault_no_page() {
    let (mut service, receiver) = Service::live(&format!("{DEMO}[realtime]\nlock_memory = true\n"));
    receiver.live_packets(WARM_UP);
    let at_first = Part::all(&service);
    service.status();
    let log = service.log();
    if !log.contains("INFO memory locked") {
        return common::skip(&format!("this machine locks no memory: {log}"));
    }
    let may_fault = || Part::all(&service).into_iter().filter(Part::may_fault).map(|part| part.range);
    // A thread that starts late gets a heap of its own, which is locked with the next status line.
    for _ in 0..LATE_THREADS {
        if may_fault().next().is_some() {
            service.status();
        }
    }
    assert_eq!(may_fault().collect::<Vec<_>>(), Vec::<String>::new(), "memory that may fault");
    let threads = ["fw-hot", "fw-sender"].map(|name| service.thread(name));
    let faults = || threads.map(|thread| Faults::of(&service, thread));
    let counted = [(); COUNTS].map(|()| {
        let before = faults();
        receiver.live_packets(COUNTED_FRAMES);
        [before, faults()]
    });
    service.stopped();
    let resident_kib: u64 = at_first.iter().map(|part| part.resident_kib).sum();
    let unlocked_kib: u64 = at_first.iter().filter(|part| !part.is_locked).map(|part| part.resident_kib).sum();
    assert!(10 * unlocked_kib < resident_kib, "at first {unlocked_kib} of {resident_kib} KiB were not locked");
    let major = counted.iter().filter(|[before, after]| [0, 1].iter().any(|it| before[*it].major != after[*it].major));
    assert_eq!(major.count(), 0, "hot and sender: {counted:?}");
    let minor = counted.iter().filter(|[before, after]| [0, 1].iter().any(|it| before[*it].minor != after[*it].minor));
    assert!(minor.count() <= 1, "hot and sender: {counted:?}");
}
