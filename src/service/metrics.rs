//! Counts and times by HTTP, in the text format of `OpenMetrics`, for Prometheus and its kin. Off by default.
//!
//! Role: a thread `fw-metrics` that answers `GET /metrics`. It reads the counters and touches nothing else.
//! Contract: one connection at a time, half a second and 4 KB for each; then it is closed. A place that cannot be
//! listened at, as when another program does, is told once and tried again every second: it is no reason to stop a face.
//! Limits: no encryption and no password, hence reachable from this machine only.

mod listener;
mod page;
mod request;

use std::io::{self, PipeReader, PipeWriter, Write as _, pipe};
use std::os::fd::AsFd as _;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use self::listener::{Listener, Peer};
use self::page::Page;
use super::counters::Counters;
use crate::config::Listen;

/// How long to wait before the place, or a reader, is tried again.
const RETRY: Timespec = Timespec { tv_sec: 1, tv_nsec: 0 };
/// How long one reader may take.
const PATIENCE: Duration = Duration::from_millis(500);
/// All that the thread keeps on its stack is a request and the way to it; locked memory has all of the stack in RAM.
const STACK_BYTES: usize = 256 << 10;

/// The thread; it ends when this is dropped.
#[derive(Debug)]
pub(super) struct Metrics {
    stop: Option<PipeWriter>,
    thread: Option<JoinHandle<()>>,
}

impl Metrics {
    /// Starts the thread.
    ///
    /// # Errors
    /// The system gives no thread or no pipe.
    pub(super) fn start(listen: Listen, counters: &Arc<Counters>) -> io::Result<Self> {
        let (stopped, stop) = pipe()?;
        let server = Server { listen, page: Page::new(Arc::clone(counters)), stopped };
        let builder = Builder::new().name("fw-metrics".to_owned()).stack_size(STACK_BYTES);
        let thread = builder.spawn(move || server.run())?;
        Ok(Self { stop: Some(stop), thread: Some(thread) })
    }
}

impl Drop for Metrics {
    /// A reader who is there holds it up for half a second at most.
    fn drop(&mut self) {
        self.stop = None;
        // It logs what goes wrong, and nobody relies on it.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

struct Server {
    listen: Listen,
    page: Page,
    /// Closed at its other end to stop this one.
    stopped: PipeReader,
}

impl Server {
    fn run(self) {
        let Some(listener) = self.listener() else { return };
        tracing::info!("metrics at {}", self.listen);
        while self.wait(&listener).is_ok_and(|waits| waits) {
            match listener.accept(PATIENCE) {
                // A reader that goes away again, or is slow, is no matter.
                Ok(peer) => self.answer(peer).unwrap_or_else(|error| tracing::debug!("metrics were not read: {error}")),
                // A reader who cannot be taken, as when there are no more descriptors, is still there the next moment.
                Err(_) if self.is_stopped_within(RETRY) => return,
                Err(error) => tracing::debug!("a reader of the metrics was not taken: {error}"),
            }
        }
    }

    /// Waits, unless told to stop.
    fn is_stopped_within(&self, time: Timespec) -> bool {
        poll(&mut [PollFd::new(&self.stopped, PollFlags::IN)], Some(&time)) != Ok(0)
    }

    /// Tries until there is one; `None` when told to stop.
    fn listener(&self) -> Option<Listener> {
        let mut is_told = false;
        loop {
            match Listener::bind(&self.listen) {
                Ok(listener) => return Some(listener),
                Err(error) if !is_told => {
                    let at = &self.listen;
                    tracing::warn!(
                        "no metrics at {at} ({error}): free it or give metrics.listen another; trying again"
                    );
                    is_told = true;
                }
                Err(_) => {}
            }
            if self.is_stopped_within(RETRY) {
                return None;
            }
        }
    }

    /// Waits for a reader; `false` when told to stop.
    fn wait(&self, listener: &Listener) -> io::Result<bool> {
        let listener = listener.as_fd();
        let mut waiting = [PollFd::new(&self.stopped, PollFlags::IN), PollFd::new(&listener, PollFlags::IN)];
        while let Err(error) = poll(&mut waiting, None) {
            if error != rustix::io::Errno::INTR {
                return Err(error.into());
            }
        }
        let [stopped, _] = waiting;
        Ok(stopped.revents().is_empty())
    }

    fn answer(&self, mut peer: Peer) -> io::Result<()> {
        let answer = match request::read(&mut peer)? {
            Ok(()) => request::found(page::CONTENT_TYPE, &self.page.text()),
            Err(refusal) => refusal.answer(),
        };
        peer.write_all(answer.as_bytes())
    }
}
