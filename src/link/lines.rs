//! Lines for programs on this machine: on standard output, and on a Unix socket.
//!
//! Both may block, so each has the thread of a [`Background`]. A reader of standard output that is slow gets the newest
//! line only. A client of the socket that is slow misses whole lines, and one that takes nothing for
//! [`LONGEST_WAIT`] is disconnected; it delays no other.

use std::{
    io::{self, ErrorKind, Write as _},
    mem,
    os::unix::net::UnixStream,
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use super::{Background, Device, LinkError, LinkErrorKind, Traffic};
use crate::config::Listen;
use crate::listener::Listener;

/// Most clients of a socket at a time. Further ones are disconnected.
const MOST_CLIENTS: usize = 8;
/// Most clients that are accepted or disconnected between two lines, so that a crowd delays no connected client.
const MOST_AT_ONCE: usize = 16;
/// Time after which a client that takes nothing is disconnected.
const LONGEST_WAIT: Duration = Duration::from_secs(5);

/// Starts the thread that writes to standard output.
pub fn stdout_carrier(traffic: Arc<Traffic>) -> Result<Background, LinkError> {
    Background::start("standard output".to_owned(), "fw-stdout", Stdout, true, traffic)
}

/// Starts the thread that serves a socket at this path.
pub fn socket_carrier(path: &Path, traffic: Arc<Traffic>) -> Result<Background, LinkError> {
    Background::start(path.display().to_string(), "fw-socket", Server::at(path), true, traffic)
}

/// The standard output of this process.
#[derive(Debug)]
struct Stdout;

impl Device for Stdout {
    fn open(&mut self) -> Result<(), LinkError> {
        Ok(())
    }

    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
        let mut out = io::stdout().lock();
        let written = out.write_all(message).and_then(|()| out.flush());
        written.map(|()| true).map_err(|error| {
            let sentence = format!("it takes no lines ({error}); start a program that reads them");
            LinkError::new(LinkErrorKind::Output, "standard output", sentence)
        })
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
    fn open(&mut self) -> Result<(), LinkError> {
        let listener = Listener::bind(&Listen::Unix(self.path.clone()));
        self.listener = Some(listener.map_err(|error| LinkError::no_listener(self.path.display(), error))?);
        Ok(())
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
    /// Writes the line, unless the client is still behind with an earlier one. Fails if the client has left, or takes
    /// nothing for too long.
    fn write(&mut self, line: &[u8]) -> io::Result<()> {
        let rest = mem::take(&mut self.rest);
        self.rest = self.take(&rest)?.to_vec();
        if self.rest.is_empty() {
            let left = self.take(line)?;
            // The client misses a line of which it took nothing.
            self.rest = if left.len() < line.len() { left.to_vec() } else { Vec::new() };
        }
        Ok(())
    }

    /// Writes as many bytes as the client takes. Returns those that are left.
    fn take<'a>(&mut self, bytes: &'a [u8]) -> io::Result<&'a [u8]> {
        if bytes.is_empty() {
            return Ok(bytes);
        }
        match self.stream.write(bytes) {
            Ok(count) => {
                self.took = Instant::now();
                Ok(bytes.get(count..).unwrap_or_default())
            }
            Err(error) if error.kind() == ErrorKind::WouldBlock && self.took.elapsed() <= LONGEST_WAIT => Ok(bytes),
            Err(error) => Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead as _, BufReader, Read as _};

    use super::*;
    use crate::link::Carrier as _;
    use crate::link::testing::{PATIENCE, eventually};

    /// A server that runs only when it is called, and its folder.
    fn server() -> (Server, tempfile::TempDir) {
        let folder = tempfile::tempdir().unwrap();
        let mut server = Server::at(&folder.path().join("lines"));
        server.open().unwrap();
        (server, folder)
    }

    fn connected(path: &Path) -> BufReader<UnixStream> {
        let stream = UnixStream::connect(path).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        BufReader::new(stream)
    }

    /// Returns the number in the next line.
    fn next(reader: &mut BufReader<UnixStream>) -> u32 {
        let mut line = String::new();
        reader.read_line(&mut line).unwrap();
        assert!(line.ends_with('\n'), "{line:?}");
        line.trim().parse().unwrap()
    }

    fn write(server: &mut Server, number: u32, padding: usize) {
        assert!(server.write(format!("{number:0padding$}\n").as_bytes()).unwrap());
    }

    #[test]
    fn a_link_serves_its_clients_and_its_file_goes_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        let mut carrier = socket_carrier(&path, Arc::default()).unwrap();
        eventually("the socket", || carrier.is_open());
        let mut clients = [connected(&path), connected(&path)];
        carrier.send(b"1\n");
        assert_eq!(clients.each_mut().map(next), [1, 1]);
        carrier.stop();
        eventually("the end of the carrier", || carrier.has_ended());
        assert!(!path.exists());
    }

    #[test]
    fn a_client_that_reads_nothing_delays_no_other_and_later_reads_whole_lines() {
        let (mut server, _folder) = server();
        let [mut slow, mut quick, _idle] = [(); 3].map(|()| connected(&server.path));
        // Far more than the buffer of a socket holds.
        for number in 0..1000 {
            write(&mut server, number, 2000);
            assert_eq!(next(&mut quick), number);
        }
        let (mut gaps, mut before) = (0, next(&mut slow));
        for number in 1000..1400 {
            write(&mut server, number, 2000);
            let number = next(&mut slow);
            assert!(number > before);
            gaps += u32::from(number > before + 100);
            before = number;
        }
        assert_eq!(gaps, 1, "the slow client missed lines");
        let long_ago = Instant::now().checked_sub(2 * LONGEST_WAIT).unwrap();
        server.clients.iter_mut().for_each(|client| client.took = long_ago);
        write(&mut server, 1400, 2000);
        assert_eq!(server.clients.len(), 1, "a client that takes nothing for too long is disconnected");
    }

    #[test]
    fn a_crowd_is_disconnected_in_parts_so_that_it_delays_no_line_and_leaving_makes_room() {
        let (mut server, _folder) = server();
        let mut crowd: Vec<_> = (0..2 * MOST_AT_ONCE).map(|_| UnixStream::connect(&server.path).unwrap()).collect();
        let is_disconnected = |client: &mut UnixStream| {
            client.set_nonblocking(true).unwrap();
            client.read(&mut [0; 1]).is_ok_and(|length| length == 0)
        };
        for most in [MOST_AT_ONCE, 2 * MOST_AT_ONCE] {
            server.attend().unwrap();
            let disconnected = crowd.iter_mut().map(is_disconnected).filter(|is_gone| *is_gone).count();
            assert_eq!((server.clients.len(), disconnected), (MOST_CLIENTS, most - MOST_CLIENTS));
        }
        drop(crowd);
        write(&mut server, 1, 0);
        let mut client = connected(&server.path);
        write(&mut server, 2, 0);
        assert_eq!((server.clients.len(), next(&mut client)), (1, 2));
    }

    #[test]
    fn clients_keep_their_places_while_the_system_accepts_no_others() {
        let (mut server, _folder) = server();
        let mut client = connected(&server.path);
        server.attend().unwrap();
        // A TCP listener accepts no client of a Unix socket, which stands for any error of the system.
        server.listener = Some(Listener::bind(&Listen::Tcp(([127, 0, 0, 1], 0).into())).unwrap());
        let refused = server.listener.as_ref().unwrap().accept_unix().unwrap_err();
        assert_ne!(refused.kind(), ErrorKind::WouldBlock);
        server.attend().unwrap();
        write(&mut server, 1, 0);
        assert_eq!(next(&mut client), 1);
    }
}
