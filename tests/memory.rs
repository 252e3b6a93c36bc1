//! `facewire run` allocates no memory for a frame, and holds little memory in all.
//!
//! A preloaded library (`tests/hooks/allocations.c`) counts the calls that allocate or free memory in every thread, those of
//! C code included. The tests build it with the C compiler that also builds libjpeg-turbo.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use common::service::{Receiver, Service};
use facewire_packet::{Packet, State};
use tempfile::{NamedTempFile, TempDir};

const DEMO: &str = "[camera]\ndevice = \"demo\"\n";
/// Live packets before the count begins. The first frame of the camera allocates the camera's memory.
const WARM_UP: usize = 30;
/// Frames that are counted. The clip has 240, so it starts over in between.
const FRAMES: usize = 300;
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
const JPEG_CALLS: usize = 14;
/// The highest resident memory that the service may reach.
const MAX_KIB: usize = 30_000_000 / 1024;
/// How often the settings change in the test of reloads.
const RELOADS: usize = 200;

/// The preloaded library and the file in which it counts the calls.
struct Hook(TempDir);

impl Hook {
    fn build() -> Self {
        let hook = Self(tempfile::tempdir().unwrap());
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hooks/allocations.c");
        let built = Command::new("cc").args(["-O2", "-shared", "-fPIC", "-o"]).arg(hook.library()).arg(source).status();
        assert!(built.unwrap().success());
        fs::write(hook.counters(), []).unwrap();
        hook
    }

    fn library(&self) -> PathBuf {
        self.0.path().join("allocations.so")
    }

    fn counters(&self) -> PathBuf {
        self.0.path().join("counters")
    }

    fn start(&self, receiver: &Receiver) -> Service {
        Service::start_with(DEMO, &[receiver.address()], |command| {
            command.env("LD_PRELOAD", self.library()).env("ALLOCATIONS_FILE", self.counters()).stderr(Stdio::null())
        })
    }

    /// Returns the calls so far, by thread and return address.
    fn read(&self) -> BTreeMap<(u64, u64), u64> {
        let bytes = fs::read(self.counters()).unwrap();
        let numbers: Vec<u64> = bytes.as_chunks().0.iter().map(|bytes| u64::from_ne_bytes(*bytes)).collect();
        let counters = numbers.as_chunks::<3>().0.iter();
        counters.filter(|[thread, ..]| *thread != 0).map(|&[thread, caller, calls]| ((thread, caller), calls)).collect()
    }
}

/// The functions of the program, by their addresses.
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
        let maps = mappings(service);
        let first = maps.lines().find(|line| line.ends_with(program)).unwrap_or_else(|| panic!("{maps}"));
        let base = u64::from_str_radix(first.split('-').next().unwrap(), 16).unwrap();
        Self { base, names }
    }

    /// Returns the name of the function that contains an address.
    fn at(&self, address: u64) -> &str {
        let offset = address.wrapping_sub(self.base);
        self.names.range(..offset).next_back().map_or("?", |(_, name)| name.as_str())
    }
}

fn mappings(service: &Service) -> String {
    fs::read_to_string(format!("/proc/{}/maps", service.pid())).unwrap()
}

/// Waits until `count` live packets have arrived.
fn live_packets(receiver: &Receiver, count: usize) {
    (0..count).for_each(|_| _ = receiver.until(|packet: &Packet| packet.state == State::Live));
}

#[test]
fn frames_allocate_nothing_in_rust_or_c_except_what_libjpeg_turbo_needs_to_decode() {
    let (receiver, hook) = (Receiver::new(), Hook::build());
    let mut service = hook.start(&receiver);
    live_packets(&receiver, WARM_UP);
    let (before, mapped) = (hook.read(), mappings(&service));
    live_packets(&receiver, FRAMES);
    let (after, mapped_later) = (hook.read(), mappings(&service));

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
    let (decoding, other): (Vec<_>, Vec<_>) = of_frames.iter().partition(|(name, _)| JPEG_FUNCTIONS.contains(name));
    assert!(other.is_empty(), "calls that allocate or free memory: {other:?}");
    // The calls of libjpeg-turbo are all counted, which shows that the library sees C code.
    let calls = usize::try_from(decoding.iter().map(|(_, calls)| calls).sum::<u64>()).unwrap();
    let images = calls as f64 / JPEG_CALLS as f64;
    assert!((images - FRAMES as f64).abs() < 0.1 * FRAMES as f64, "{decoding:?}");
    assert_eq!(mapped, mapped_later, "the process has mapped or unmapped memory");
}

/// A line of `/proc/PID/status`, in KiB.
fn kib(service: &Service, line: &str) -> usize {
    let status = fs::read_to_string(format!("/proc/{}/status", service.pid())).unwrap();
    let value = status.lines().find_map(|it| it.strip_prefix(line)).unwrap();
    value.trim().trim_end_matches(" kB").parse().unwrap()
}

#[test]
fn a_service_that_follows_a_face_holds_at_most_30_mb() {
    let receiver = Receiver::new();
    let service = Service::start(DEMO, &[receiver.address()]);
    live_packets(&receiver, WARM_UP);
    let peak_kib = kib(&service, "VmHWM:");
    assert!(peak_kib <= MAX_KIB, "{peak_kib} KiB, at most {MAX_KIB} KiB are allowed");
}

/// Each reload of the networks loads the new ones before the old ones are freed, on as many threads as the settings want.
#[test]
fn after_200_random_reloads_the_service_still_holds_at_most_30_mb() {
    let (receiver, log) = (Receiver::new(), NamedTempFile::new().unwrap());
    let service = Service::start_logging_to(DEMO, &[receiver.address()], log.reopen().unwrap().into());
    live_packets(&receiver, WARM_UP);
    let (mut random, link) =
        (fastrand::Rng::with_seed(21), format!("[[link]]\naddress = \"{}\"\n", receiver.address()));
    let answered = || {
        let log = fs::read_to_string(log.path()).unwrap();
        log.matches("settings changed").count() + log.matches("settings are unchanged").count()
    };
    for reload in 1..=RELOADS {
        // The last one is that of the beginning again: more threads need more memory.
        let threads = if reload == RELOADS { 1 } else { random.u32(1..=8) };
        let rate_hz = random.u32(10..=240);
        let filter = random.choice(["kalman", "one-euro", "low-pass"]).unwrap();
        let settings = format!(
            "{DEMO}[networks]\nthreads = {threads}\n[smoothing]\nbrows = \"{filter}\"\n[send]\nrate_hz = {rate_hz}\n{link}"
        );
        service.reload(&settings);
        while answered() < reload {
            receiver.packet();
        }
    }
    live_packets(&receiver, WARM_UP);
    let held_kib = kib(&service, "VmRSS:");
    assert!(held_kib <= MAX_KIB, "{held_kib} KiB, at most {MAX_KIB} KiB are allowed");
}
