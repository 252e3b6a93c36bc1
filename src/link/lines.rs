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
    let server = Server { path: path.to_owned(), listener: None, clients: Vec::with_capacity(MOST_CLIENTS) };
    Background::start(path.display().to_string(), "fw-socket", server, true, traffic)
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
    fn fault(&self, error: io::Error) -> LinkError {
        LinkError::Listen { address: self.path.display().to_string(), error }
    }

    /// Welcomes the clients that wait. Those for whom there is no room are disconnected.
    fn welcome(&mut self) -> io::Result<()> {
        let Some(listener) = &self.listener else { return Ok(()) };
        loop {
            match listener.accept_unix() {
                Ok(stream) if self.clients.len() < MOST_CLIENTS => {
                    self.clients.push(Client { stream, rest: Vec::new(), took: Instant::now() });
                }
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) => return Err(error),
            }
        }
    }
}

impl Device for Server {
    fn open(&mut self, _: &Shared) -> Result<bool, LinkError> {
        let listener = Listener::bind(&Listen::Unix(self.path.clone())).map_err(|error| self.fault(error));
        self.listener = Some(listener?);
        Ok(true)
    }

    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
        self.attend()?;
        self.clients.retain_mut(|client| client.write(message).is_ok());
        Ok(true)
    }

    fn attend(&mut self) -> Result<(), LinkError> {
        self.welcome().map_err(|error| self.fault(error))
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
    /// The end of a line of which the client took the beginning.
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
            // A line of which the client took nothing is one that it misses.
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
#[allow(clippy::unwrap_used)]
mod tests {
    use std::fs;
    use std::io::{BufRead as _, BufReader};
    use std::os::unix::net::UnixListener;
    use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
    use std::thread;

    use super::*;
    use crate::link::Carrier as _;

    /// Longer than any step takes on a busy machine.
    const PATIENCE: Duration = Duration::from_secs(10);

    fn eventually<T>(what: &str, mut happens: impl FnMut() -> Option<T>) -> T {
        let end = Instant::now() + PATIENCE;
        loop {
            if let Some(it) = happens() {
                return it;
            }
            assert!(Instant::now() < end, "{what}");
            thread::sleep(Duration::from_millis(1));
        }
    }

    fn connected(path: &Path) -> BufReader<UnixStream> {
        let stream = eventually("a connection", || UnixStream::connect(path).ok());
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        BufReader::new(stream)
    }

    /// Returns the number in the next line that arrives while the carrier sends numbered lines.
    fn next(reader: &mut BufReader<UnixStream>) -> u64 {
        let mut line = String::new();
        reader.read_line(&mut line).unwrap();
        assert!(line.ends_with('\n'), "{line:?}");
        line.trim().parse().unwrap()
    }

    /// A carrier that sends numbered lines from a thread until it is dropped.
    struct Sending(Arc<AtomicBool>, Option<thread::JoinHandle<()>>);

    impl Sending {
        fn start(path: &Path, padding: usize) -> Self {
            let over = Arc::<AtomicBool>::default();
            let (is_over, mut carrier) = (Arc::clone(&over), socket_carrier(path, Arc::default()).unwrap());
            let thread = thread::spawn(move || {
                for number in 0.. {
                    if is_over.load(Relaxed) {
                        break;
                    }
                    carrier.send(format!("{number:0padding$}\n").as_bytes());
                    thread::sleep(Duration::from_micros(200));
                }
                carrier.stop();
                eventually("the end of the carrier", || carrier.has_ended().then_some(()));
            });
            Self(over, Some(thread))
        }
    }

    impl Drop for Sending {
        fn drop(&mut self) {
            self.0.store(true, Relaxed);
            self.1.take().unwrap().join().unwrap();
        }
    }

    #[test]
    fn every_client_gets_whole_lines_in_order_and_the_file_goes_with_the_link() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        let sending = Sending::start(&path, 8);
        let mut clients = [connected(&path), connected(&path)];
        for client in &mut clients {
            let mut last = next(client);
            for _ in 0..20 {
                let number = next(client);
                assert!(number > last);
                last = number;
            }
        }
        drop(sending);
        assert!(!path.exists());
    }

    #[test]
    fn a_client_that_reads_nothing_delays_no_other_and_later_reads_whole_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        let _sending = Sending::start(&path, 2000);
        let mut slow = connected(&path);
        next(&mut slow);
        let mut quick = connected(&path);
        // Far more than the buffer of a socket holds.
        let mut last = next(&mut quick);
        for _ in 0..1000 {
            let number = next(&mut quick);
            assert!(number > last);
            last = number;
        }
        let (mut gaps, mut before) = (0, next(&mut slow));
        for _ in 0..400 {
            let number = next(&mut slow);
            gaps += u64::from(number > before + 100);
            before = number;
        }
        assert!(gaps > 0, "the slow client missed nothing");
    }

    #[test]
    fn clients_beyond_the_limit_are_disconnected_and_leaving_makes_room() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        let _sending = Sending::start(&path, 8);
        let mut clients: Vec<_> = (0..MOST_CLIENTS).map(|_| connected(&path)).collect();
        for client in &mut clients {
            next(client);
        }
        let mut line = String::new();
        assert_eq!(connected(&path).read_line(&mut line).unwrap_or(0), 0, "{line}");
        clients.pop();
        eventually("a free place", || {
            let mut line = String::new();
            connected(&path).read_line(&mut line).ok().filter(|length| *length > 0)
        });
    }

    #[test]
    fn a_stale_socket_is_replaced_and_any_other_file_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        drop(UnixListener::bind(&path).unwrap());
        let sending = Sending::start(&path, 8);
        next(&mut connected(&path));
        drop(sending);
        fs::write(&path, "mine").unwrap();
        let mut carrier = socket_carrier(&path, Arc::default()).unwrap();
        carrier.send(b"1\n");
        assert_eq!((carrier.is_open(), fs::read_to_string(&path).unwrap()), (false, "mine".to_owned()));
    }
}
