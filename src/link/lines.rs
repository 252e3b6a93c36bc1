//! Lines for programs on this machine: on standard output, and on a Unix socket.
//!
//! Both may block, so each has the thread of a [`Background`]. A reader of standard output that is slow gets the newest
//! line only. A client of the socket that is slow misses whole lines, and one that takes nothing for
//! [`LONGEST_WAIT`] is disconnected; it delays no other.

use std::{
    io::{self, ErrorKind, Write as _},
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use super::{Background, Device, LinkError, Shared, Traffic};
use crate::config::Listen;
use crate::service::listener::Listener;

/// Most clients of a socket at a time. Further ones are disconnected.
const MOST_CLIENTS: usize = 8;
/// Most clients that are accepted or disconnected between two lines, so that a crowd of them delays no connected
/// client.
const MOST_AT_ONCE: usize = 16;
/// Time after which a client that takes nothing is disconnected.
const LONGEST_WAIT: Duration = Duration::from_secs(5);

/// Starts the thread that writes to standard output.
///
/// # Errors
/// Returns an error if the system refuses a thread.
pub fn stdout_carrier(traffic: Arc<Traffic>) -> Result<Background, LinkError> {
    Background::start("standard output".to_owned(), "fw-stdout", Stdout, true, traffic)
}

/// Starts the thread that serves a socket at this path.
///
/// # Errors
/// Returns an error if the system refuses a thread.
pub fn socket_carrier(path: &Path, traffic: Arc<Traffic>) -> Result<Background, LinkError> {
    Background::start(path.display().to_string(), "fw-socket", Server::at(path), true, traffic)
}

/// The standard output of this process.
#[derive(Debug)]
struct Stdout;

impl Device for Stdout {
    fn open(&mut self, _: &Shared) -> Result<bool, LinkError> {
        Ok(true)
    }

    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
        let mut out = io::stdout().lock();
        let written = out.write_all(message).and_then(|()| out.flush());
        written.map(|()| true).map_err(LinkError::Output)
    }

    fn close(&mut self) {}
}

/// A socket and the clients that have connected to it.
#[derive(Debug)]
struct Server {
    path: PathBuf,
    listener: Option<Listener>,
    clients: Vec<Client>,
}

impl Server {
    fn at(path: &Path) -> Self {
        Self { path: path.to_owned(), listener: None, clients: Vec::with_capacity(MOST_CLIENTS) }
    }

    /// Accepts clients that wait, and disconnects those for whom there is no room. If the system cannot accept a client
    /// now, for example because this process has too many open files, a later call tries again.
    fn welcome(&mut self) {
        let Some(listener) = &self.listener else { return };
        for _ in 0..MOST_AT_ONCE {
            let Ok(stream) = listener.accept_unix() else { return };
            if self.clients.len() < MOST_CLIENTS {
                self.clients.push(Client { stream, rest: Vec::new(), took: Instant::now() });
            }
        }
    }
}

impl Device for Server {
    fn open(&mut self, _: &Shared) -> Result<bool, LinkError> {
        let listener = Listener::bind(&Listen::Unix(self.path.clone()));
        let fault = |error| LinkError::Listen { address: self.path.display().to_string(), error };
        self.listener = Some(listener.map_err(fault)?);
        Ok(true)
    }

    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
        self.welcome();
        self.clients.retain_mut(|client| client.write(message).is_ok());
        Ok(true)
    }

    fn attend(&mut self) -> Result<(), LinkError> {
        self.welcome();
        Ok(())
    }

    fn close(&mut self) {
        self.clients.clear();
        self.listener = None;
    }
}

/// A program that reads lines.
#[derive(Debug)]
struct Client {
    stream: UnixStream,
    /// The rest of a line that the client has taken only in part.
    rest: Vec<u8>,
    /// When the client took bytes last.
    took: Instant,
}

impl Client {
    /// Writes the line, unless the client is still behind with an earlier one.
    ///
    /// # Errors
    /// Returns an error if the client has left, or takes nothing for too long.
    fn write(&mut self, line: &[u8]) -> io::Result<()> {
        let rest = std::mem::take(&mut self.rest);
        self.rest = self.take(&rest)?.to_vec();
        if self.rest.is_empty() {
            let left = self.take(line)?.to_vec();
            // The client misses a line of which it took nothing.
            self.rest = if left.len() < line.len() { left } else { Vec::new() };
        }
        if self.took.elapsed() > LONGEST_WAIT { Err(ErrorKind::TimedOut.into()) } else { Ok(()) }
    }

    /// Writes as many bytes as the client takes. Returns those that are left.
    fn take<'a>(&mut self, mut bytes: &'a [u8]) -> io::Result<&'a [u8]> {
        while !bytes.is_empty() {
            match self.stream.write(bytes) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => {
                    self.took = Instant::now();
                    bytes = bytes.get(count..).unwrap_or_default();
                }
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
        Ok(bytes)
    }
}

#[cfg(test)]
mod tests;
