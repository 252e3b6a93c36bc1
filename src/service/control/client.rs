//! A client of the control thread, by the control socket or by HTTP.

use std::fs::File;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::{Duration, Instant};

use super::protocol::{MAX_LINE, Reply, Request};
use crate::service::metrics::MAX_REQUEST_BYTES;

/// What a client speaks, which is also an index into the doors of the server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Speaks {
    /// Lines of JSON.
    Requests,
    /// HTTP, to read the metrics.
    Http,
}

/// A connection that never blocks. What the client does not take at once waits in `output`.
#[derive(Debug)]
pub(super) struct Client {
    stream: File,
    pub(super) speaks: Speaks,
    pub(super) input: Vec<u8>,
    output: Vec<u8>,
    /// Since when the service waits for the client: for its request, or until it takes what it was sent.
    since: Instant,
}

impl Client {
    pub(super) fn new(stream: File, speaks: Speaks) -> Self {
        Self { stream, speaks, input: Vec::new(), output: Vec::new(), since: Instant::now() }
    }

    /// Reads what has come of a request. Returns whether the client has ended its side, or cannot send more.
    pub(super) fn receive(&mut self) -> io::Result<bool> {
        let most = if self.speaks == Speaks::Http { MAX_REQUEST_BYTES } else { MAX_LINE };
        let mut bytes = [0; MAX_REQUEST_BYTES];
        let free = bytes.get_mut(..most.saturating_sub(self.input.len())).unwrap_or_default();
        match self.stream.read(free) {
            Ok(count) => {
                self.input.extend_from_slice(free.get(..count).unwrap_or_default());
                Ok(count == 0 || self.input.len() >= most)
            }
            Err(error) if is_later(&error) => Ok(false),
            Err(error) => Err(error),
        }
    }

    /// What the client asks in the line that has come, or why it cannot be understood. `None` if it is not complete yet.
    pub(super) fn request(&self) -> Option<Result<Request, String>> {
        let end = self.input.iter().position(|byte| *byte == b'\n');
        if let Some(line) = end.and_then(|end| self.input.get(..end)) {
            let read = serde_json::from_slice(line);
            return Some(read.map_err(|error| format!("the request is not understood: {error}")));
        }
        (self.input.len() >= MAX_LINE).then(|| Err(format!("the request has more than {MAX_LINE} bytes")))
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

    /// Whether the service has waited for the client for this time.
    pub(super) fn has_waited(&self, time: Duration) -> bool {
        self.since.elapsed() > time
    }

    /// Whether the client has not yet taken all that it was sent.
    pub(super) fn is_behind(&self) -> bool {
        !self.output.is_empty()
    }

    /// Sends a line.
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

    /// Sends on what the client has not taken.
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

impl AsFd for Client {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.stream.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use std::os::fd::OwnedFd;
    use std::os::unix::net::UnixStream;

    use super::*;

    fn pair() -> (Client, UnixStream) {
        let (server, client) = UnixStream::pair().unwrap();
        server.set_nonblocking(true).unwrap();
        (Client::new(OwnedFd::from(server).into(), Speaks::Requests), client)
    }

    #[test]
    fn request_in_pieces_is_read_when_its_line_is_complete() {
        let (mut client, mut far) = pair();
        for (piece, want) in [("", None), (r#"{"do":"#, None), ("\"list\"}\n", Some(Ok(Request::List {})))] {
            far.write_all(piece.as_bytes()).unwrap();
            assert!(!client.receive().unwrap());
            assert_eq!(client.request(), want);
        }
    }

    #[test]
    fn nonsense_and_endless_lines_are_refused() {
        for (sent, why) in [(b"hello\n".to_vec(), "not understood"), (vec![b'x'; 4 * MAX_LINE], "bytes")] {
            let (mut client, mut far) = pair();
            far.write_all(&sent).unwrap();
            client.receive().unwrap();
            assert!(client.request().unwrap().unwrap_err().contains(why));
        }
    }

    #[test]
    fn client_that_does_not_read_is_behind_until_it_does_and_one_that_has_gone_is_told_from_it() {
        let (mut client, mut far) = pair();
        let [patience, none] = [Duration::from_secs(60), Duration::ZERO];
        assert!(!client.has_gone(none), "there is nothing to read");
        let text = "x".repeat(1 << 20);
        client.send(&Reply::Done(text.clone())).unwrap();
        assert!(client.is_behind() && !client.has_gone(patience) && client.has_gone(none));
        far.set_nonblocking(true).unwrap();
        let mut read = Vec::new();
        while client.is_behind() {
            let _ = far.read_to_end(&mut read);
            client.flush().unwrap();
        }
        let _ = far.read_to_end(&mut read);
        assert!(read.ends_with(b"\"}\n") && read.len() > text.len());
        drop(far);
        assert!(client.has_gone(patience) && client.receive().unwrap());
    }
}
