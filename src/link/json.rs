//! The carriers of JSON lines on this machine: standard output, and a Unix socket.
//!
//! Both may block, so each has the thread of a [`Background`](super::Background). A reader of standard output that is slow
//! gets the newest line only. A client of the socket that is slow misses whole lines, and one that takes nothing for
//! [`LONGEST_WAIT`] is disconnected; it delays no other.

use std::io::{self, ErrorKind, Write as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use facewire_packet::control::SYSTEM_FOLDER;

use super::background::Device;
use super::{LinkError, LinkErrorKind};
use crate::config::Listen;
use crate::listener::Listener;

/// Most clients of a socket at a time. Further ones are disconnected.
const MOST_CLIENTS: usize = 8;
/// Most clients that are accepted or disconnected between two lines, so that a crowd delays no connected client.
const MOST_AT_ONCE: usize = 16;
const LONGEST_WAIT: Duration = Duration::from_secs(5);

pub struct Stdout;

impl Device for Stdout {
    type Open = ();

    fn open(&mut self) -> Result<(), LinkError> {
        Ok(())
    }

    fn write(&mut self, (): &mut (), message: &[u8]) -> Result<bool, LinkError> {
        let mut out = io::stdout().lock();
        let written = out.write_all(message).and_then(|()| out.flush());
        written.map(|()| true).map_err(|error| {
            let sentence = format!("it takes no lines ({error}); start a program that reads them");
            LinkError::new(LinkErrorKind::Output, "standard output", sentence)
        })
    }
}

/// Tests whether a socket can have its file there.
pub fn check(path: &Path) -> Result<(), LinkError> {
    let folder = path.parent().unwrap_or(path);
    if folder.is_dir() {
        return Ok(());
    }
    let is_runtime = folder.as_os_str() == SYSTEM_FOLDER;
    let (kind, remedy) = if is_runtime {
        (LinkErrorKind::Waiting, "it is there once the service runs")
    } else {
        (LinkErrorKind::Other, "make it, or give another path")
    };
    let sentence = format!("there is no folder {}; {remedy}", folder.display());
    Err(LinkError::new(kind, path.display(), sentence))
}

pub struct Server {
    path: PathBuf,
    clients: Vec<Client>,
}

impl Server {
    pub fn new(path: &Path) -> Self {
        Self { path: path.to_owned(), clients: Vec::with_capacity(MOST_CLIENTS) }
    }
}

impl Device for Server {
    type Open = Listener;

    fn open(&mut self) -> Result<Listener, LinkError> {
        check(&self.path)?;
        let listener = Listener::bind(&Listen::Unix(self.path.clone()));
        listener.map_err(|error| LinkError::no_listener(self.path.display(), error))
    }

    fn write(&mut self, listener: &mut Listener, message: &[u8]) -> Result<bool, LinkError> {
        self.attend(listener)?;
        self.clients.retain_mut(|client| client.write(message).is_ok());
        Ok(true)
    }

    /// Accepts clients that wait, and disconnects those for whom there is no room. If the system cannot accept a client
    /// now, for example because this process has too many open files, a later call tries again.
    fn attend(&mut self, listener: &mut Listener) -> Result<(), LinkError> {
        for _ in 0..MOST_AT_ONCE {
            let Ok(stream) = listener.accept().map(UnixStream::from) else { break };
            if self.clients.len() < MOST_CLIENTS {
                self.clients.push(Client { stream, rest: Vec::new(), took_at: Instant::now() });
            }
        }
        Ok(())
    }
}

struct Client {
    stream: UnixStream,
    /// The part of a line that the client has not taken yet.
    rest: Vec<u8>,
    took_at: Instant,
}

impl Client {
    /// Writes the line, unless the client is still behind with an earlier one. Fails if the client has left, or takes
    /// nothing for too long.
    fn write(&mut self, line: &[u8]) -> io::Result<()> {
        let is_behind = !self.rest.is_empty();
        if !is_behind {
            self.rest.extend_from_slice(line);
        }
        match self.stream.write(&self.rest) {
            Ok(count) => {
                self.took_at = Instant::now();
                self.rest.drain(..count);
            }
            Err(error) if error.kind() != ErrorKind::WouldBlock || self.took_at.elapsed() > LONGEST_WAIT => {
                return Err(error);
            }
            // The client misses a line of which it took nothing.
            Err(_) if !is_behind => self.rest.clear(),
            Err(_) => {}
        }
        if is_behind && self.rest.is_empty() { self.write(line) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::Permissions;
    use std::io::{BufRead as _, BufReader, Read as _};
    use std::os::unix::fs::PermissionsExt as _;

    use super::*;
    use crate::link::testing::PATIENCE;

    /// A socket that is served only when the test calls it.
    struct Served {
        server: Server,
        listener: Listener,
        _folder: tempfile::TempDir,
    }

    impl Served {
        fn new() -> Self {
            let folder = tempfile::tempdir().unwrap();
            let mut server = Server::new(&folder.path().join("lines"));
            Self { listener: server.open().unwrap(), server, _folder: folder }
        }

        fn write(&mut self, number: u32, padding: usize) {
            assert!(self.server.write(&mut self.listener, format!("{number:0padding$}\n").as_bytes()).unwrap());
        }

        fn connected(&self) -> BufReader<UnixStream> {
            let stream = UnixStream::connect(&self.server.path).unwrap();
            stream.set_read_timeout(Some(PATIENCE)).unwrap();
            BufReader::new(stream)
        }
    }

    fn next(reader: &mut BufReader<UnixStream>) -> u32 {
        let mut line = String::new();
        reader.read_line(&mut line).unwrap();
        assert!(line.ends_with('\n'), "{line:?}");
        line.trim().parse().unwrap()
    }

    #[test]
    fn a_socket_whose_folder_is_not_there_is_reported_with_the_folder_and_is_there_once_somebody_makes_it() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("missing");
        let mut server = Server::new(&missing.join("lines"));
        let want = format!("there is no folder {}; make it, or give another path", missing.display());
        let told = server.open().err().unwrap().to_string();
        assert_eq!(told, format!("link {}: {want}", server.path.display()));
        std::fs::create_dir(&missing).unwrap();
        server.open().unwrap();
    }

    #[test]
    fn the_group_of_a_runtime_directory_that_is_shared_with_it_may_read_the_lines_and_nobody_else() {
        let folder = tempfile::tempdir().unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
        for (folder_mode, group_may) in [(0o710, true), (0o755, false), (0o700, false)] {
            std::fs::set_permissions(folder.path(), Permissions::from_mode(folder_mode)).unwrap();
            let mut server = Server::new(&folder.path().join("lines"));
            let _listener = server.open().unwrap();
            let mode = mode(&server.path);
            // Nobody can connect without the right to write.
            assert_eq!((mode == 0o660, mode & 0o002), (group_may, 0), "{folder_mode:o} {mode:o}");
        }
    }

    #[test]
    fn a_client_that_reads_nothing_delays_no_other_and_later_reads_whole_lines() {
        let mut served = Served::new();
        let [mut slow, mut quick, _idle] = [(); 3].map(|()| served.connected());
        // Far more than the buffer of a socket holds.
        for number in 0..1000 {
            served.write(number, 2000);
            assert_eq!(next(&mut quick), number);
        }
        let mut gaps = 0;
        let mut before = next(&mut slow);
        for number in 1000..1400 {
            served.write(number, 2000);
            let number = next(&mut slow);
            assert!(number > before);
            gaps += u32::from(number > before + 100);
            before = number;
        }
        assert_eq!(gaps, 1, "the slow client missed lines");
        let long_ago = Instant::now().checked_sub(Duration::from_secs(6)).unwrap();
        served.server.clients.iter_mut().for_each(|client| client.took_at = long_ago);
        served.write(1400, 2000);
        assert_eq!(served.server.clients.len(), 1, "a client that takes nothing for too long is disconnected");
    }

    #[test]
    fn a_crowd_is_disconnected_in_parts_so_that_it_delays_no_line_and_leaving_makes_room() {
        let mut served = Served::new();
        let mut crowd: Vec<_> = (0..32).map(|_| UnixStream::connect(&served.server.path).unwrap()).collect();
        let is_disconnected = |client: &mut UnixStream| {
            client.set_nonblocking(true).unwrap();
            client.read(&mut [0; 1]).is_ok_and(|length| length == 0)
        };
        for most in [16, 32] {
            served.server.attend(&mut served.listener).unwrap();
            let disconnected = crowd.iter_mut().map(is_disconnected).filter(|is_gone| *is_gone).count();
            assert_eq!((served.server.clients.len(), disconnected), (8, most - 8));
        }
        drop(crowd);
        served.write(1, 0);
        let mut client = served.connected();
        served.write(2, 0);
        assert_eq!((served.server.clients.len(), next(&mut client)), (1, 2));
        // A TCP socket that is shut down accepts nobody, which stands for any error of the system.
        served.listener = Listener::bind(&Listen::Tcp(([127, 0, 0, 1], 0).into())).unwrap();
        rustix::net::shutdown(&served.listener.socket, rustix::net::Shutdown::Both).unwrap();
        assert_ne!(served.listener.accept().unwrap_err().kind(), ErrorKind::WouldBlock);
        served.write(3, 0);
        assert_eq!(next(&mut client), 3, "a client keeps its place while the system accepts no others");
    }
}
