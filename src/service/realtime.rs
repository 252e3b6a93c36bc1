//! Real time: memory that stays in RAM, scheduling before other programs, CPUs of their own.
//!
//! Each is asked for only if the settings want it. The system may refuse; the service then runs on without it, and the
//! status says so. Priority is set by thread, after the networks are loaded: a policy for the whole process would give
//! it to ONNX Runtime's own threads, too.

use std::hint::black_box;
use std::{fmt, io};

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity};
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ScheduleParams, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{Error, ThreadPriority};

use crate::config::RealtimeSettings;

/// Room at the end of a heap. From 128 KiB on, it would not come from the heap.
const HEAP_ROOM_BYTES: usize = 120 * 1024;

/// Something asked of the system, and what it said.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Grant {
    wish: String,
    refusal: Option<Refusal>,
}

#[derive(Debug, PartialEq, Eq)]
struct Refusal {
    reason: String,
    remedy: &'static str,
}

impl Grant {
    fn new(wish: String, outcome: Result<(), String>, remedy: &'static str) -> Self {
        Self { wish, refusal: outcome.err().map(|reason| Refusal { reason, remedy }) }
    }

    /// Whether both answer the same wish.
    pub(super) fn is_about_the_same(&self, other: &Self) -> bool {
        self.wish == other.wish
    }

    /// What to do about a refusal.
    pub(super) fn remedy(&self) -> Option<&'static str> {
        self.refusal.as_ref().map(|refusal| refusal.remedy)
    }
}

impl fmt::Display for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.refusal {
            None => write!(f, "{}", self.wish),
            Some(refusal) => write!(f, "{} refused ({})", self.wish, refusal.reason),
        }
    }
}

/// What a thread asks for itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Place {
    name: &'static str,
    /// Of `SCHED_FIFO`, 1 to 99.
    priority: Option<u32>,
    cpu: Option<usize>,
    /// What to do about a CPU that is refused.
    cpu_remedy: &'static str,
}

impl Place {
    pub(super) fn hot(settings: &RealtimeSettings) -> Self {
        let priority = Some(settings.priority).filter(|priority| *priority > 0);
        let cpu_remedy = "set realtime.hot_cpu to a CPU that this machine has and the service may use, or to -1";
        Self { name: "hot", priority, cpu: usize::try_from(settings.hot_cpu).ok(), cpu_remedy }
    }

    /// The sender goes before the hot loop: an inference must not hold up the failsafe.
    pub(super) fn sender(settings: &RealtimeSettings) -> Self {
        let priority = Self::hot(settings).priority.map(|priority| priority + 1);
        let cpu_remedy = "set realtime.sender_cpu to a CPU that this machine has and the service may use, or to -1";
        Self { name: "sender", priority, cpu: usize::try_from(settings.sender_cpu).ok(), cpu_remedy }
    }

    /// Asks for the calling thread.
    pub(super) fn take(self) -> Vec<Grant> {
        let priority = self.priority.map(|priority| {
            let remedy = "give the service LimitRTPRIO (systemd) or an rtprio limit";
            Grant::new(format!("{} priority {priority}", self.name), set_priority(priority), remedy)
        });
        let cpu = self.cpu.map(|cpu| Grant::new(format!("{} on CPU {cpu}", self.name), set_cpu(cpu), self.cpu_remedy));
        priority.into_iter().chain(cpu).collect()
    }
}

fn set_priority(priority: u32) -> Result<(), String> {
    let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let params = ScheduleParams { sched_priority: i32::try_from(priority).unwrap_or(i32::MAX) };
    let set = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::from_posix(params), fifo);
    set.map_err(|error| match error {
        Error::OS(code) => io::Error::from_raw_os_error(code).to_string(),
        other => other.to_string(),
    })
}

fn set_cpu(cpu: usize) -> Result<(), String> {
    if cpu >= CpuSet::MAX_CPU {
        return Err(format!("CPUs are numbered up to {}", CpuSet::MAX_CPU - 1));
    }
    let mut set = CpuSet::new();
    set.set(cpu);
    sched_setaffinity(None, &set).map_err(|error| io::Error::from(error).to_string())
}

/// Locks all memory that the process has now, and reads in what was not in RAM yet: code, networks, heap, and the stacks
/// of all threads to their end. No frame then waits for a page, because what a frame needs is there by now: the networks
/// have run ([`crate::infer::Engine::load`]), and what they and the decoder take and give back from frame to frame stays
/// with the heap (`tests/page_faults.rs`). Later memory is not locked of itself: beyond the limit it could then not be
/// had at all. So this is done again whenever a camera was opened or settings were changed, after which nothing grows.
pub(super) fn lock_memory() -> Grant {
    let outcome = mlockall(MlockAllFlags::CURRENT).map_err(|error| io::Error::from(error).to_string());
    Grant::new("memory locked".to_owned(), outcome, "give the service LimitMEMLOCK (systemd) or a memlock limit")
}

/// Leaves room at the end of the calling thread's heap. What libraries take and give back there from frame to frame may
/// need another page only after hours, when the pieces lie unluckily, and growth costs a page fault even where memory is
/// locked. The GNU C library keeps this much: it gives back what is beyond 128 KiB.
pub(super) fn leave_room_in_heap() {
    drop(black_box(vec![1_u8; HEAP_ROOM_BYTES]));
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use rustix::thread::sched_getaffinity;

    use super::*;

    #[test]
    fn nothing_is_asked_for_by_default() {
        let settings = RealtimeSettings::default();
        assert!(!settings.lock_memory);
        assert!(Place::hot(&settings).take().is_empty() && Place::sender(&settings).take().is_empty());
    }

    #[test]
    fn the_sender_goes_before_the_hot_loop() {
        let settings = RealtimeSettings { priority: 20, ..RealtimeSettings::default() };
        assert_eq!(Place::hot(&settings).priority, Some(20));
        assert_eq!(Place::sender(&settings).priority, Some(21));
    }

    #[test]
    fn a_thread_is_bound_to_its_cpu() {
        let allowed = sched_getaffinity(None).unwrap();
        let cpu = (0..CpuSet::MAX_CPU).rfind(|cpu| allowed.is_set(*cpu)).unwrap();
        let hot_cpu = i32::try_from(cpu).unwrap();
        let place = Place::hot(&RealtimeSettings { hot_cpu, ..RealtimeSettings::default() });
        let bound = std::thread::spawn(move || {
            let grants = place.take();
            assert_eq!(grants.first().unwrap().to_string(), format!("hot on CPU {cpu}"));
            sched_getaffinity(None).unwrap()
        });
        let bound = bound.join().unwrap();
        assert!(bound.is_set(cpu) && bound.count() == 1);
    }

    #[test]
    fn a_cpu_that_is_not_there_is_refused_with_reason_and_remedy() {
        let place = Place::sender(&RealtimeSettings { sender_cpu: 1023, ..RealtimeSettings::default() });
        let grants = std::thread::spawn(move || place.take()).join().unwrap();
        let grant = grants.first().unwrap();
        assert!(grant.to_string().starts_with("sender on CPU 1023 refused (Invalid argument"), "{grant}");
        assert!(grant.remedy().unwrap().starts_with("set realtime.sender_cpu to a CPU"));
    }
}
