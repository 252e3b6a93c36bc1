//! A client of the control socket.

use std::io::{self, ErrorKind, Read as _, Write as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use super::protocol::{MAX_LINE, Reply, Request};

/// Time in which a client must ask.
const PATIENCE: Duration = Duration::from_secs(2);

/// A connection that never blocks.
#[derive(Debug)]
pub(super) struct Client {
    stream: UnixStream,
    line: Vec<u8>,
    since: Instant,
}

impl Client {
    pub(super) fn new(stream: UnixStream) -> Self {
        Self { stream, line: Vec::with_capacity(MAX_LINE), since: Instant::now() }
    }

    /// Returns what the client asks, or why it cannot be understood. `None` if the request is not complete yet.
    ///
    /// # Errors
    /// The client has gone, or is too slow.
    pub(super) fn request(&mut self) -> io::Result<Option<Result<Request, String>>> {
        let mut bytes = [0; MAX_LINE];
        match self.stream.read(&mut bytes) {
            Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => self.line.extend_from_slice(bytes.get(..count).unwrap_or_default()),
            Err(error) if is_later(&error) => {}
            Err(error) => return Err(error),
        }
        let end = self.line.iter().position(|byte| *byte == b'\n');
        if let Some(line) = end.and_then(|end| self.line.get(..end)) {
            let read = serde_json::from_slice(line);
            return Ok(Some(read.map_err(|error| format!("the request is not understood: {error}"))));
        }
        if self.line.len() >= MAX_LINE {
            return Ok(Some(Err(format!("the request has more than {MAX_LINE} bytes"))));
        }
        if self.since.elapsed() > PATIENCE { Err(ErrorKind::TimedOut.into()) } else { Ok(None) }
    }

    /// Whether the client has closed the connection. What it sends is ignored.
    pub(super) fn has_gone(&mut self) -> bool {
        match self.stream.read(&mut [0; MAX_LINE]) {
            Ok(count) => count == 0,
            Err(error) => !is_later(&error),
        }
    }

    /// Sends a line.
    ///
    /// # Errors
    /// The client has gone, or does not read.
    pub(super) fn send(&mut self, reply: &Reply) -> io::Result<()> {
        let mut line = serde_json::to_vec(reply)?;
        line.push(b'\n');
        self.stream.write_all(&line)
    }

    /// Sends the last line. A client that does not read it harms only itself.
    pub(super) fn answer(&mut self, reply: &Reply) {
        let _ = self.send(reply);
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
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn pair() -> (Client, UnixStream) {
        let (server, client) = UnixStream::pair().unwrap();
        server.set_nonblocking(true).unwrap();
        (Client::new(server), client)
    }

    #[test]
    fn request_in_pieces_is_read_when_its_line_is_complete() {
        let (mut client, mut far) = pair();
        assert_eq!(client.request().unwrap(), None);
        far.write_all(br#"{"do":"#).unwrap();
        assert_eq!(client.request().unwrap(), None);
        far.write_all(b"\"list\"}\n").unwrap();
        assert_eq!(client.request().unwrap(), Some(Ok(Request::List {})));
    }

    #[test]
    fn nonsense_and_endless_lines_are_refused() {
        let (mut client, mut far) = pair();
        far.write_all(b"hello\n").unwrap();
        assert!(client.request().unwrap().unwrap().unwrap_err().contains("not understood"));
        let (mut client, mut far) = pair();
        far.write_all(&[b'x'; 4 * MAX_LINE]).unwrap();
        assert!(client.request().unwrap().unwrap().unwrap_err().contains("bytes"));
    }

    #[test]
    fn client_that_has_gone_and_one_that_does_not_read_are_told_from_one_that_waits() {
        let (mut client, far) = pair();
        assert!(!client.has_gone());
        let flooded = (0..100_000).find_map(|_| client.send(&Reply::Done("x".repeat(200))).err()).unwrap();
        assert_eq!(flooded.kind(), ErrorKind::WouldBlock);
        drop(far);
        assert!(client.has_gone());
        assert!(client.request().is_err());
    }
}
