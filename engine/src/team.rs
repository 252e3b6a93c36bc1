//! A team of threads that share the work of one run of a network.
//!
//! The caller of [`Team::for_each`] publishes a list of tasks. The caller and the workers each take the next task until
//! none is left. If a worker is late, because it slept or because the system runs another thread, the call therefore loses
//! only the help of that worker: the other threads compute the tasks. Once the list is empty, the caller waits for the
//! tasks that workers have taken.
//!
//! A worker without a task polls for [`POLLING`] and then parks. Between frames all workers are parked. Taking and
//! finishing a task are single atomic operations: there is no lock and no allocation.
//!
//! This module contains `unsafe` code because threads that outlive a call cannot borrow the caller's tasks in safe Rust.
//! Three rules make it sound: a task is taken by exactly one thread, because taking is a compare-and-exchange; the
//! description of the tasks changes only while none is taken; and `for_each` returns only when all tasks are finished,
//! even if one panics.

use std::any::Any;
use std::cell::UnsafeCell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use std::{hint, io, mem, process, ptr};

/// Time for which a thread polls before it lets the system run other threads: several times as long as a worker needs
/// to wake up, and short beside a frame.
const POLLING: Duration = Duration::from_micros(50);
/// Polls between two readings of the clock.
const POLLS: u32 = 32;
/// Stack of a worker. The kernels need a few kilobytes; the rest is for the message of a panic. The service locks the
/// whole stack into memory.
const STACK_BYTES: usize = 128 * 1024;

/// Threads that wait for tasks. They end when the team is dropped.
///
/// They are threads of one process: in a child that it forks, the caller runs all tasks alone.
pub struct Team {
    shared: Arc<Shared>,
    workers: Vec<JoinHandle<()>>,
    /// The process that has the threads.
    process: u32,
}

struct Shared {
    /// Number of tasks in the upper half, number of those that are taken in the lower half.
    tasks: AtomicU32,
    finished: AtomicU32,
    /// Whether a task panicked.
    failed: AtomicBool,
    /// Whether a caller uses the team.
    in_use: AtomicBool,
    /// Whether the workers are to end.
    ending: AtomicBool,
    /// For each worker, whether it is parked or about to park.
    parked: Box<[AtomicBool]>,
    job: UnsafeCell<Job>,
}

/// How to run the tasks of a call. `data` is valid from the publication of the tasks until all of them are finished.
#[derive(Clone, Copy)]
struct Job {
    /// Runs the task with the given number.
    run: unsafe fn(*const (), usize),
    data: *const (),
}

// SAFETY: `job` is the only part that is not `Sync`. It is written only by the caller that set `in_use`, while no task
// is taken, and read only by threads that have taken a task. The compare-and-exchange that takes a task synchronises with
// the store that publishes the tasks after the write.
unsafe impl Sync for Shared {}
// SAFETY: as above; no part belongs to a particular thread. `for_each` requires tasks that are `Send` and a function
// that is `Sync`.
unsafe impl Send for Shared {}

impl Team {
    /// Makes a team of `size` threads, one of which is the caller of [`for_each`](Self::for_each). The threads that this
    /// function starts are called `fw-net-1`, `fw-net-2` and so on. They inherit the scheduling policy and the CPU affinity
    /// of the calling thread.
    ///
    /// # Errors
    /// The system's error if it refuses a thread.
    pub fn new(size: usize) -> io::Result<Self> {
        let workers = size.saturating_sub(1);
        let shared = Arc::new(Shared {
            tasks: AtomicU32::new(0),
            finished: AtomicU32::new(0),
            failed: AtomicBool::new(false),
            in_use: AtomicBool::new(false),
            ending: AtomicBool::new(false),
            parked: (0..workers).map(|_| AtomicBool::new(false)).collect(),
            job: UnsafeCell::new(Job { run: |_, _| {}, data: ptr::null() }),
        });
        let mut team = Self { shared, workers: Vec::with_capacity(workers), process: process::id() };
        for number in 0..workers {
            let shared = Arc::clone(&team.shared);
            let builder = thread::Builder::new().name(format!("fw-net-{}", number + 1)).stack_size(STACK_BYTES);
            team.workers.push(builder.spawn(move || shared.work(number))?);
        }
        Ok(team)
    }

    /// Number of threads, the caller included.
    #[must_use]
    pub fn size(&self) -> usize {
        self.workers.len() + 1
    }

    /// The threads besides the caller, for example to set their priority.
    #[must_use]
    pub fn workers(&self) -> &[JoinHandle<()>] {
        &self.workers
    }

    /// Calls `run` once for each task, on the threads of the team. If the team is already in use, by another thread or by
    /// a task that makes this call, the calling thread runs all tasks itself.
    ///
    /// # Panics
    /// If a task panics, after all other tasks have finished.
    pub fn for_each<T: Send>(&self, tasks: &mut [T], run: impl Fn(&mut T) + Sync) {
        let count = u16::try_from(tasks.len()).ok().filter(|count| *count > 1 && !self.workers.is_empty());
        let Some(count) = count.filter(|_| !self.shared.in_use.swap(true, Ordering::Acquire)) else {
            return tasks.iter_mut().for_each(run);
        };
        let batch = Batch { tasks: tasks.as_mut_ptr(), run: &run };
        let job = Job { run: run_task_of(&batch), data: (&raw const batch).cast() };
        // SAFETY: `in_use` was not set, so that no other caller writes the job, and no task is taken.
        unsafe { *self.shared.job.get() = job }
        self.shared.finished.store(0, Ordering::Relaxed);
        // Sequentially consistent, as are the other accesses to `tasks` and `parked` on which parking depends: either a
        // worker that is about to park sees the tasks, or this thread sees that the worker parks.
        self.shared.tasks.store(u32::from(count) << 16, Ordering::SeqCst);
        self.wake();
        while self.shared.run_next() {}
        self.shared.await_finished(u32::from(count));
        let failed = self.shared.failed.swap(false, Ordering::Relaxed);
        self.shared.in_use.store(false, Ordering::Release);
        if failed {
            let payload: Box<dyn Any + Send> = Box::new("a task of the team panicked");
            resume_unwind(payload);
        }
    }

    fn wake(&self) {
        for (worker, parked) in self.workers.iter().zip(&self.shared.parked) {
            if parked.load(Ordering::SeqCst) && parked.swap(false, Ordering::SeqCst) {
                worker.thread().unpark();
            }
        }
    }
}

impl Drop for Team {
    fn drop(&mut self) {
        if self.process != process::id() {
            // To wait for a thread of another process ends in a panic.
            return mem::forget(mem::take(&mut self.workers));
        }
        self.shared.ending.store(true, Ordering::SeqCst);
        for worker in self.workers.drain(..) {
            worker.thread().unpark();
            // A worker catches the panics of its tasks, so it ends without an error.
            let _ = worker.join();
        }
    }
}

/// The tasks of one call and the function that runs them.
struct Batch<'a, T, F> {
    tasks: *mut T,
    run: &'a F,
}

/// Returns the function that runs a task of a batch of this type.
fn run_task_of<T: Send, F: Fn(&mut T) + Sync>(_: &Batch<T, F>) -> unsafe fn(*const (), usize) {
    /// # Safety
    /// `data` must point at a `Batch<T, F>` with more than `index` tasks, and no other thread may use this task.
    unsafe fn run_task<T, F: Fn(&mut T)>(data: *const (), index: usize) {
        // SAFETY: the caller vouches for the pointer.
        let batch = unsafe { &*data.cast::<Batch<T, F>>() };
        // SAFETY: the caller vouches for the index, and that nobody else uses the task.
        (batch.run)(unsafe { &mut *batch.tasks.add(index) });
    }
    run_task::<T, F>
}

impl Shared {
    /// Takes a task and runs it. Returns `false` if there is none.
    fn run_next(&self) -> bool {
        let mut tasks = self.tasks.load(Ordering::SeqCst);
        loop {
            let (count, taken) = (tasks >> 16, tasks & 0xffff);
            if taken >= count {
                return false;
            }
            match self.tasks.compare_exchange_weak(tasks, tasks + 1, Ordering::Acquire, Ordering::SeqCst) {
                Ok(_) => {
                    self.run_taken(taken as usize);
                    return true;
                }
                Err(now) => tasks = now,
            }
        }
    }

    /// Runs a task that this thread has taken.
    fn run_taken(&self, index: usize) {
        // SAFETY: the job does not change while a task is taken and not finished.
        let Job { run, data } = unsafe { *self.job.get() };
        // SAFETY: the caller of `for_each` keeps the batch until all tasks are finished. Only this thread has taken the
        // task with this number.
        let outcome = catch_unwind(AssertUnwindSafe(|| unsafe { run(data, index) }));
        if outcome.is_err() {
            self.failed.store(true, Ordering::Relaxed);
        }
        self.finished.fetch_add(1, Ordering::Release);
    }

    /// Waits until the workers have finished their tasks. If a worker takes long, because the system does not run it, the
    /// calling thread sleeps between polls: it may have a higher priority than the worker and occupy the worker's CPU.
    fn await_finished(&self, count: u32) {
        let is_finished = || self.finished.load(Ordering::Acquire) == count;
        while !poll(is_finished) {
            thread::sleep(POLLING);
        }
    }

    /// Runs tasks on a worker until the team is dropped.
    fn work(&self, number: usize) {
        let Some(parked) = self.parked.get(number) else { return };
        let is_ending = || self.ending.load(Ordering::SeqCst);
        while !is_ending() {
            if self.run_next() || poll(|| self.has_task() || is_ending()) {
                continue;
            }
            parked.store(true, Ordering::SeqCst);
            if !self.has_task() && !is_ending() {
                thread::park();
            }
            parked.store(false, Ordering::SeqCst);
        }
    }

    fn has_task(&self) -> bool {
        let tasks = self.tasks.load(Ordering::SeqCst);
        tasks & 0xffff < tasks >> 16
    }
}

/// Polls a condition for at most about [`POLLING`]. Returns whether the condition holds.
fn poll(holds: impl Fn() -> bool) -> bool {
    let mut start = None;
    loop {
        for _ in 0..POLLS {
            if holds() {
                return true;
            }
            hint::spin_loop();
        }
        if start.get_or_insert_with(Instant::now).elapsed() > POLLING {
            return false;
        }
    }
}

#[cfg(test)]
mod tests;
