//! Runs a service for a long time with random faults of its camera, face, links and inferences, and changes its settings.
//!
//! The test takes a minute; `FACEWIRE_SOAK_MINUTES=120 cargo test --release --test soak` takes two hours. The service is
//! this program itself, started again as `facewire run` with an allocator that counts ([`counted`]). Each second is judged
//! ([`judge`]): no packet may be missing, states and reasons must be right, and no step may exceed the slew limit. While
//! frames flow and the settings stay the same, the threads that handle them must not allocate memory or fault pages. At
//! the end, memory and descriptors must be what they were, and the counters must add up.
#![allow(clippy::unwrap_used, clippy::panic, clippy::indexing_slicing)]

mod common;
#[path = "soak/counted.rs"]
mod counted;
#[path = "soak/faults.rs"]
mod faults;
#[path = "soak/judge.rs"]
mod judge;
#[path = "soak/process.rs"]
mod process;

use std::process::ExitCode;
use std::time::{Duration, Instant};

use libtest_mimic::{Arguments, Trial};

use self::common::eventually;
use self::common::service::counted;
use self::faults::Faults;
use self::judge::Judge;
use self::process::Process;

/// The environment variable that makes this program the service.
const SERVICE: &str = "FACEWIRE_SOAK_SERVICE";
/// How often faults may begin and end.
const STEP: Duration = Duration::from_millis(100);
/// How many steps are judged together.
const STEPS: u32 = 10;
const SEED: u64 = 7;
/// How much longer than asked for the test goes on for a state that has not come yet.
const LONGEST_WAIT: Duration = Duration::from_mins(8);

fn main() -> ExitCode {
    if std::env::var_os(SERVICE).is_some() {
        counted::answer_on_standard_output();
        return facewire::cli::run(std::env::args_os());
    }
    let name = "a_service_with_random_faults_stays_what_it_was";
    let soak = Trial::test(name, || {
        soak(minutes());
        Ok(())
    });
    libtest_mimic::run(&Arguments::from_args(), vec![soak]).exit_code()
}

fn minutes() -> u32 {
    std::env::var("FACEWIRE_SOAK_MINUTES").map_or(1, |minutes| minutes.parse().unwrap())
}

fn soak(minutes: u32) {
    let mut faults = Faults::new();
    let mut process = Process::start(&faults.settings());
    let mut judge = Judge::default();
    let end = Instant::now() + Duration::from_mins(1) * minutes;
    while Instant::now() < end || !judge.has_seen_all() {
        let missing = judge.missing();
        assert!(Instant::now() < end + LONGEST_WAIT, "never came: {missing:?}");
        let is_changed = faults.change_settings(&process);
        for _ in 0..STEPS {
            std::thread::sleep(STEP);
            faults.step(&process);
        }
        judge.interval(process.packets(), process.sample(), is_changed);
    }
    let summary = faults.end();
    // Then the last change has taken effect, and the links that it ended have counted their last packets.
    eventually("that every packet is counted", || {
        let status = process.service.status();
        counted(&status, "packets") == counted(&status, "sent") + counted(&status, "dropped")
    });
    eventually("as few descriptors as at first", || process.descriptors() <= judge.descriptors_at_first());
    let (rest, log) = process.stop();
    judge.end(rest, &log);
    println!("{summary}");
}
