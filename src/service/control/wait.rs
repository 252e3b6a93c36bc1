//! The task of a client that waits for an answer, above all for that of the loader's thread, which waits for the disk.

use std::error::Error;
use std::sync::mpsc::{Receiver, TryRecvError};

use facewire_packet::control::Reply;

use super::Task;
use crate::service::Loader;

/// A reply, and bytes that follow it.
pub(super) type Answer = (Reply, Vec<u8>);

pub(super) type Outcome<T> = Result<T, Box<dyn Error>>;

/// Begins work that needs the disk, on the loader's thread. The client waits for its outcome.
pub(super) fn begin(loader: &Loader, work: impl FnOnce() -> Outcome<Reply> + Send + 'static) -> Task {
    wait_for(loader.begin(|| work().unwrap_or_else(|refusal| Reply::Refused(refusal.to_string()))))
}

pub(super) fn wait_for(reply: Receiver<Reply>) -> Task {
    Task::Wait(Box::new(move || Some((poll_outcome(&reply)?.unwrap_or_else(Reply::Refused), Vec::new()))))
}

/// Returns the outcome of another thread's work, once there is one.
pub(super) fn poll_outcome<T>(outcome: &Receiver<T>) -> Option<Result<T, String>> {
    match outcome.try_recv() {
        Err(TryRecvError::Empty) => None,
        outcome => Some(outcome.map_err(|_| "it came to no end: see the log of the service".to_owned())),
    }
}
