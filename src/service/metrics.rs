//! Serves the service's counters and times over HTTP, in the `OpenMetrics` text format that Prometheus reads. Off by
//! default.
//!
//! The thread `fw-metrics` answers `GET /metrics`. It reads the counters and changes no other part of the service. It
//! serves one connection at a time, reads at most 4 KB of request, and closes each connection within half a second.
//! If it cannot listen, for example because another program uses the port, it logs this once and retries every second,
//! while the service runs on. There is no encryption and no password, so only this machine can connect.

mod page;
mod request;

use std::io::{self, PipeReader, PipeWriter, Write as _, pipe};
use std::os::fd::AsFd as _;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};

use self::page::Page;
use super::counters::Counters;
use super::listener::{Connection, Listener};
use crate::config::Listen;

/// Delay before the next attempt after listening or accepting a connection has failed.
const RETRY_DELAY: Timespec = Timespec { tv_sec: 1, tv_nsec: 0 };
/// How long one connection may last.
const CONNECTION_TIMEOUT: Duration = Duration::from_millis(500);
/// Stack size of the thread. It holds little more than one request, and with locked memory the whole stack stays in RAM.
const STACK_BYTES: usize = 256 << 10;

/// A handle to the metrics thread. Dropping the handle stops the thread.
#[derive(Debug)]
pub(super) struct Metrics {
    stop: Option<PipeWriter>,
    thread: Option<JoinHandle<()>>,
}

impl Metrics {
    /// Starts the thread.
    ///
    /// # Errors
    /// The system could not create a pipe or a thread.
    pub(super) fn start(listen: Listen, counters: &Arc<Counters>) -> io::Result<Self> {
        let (stop_signal, stop) = pipe()?;
        let server = Server { listen, page: Page::new(Arc::clone(counters)), stop_signal };
        let builder = Builder::new().name("fw-metrics".to_owned()).stack_size(STACK_BYTES);
        let thread = builder.spawn(move || server.run())?;
        Ok(Self { stop: Some(stop), thread: Some(thread) })
    }
}

impl Drop for Metrics {
    /// Blocks for at most half a second if a client is connected.
    fn drop(&mut self) {
        self.stop = None;
        // A panic of the thread is ignored: the service does not depend on its metrics.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

struct Server {
    listen: Listen,
    page: Page,
    /// [`Metrics`] closes the other end of this pipe to stop the thread.
    stop_signal: PipeReader,
}

impl Server {
    fn run(self) {
        let Some(listener) = self.bind() else { return };
        tracing::info!("metrics served at {}", self.listen);
        while self.wait_for_connection(&listener).is_ok_and(|is_waiting| is_waiting) {
            match listener.accept(CONNECTION_TIMEOUT) {
                // A client that disconnects or is too slow harms only itself.
                Ok(connection) => self
                    .respond(connection)
                    .unwrap_or_else(|error| tracing::debug!("a request for the metrics failed: {error}")),
                // A connection that cannot be accepted, for example for lack of a file descriptor, stays in the queue.
                // The delay keeps the loop from spinning.
                Err(_) if self.is_stopped_within(RETRY_DELAY) => return,
                Err(error) => tracing::debug!("a connection to the metrics was not accepted: {error}"),
            }
        }
    }

    /// Sleeps for `time`. Returns early, with `true`, if the thread is to stop.
    fn is_stopped_within(&self, time: Timespec) -> bool {
        poll(&mut [PollFd::new(&self.stop_signal, PollFlags::IN)], Some(&time)) != Ok(0)
    }

    /// Retries until the socket is open. Returns `None` if the thread is to stop.
    fn bind(&self) -> Option<Listener> {
        let mut has_warned = false;
        loop {
            match Listener::bind(&self.listen) {
                Ok(listener) => return Some(listener),
                Err(error) if !has_warned => {
                    let at = &self.listen;
                    tracing::warn!(
                        "no metrics at {at} ({error}): free the address or change metrics.listen; trying again every second"
                    );
                    has_warned = true;
                }
                Err(_) => {}
            }
            if self.is_stopped_within(RETRY_DELAY) {
                return None;
            }
        }
    }

    /// Waits for the next connection. Returns `false` if the thread is to stop.
    fn wait_for_connection(&self, listener: &Listener) -> io::Result<bool> {
        let listener = listener.as_fd();
        let mut polled = [PollFd::new(&self.stop_signal, PollFlags::IN), PollFd::new(&listener, PollFlags::IN)];
        while let Err(error) = poll(&mut polled, None) {
            if error != rustix::io::Errno::INTR {
                return Err(error.into());
            }
        }
        let [stop_signal, _] = polled;
        Ok(stop_signal.revents().is_empty())
    }

    fn respond(&self, mut connection: Connection) -> io::Result<()> {
        let response = match request::read(&mut connection)? {
            Ok(()) => request::ok(page::CONTENT_TYPE, &self.page.text()),
            Err(refusal) => refusal.response(),
        };
        connection.write_all(response.as_bytes())
    }
}
