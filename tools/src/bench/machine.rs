//! Measures what the machine itself adds to latencies, and reads processor time and memory.

use std::fs;
use std::hint::black_box;
use std::iter::Sum;
use std::time::{Duration, Instant};

use rustix::param::clock_ticks_per_second;
use rustix::time::{ClockId, clock_gettime};
use serde::Serialize;

/// Steps of the loop of constant work between two readings of the clock, while its speed is measured.
const CALIBRATION_STEPS: u64 = 20_000;

/// Repeats a loop of constant work, and returns how long each pass took. The loop uses no memory, so its times differ only
/// by what the machine does meanwhile: interrupts, other processes, other virtual machines, changes of the clock rate.
pub fn constant_work(length: Duration, passes: usize) -> Vec<Duration> {
    let fastest = (0..50).map(|_| timed(CALIBRATION_STEPS)).min().unwrap_or_default().max(Duration::from_nanos(1));
    let steps =
        u64::try_from(length.as_nanos() * u128::from(CALIBRATION_STEPS) / fastest.as_nanos()).unwrap_or(u64::MAX);
    (0..passes).map(|_| timed(steps)).collect()
}

/// Returns the duration of `steps` steps of a linear congruential generator. Each step depends on the one before it, so the
/// processor cannot overlap them.
fn timed(steps: u64) -> Duration {
    let begun = Instant::now();
    let last =
        (0..steps).fold(1_u64, |state, _| black_box(state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1)));
    black_box(last);
    begun.elapsed()
}

/// Counts of events that take the processor from this process.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Interruptions {
    /// Times that another process took the processor from this one.
    pub involuntary_switches: u64,
    /// Interrupts of all cores.
    pub interrupts: u64,
    /// Time that the hypervisor gave to other virtual machines, of all cores.
    pub stolen_ms: u64,
}

impl Interruptions {
    /// Counts since the start of the process and of the machine.
    pub fn now() -> Self {
        let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
        let stat = fs::read_to_string("/proc/stat").unwrap_or_default();
        // The fields of `cpu` are ticks: user, nice, system, idle, iowait, irq, softirq, steal (man 5 proc).
        let stolen = field(&stat, "cpu ", 7) * 1000 / clock_ticks_per_second().max(1);
        Self {
            involuntary_switches: field(&status, "nonvoluntary_ctxt_switches:", 0),
            interrupts: field(&stat, "intr ", 0),
            stolen_ms: stolen,
        }
    }

    pub fn since(self, before: Self) -> Self {
        Self {
            involuntary_switches: self.involuntary_switches.saturating_sub(before.involuntary_switches),
            interrupts: self.interrupts.saturating_sub(before.interrupts),
            stolen_ms: self.stolen_ms.saturating_sub(before.stolen_ms),
        }
    }
}

impl Sum for Interruptions {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::default(), |sum, other| Self {
            involuntary_switches: sum.involuntary_switches + other.involuntary_switches,
            interrupts: sum.interrupts + other.interrupts,
            stolen_ms: sum.stolen_ms + other.stolen_ms,
        })
    }
}

/// Returns the number at `index`, counted from 0, on the line that begins with `key`. Returns 0 if it is missing.
fn field(text: &str, key: &str, index: usize) -> u64 {
    let line = text.lines().find_map(|line| line.strip_prefix(key));
    line.and_then(|line| line.split_whitespace().nth(index)?.parse().ok()).unwrap_or(0)
}

/// Returns the processor time that this process has used.
pub fn cpu_time() -> Duration {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    let part = |value: i64| u64::try_from(value).unwrap_or(0);
    Duration::from_secs(part(time.tv_sec)) + Duration::from_nanos(part(time.tv_nsec))
}

/// Returns the largest resident memory that this process has had.
pub fn peak_memory_kb() -> u64 {
    field(&fs::read_to_string("/proc/self/status").unwrap_or_default(), "VmHWM:", 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_is_found_by_the_start_of_its_line_and_its_index() {
        let text = "cpu  10 0 5 900 0 0 2 70 0 0\ncpu0 1 2\nintr 12345 9 8\n";
        assert_eq!((field(text, "cpu ", 7), field(text, "intr ", 0), field(text, "none", 0)), (70, 12345, 0));
    }

    #[test]
    fn constant_work_takes_about_as_long_as_requested() {
        let mut times = constant_work(Duration::from_micros(500), 21);
        times.sort_unstable();
        // Even on a busy machine the fastest of many passes runs without interruption.
        assert!(times[0] > Duration::from_micros(100) && times[0] < Duration::from_millis(50), "{times:?}");
    }
}
