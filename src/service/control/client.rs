//! A connection of the control thread, which never blocks: to the control socket, one JSON value a line in both directions,
//! or by HTTP.

use std::fs::File;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::time::{Duration, Instant};

use facewire_packet::control::Reply;
use serde::de::DeserializeOwned;

pub(super) const MAX_LINE: usize = 256;
/// Longest line of a client that drives. All coefficients by their names take half of it.
pub(super) const MAX_DRIVE_LINE: usize = 4096;
/// Time in which a client must ask, and in which it must take the answer.
const ASK_PATIENCE: Duration = Duration::from_secs(2);
const HTTP_PATIENCE: Duration = Duration::from_millis(500);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Speaks {
    Requests,
    Http,
}

/// A connection that never blocks. What the client does not take at once waits in `output`.
pub(super) struct Client {
    stream: File,
    pub(super) speaks: Speaks,
    pub(super) input: Vec<u8>,
    output: Vec<u8>,
    /// Since when the service waits for the client: for its request, or until it takes what it was sent.
    pub(super) since: Instant,
}

impl Client {
    pub(super) fn new(stream: File, speaks: Speaks) -> Self {
        Self { stream, speaks, input: Vec::new(), output: Vec::new(), since: Instant::now() }
    }

    pub(super) fn patience(&self) -> Duration {
        if self.speaks == Speaks::Http { HTTP_PATIENCE } else { ASK_PATIENCE }
    }

    /// Reads what has come of a request of at most so many bytes. Returns whether the client has ended its side.
    pub(super) fn receive(&mut self, most_bytes: usize) -> io::Result<bool> {
        let left = most_bytes.saturating_sub(self.input.len());
        match (&self.stream).take(left as u64).read_to_end(&mut self.input) {
            Ok(count) => Ok(count < left),
            Err(error) if is_later(&error) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// What the client asks in the next line that has come, or why it cannot be understood. `None` if no line is complete.
    pub(super) fn request<T: DeserializeOwned>(&mut self, most_bytes: usize) -> Option<Result<T, String>> {
        if let Some(end) = self.input.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = self.input.drain(..=end).collect();
            self.since = Instant::now();
            let read = serde_json::from_slice(&line);
            return Some(read.map_err(|error| format!("the request is not understood: {error}")));
        }
        (self.input.len() >= most_bytes).then(|| Err(format!("the request has more than {most_bytes} bytes")))
    }

    /// Whether the client has closed the connection, or has not taken what it was sent for this time. What it sends is
    /// ignored.
    pub(super) fn has_gone(&mut self, patience: Duration) -> bool {
        let is_closed = match self.stream.read(&mut [0; MAX_LINE]) {
            Ok(count) => count == 0,
            Err(error) => !is_later(&error),
        };
        is_closed || (self.is_behind() && self.has_waited(patience))
    }

    pub(super) fn has_waited(&self, time: Duration) -> bool {
        self.since.elapsed() > time
    }

    pub(super) fn is_behind(&self) -> bool {
        !self.output.is_empty()
    }

    pub(super) fn send(&mut self, reply: &Reply) -> io::Result<()> {
        let mut line = serde_json::to_vec(reply)?;
        line.push(b'\n');
        self.send_bytes(&line)
    }

    pub(super) fn send_bytes(&mut self, bytes: &[u8]) -> io::Result<()> {
        if !self.is_behind() {
            self.since = Instant::now();
        }
        self.output.extend_from_slice(bytes);
        self.flush()
    }

    pub(super) fn flush(&mut self) -> io::Result<()> {
        while self.is_behind() {
            match self.stream.write(&self.output) {
                Ok(0) => return Err(ErrorKind::WriteZero.into()),
                Ok(count) => drop(self.output.drain(..count)),
                Err(error) if is_later(&error) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

fn is_later(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}
