//! Loads networks, models and profiles on a thread of its own, because that may take seconds.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{self, Receiver};
use std::thread::Builder;

use super::STACK_BYTES;

/// The thread that loads networks, models and profiles. It is one for all of them because the C library gives each thread
/// a heap of its own, and keeps what was once in use there. It has neither the priority nor the CPU of the hot loop,
/// which the helper threads of the networks would inherit.
#[derive(Debug, Clone)]
pub(super) struct Loader(mpsc::Sender<Box<dyn FnOnce() + Send>>);

impl Loader {
    pub(super) fn start() -> io::Result<Self> {
        let (jobs, to_do) = mpsc::channel::<Box<dyn FnOnce() + Send>>();
        let run = || to_do.into_iter().for_each(|job| drop(catch_unwind(AssertUnwindSafe(job))));
        Builder::new().name("fw-load".to_owned()).stack_size(STACK_BYTES).spawn(run)?;
        Ok(Self(jobs))
    }

    /// Begins a job. Its result never comes if it panics.
    pub(super) fn begin<T: Send + 'static>(&self, job: impl FnOnce() -> T + Send + 'static) -> Receiver<T> {
        let (done, result) = mpsc::channel();
        // Nobody waits for the result any more if the service ends meanwhile.
        let _ = self.0.send(Box::new(move || drop(done.send(job()))));
        result
    }
}
