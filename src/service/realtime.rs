//! Real-time scheduling: locks memory, raises the priority of threads and binds threads to CPUs.
//!
//! If the system refuses a request, the service runs without it, and the status line says so. Priorities are set per
//! thread, because a scheduling policy of the whole process would also apply to the helper threads of the networks.

use std::{fmt, hint::black_box, io};

use rustix::mm::{MlockAllFlags, mlockall};
use rustix::thread::{CpuSet, sched_setaffinity};
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ScheduleParams, ThreadSchedulePolicy, set_thread_priority_and_policy,
    thread_native_id,
};
use thread_priority::{Error, ThreadPriority};

use crate::config::RealtimeSettings;

/// Free space to leave at the end of a heap. The C library serves allocations from 128 KiB on outside the heap.
const HEAP_ROOM_BYTES: usize = 120 * 1024;

/// A request to the system, and the reason and the remedy if the system refused it. Displays as the request, with the
/// reason if it was refused.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Grant {
    pub(super) request: String,
    pub(super) refusal: Option<(String, String)>,
}

impl Grant {
    fn new(request: String, outcome: io::Result<()>, remedy: &str) -> Self {
        Self { request, refusal: outcome.err().map(|error| (error.to_string(), remedy.to_owned())) }
    }
}

impl fmt::Display for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let refused = self.refusal.as_ref().map_or_else(String::new, |(reason, _)| format!(" refused ({reason})"));
        write!(f, "{}{refused}", self.request)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Scheduling {
    name: &'static str,
    /// `SCHED_FIFO` priority, 1 to 99. `None` keeps the default policy.
    priority: Option<u32>,
    /// The only CPU that may run the thread. `None` allows every CPU.
    cpu: Option<usize>,
}

impl Scheduling {
    pub(super) fn hot(settings: &RealtimeSettings) -> Self {
        let priority = Some(settings.priority).filter(|priority| *priority > 0);
        Self { name: "hot", priority, cpu: usize::try_from(settings.hot_cpu).ok() }
    }

    /// The priority is one above that of the hot loop, so that an inference cannot delay the failsafe.
    pub(super) fn sender(settings: &RealtimeSettings) -> Self {
        let priority = Self::hot(settings).priority.map(|priority| priority + 1);
        Self { name: "sender", priority, cpu: usize::try_from(settings.sender_cpu).ok() }
    }

    /// Requests the priority and the CPU for the calling thread. Returns one answer for each request.
    pub(super) fn apply(self) -> Vec<Grant> {
        let Self { name, priority, cpu } = self;
        let priority = priority.map(|priority| {
            let remedy = "give the service LimitRTPRIO (systemd) or an rtprio limit";
            Grant::new(format!("{name} priority {priority}"), set_priority(priority), remedy)
        });
        let remedy =
            format!("set realtime.{name}_cpu to a CPU that this machine has and the service may use, or to -1");
        let cpu = cpu.map(|cpu| Grant::new(format!("{name} on CPU {cpu}"), set_cpu(cpu), &remedy));
        priority.into_iter().chain(cpu).collect()
    }
}

/// Binds the calling thread to the CPU of the hot loop, for a measurement outside the service. Returns the system's
/// answer if the settings name a CPU.
pub fn bind_to_hot_cpu(settings: &RealtimeSettings) -> Option<String> {
    let hot = Scheduling { priority: None, ..Scheduling::hot(settings) };
    hot.apply().first().map(Grant::to_string)
}

fn set_priority(priority: u32) -> io::Result<()> {
    let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let params = ScheduleParams { sched_priority: i32::try_from(priority).unwrap_or(i32::MAX) };
    let set = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::from_posix(params), fifo);
    set.map_err(|error| match error {
        Error::OS(code) => io::Error::from_raw_os_error(code),
        other => io::Error::other(other.to_string()),
    })
}

fn set_cpu(cpu: usize) -> io::Result<()> {
    if cpu >= CpuSet::MAX_CPU {
        return Err(io::Error::other(format!("the highest CPU number is {}", CpuSet::MAX_CPU - 1)));
    }
    let mut set = CpuSet::new();
    set.set(cpu);
    Ok(sched_setaffinity(None, &set)?)
}

/// Locks all present memory of the process in RAM: code, networks, heap, and the whole stacks of all threads.
///
/// Afterwards no frame causes a page fault: the networks have run once, and the memory that they and the decoder allocate
/// for each frame stays in the heap. Future memory is not locked (`MCL_FUTURE`), because allocations beyond the memory
/// lock limit would then fail. The supervisor therefore calls this again after a camera was opened or settings were
/// changed, and with each status line, because a thread that begins later has a heap of its own.
pub(super) fn lock_memory() -> Grant {
    let outcome = mlockall(MlockAllFlags::CURRENT).map_err(io::Error::from);
    Grant::new("memory locked".to_owned(), outcome, "give the service LimitMEMLOCK (systemd) or a memlock limit")
}

/// Enlarges the calling thread's heap, so that it does not grow later: fragmentation may make it grow by a page after
/// hours, and that page causes a page fault even with locked memory. The GNU C library keeps free space of up to 128 KiB
/// at the end of the heap and returns only larger spaces to the system.
pub(super) fn leave_room_in_heap() {
    drop(black_box(vec![1_u8; HEAP_ROOM_BYTES]));
}

#[cfg(test)]
mod tests {
    use rustix::thread::sched_getaffinity;

    use super::*;

    #[test]
    fn the_sender_has_a_higher_priority_than_the_hot_loop_and_the_default_settings_ask_for_none() {
        let priorities =
            |settings: &RealtimeSettings| [Scheduling::hot, Scheduling::sender].map(|of| of(settings).priority);
        assert_eq!(priorities(&RealtimeSettings::default()), [None; 2]);
        let settings = RealtimeSettings { priority: 20, ..RealtimeSettings::default() };
        assert_eq!(priorities(&settings), [Some(20), Some(21)]);
    }

    #[test]
    fn a_thread_runs_only_on_its_configured_cpu() {
        let allowed = sched_getaffinity(None).unwrap();
        let hot_cpu = (0..CpuSet::MAX_CPU).rfind(|cpu| allowed.is_set(*cpu)).unwrap() as i32;
        let scheduling = Scheduling::hot(&RealtimeSettings { hot_cpu, ..RealtimeSettings::default() });
        let bound = std::thread::spawn(move || {
            assert_eq!(scheduling.apply().first().unwrap().to_string(), format!("hot on CPU {hot_cpu}"));
            sched_getaffinity(None).unwrap()
        });
        let bound = bound.join().unwrap();
        assert!(bound.is_set(hot_cpu as usize) && bound.count() == 1);
    }

    #[test]
    fn a_cpu_that_is_not_there_is_refused_with_reason_and_remedy() {
        let scheduling = Scheduling::sender(&RealtimeSettings { sender_cpu: 1023, ..RealtimeSettings::default() });
        let grant = scheduling.apply().pop().unwrap();
        assert!(grant.to_string().starts_with("sender on CPU 1023 refused (Invalid argument"), "{grant}");
        assert!(grant.refusal.unwrap().1.starts_with("set realtime.sender_cpu to a CPU"));
    }
}
