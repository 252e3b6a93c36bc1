//! Sockets on which readers of the metrics come, and their connections.

use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::FileTypeExt as _;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};

use crate::config::Listen;

/// An open socket.
#[derive(Debug)]
pub(super) enum Listener {
    Tcp(TcpListener),
    /// With its file, which goes when this goes.
    Unix(UnixListener, PathBuf),
}

impl Listener {
    /// Opens the socket. The file that a service left behind when it was killed is replaced; any other file, and the
    /// socket of one that runs, stays.
    pub(super) fn bind(listen: &Listen) -> io::Result<Self> {
        match listen {
            Listen::Off => Err(ErrorKind::AddrNotAvailable.into()),
            Listen::Tcp(address) => {
                let listener = TcpListener::bind(address)?;
                listener.set_nonblocking(true)?;
                Ok(Self::Tcp(listener))
            }
            Listen::Unix(path) => {
                if is_stale(path) {
                    fs::remove_file(path)?;
                }
                let listener = UnixListener::bind(path)?;
                listener.set_nonblocking(true)?;
                Ok(Self::Unix(listener, path.clone()))
            }
        }
    }

    /// The reader who waits, to be served within `patience`.
    pub(super) fn accept(&self, patience: Duration) -> io::Result<Peer> {
        let stream: Box<dyn Stream> = match self {
            Self::Tcp(listener) => Box::new(listener.accept()?.0),
            Self::Unix(listener, _) => Box::new(listener.accept()?.0),
        };
        Ok(Peer { stream, end: Instant::now() + patience })
    }
}

/// Whether this is a socket at which nobody listens any more.
fn is_stale(path: &Path) -> bool {
    let is_socket = fs::symlink_metadata(path).is_ok_and(|file| file.file_type().is_socket());
    is_socket && knock(path) == Err(Errno::CONNREFUSED)
}

/// Connects, without waiting for one who listens and is busy.
fn knock(path: &Path) -> rustix::io::Result<()> {
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    connect(socket, &SocketAddrUnix::new(path)?)
}

impl AsFd for Listener {
    fn as_fd(&self) -> BorrowedFd<'_> {
        match self {
            Self::Tcp(listener) => listener.as_fd(),
            Self::Unix(listener, _) => listener.as_fd(),
        }
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        if let Self::Unix(_, path) = self {
            // If it does not go, the next service takes it for what it is.
            let _ = fs::remove_file(path);
        }
    }
}

/// A connection of either kind.
trait Stream: Read + Write {
    fn set_timeout(&self, timeout: Duration) -> io::Result<()>;
}

impl Stream for TcpStream {
    fn set_timeout(&self, timeout: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(timeout))?;
        self.set_write_timeout(Some(timeout))
    }
}

impl Stream for UnixStream {
    fn set_timeout(&self, timeout: Duration) -> io::Result<()> {
        self.set_read_timeout(Some(timeout))?;
        self.set_write_timeout(Some(timeout))
    }
}

/// A reader of the metrics, until its time is over: however it dribbles, it holds up nobody for longer.
pub(super) struct Peer {
    stream: Box<dyn Stream>,
    end: Instant,
}

impl Peer {
    /// The connection, if there is time left.
    fn in_time(&mut self) -> io::Result<&mut dyn Stream> {
        let left = self.end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        self.stream.set_timeout(left)?;
        Ok(&mut *self.stream)
    }
}

impl Read for Peer {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.in_time()?.read(bytes)
    }
}

impl Write for Peer {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.in_time()?.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.stream.flush()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn unix(path: &Path) -> Listen {
        Listen::Unix(path.to_owned())
    }

    #[test]
    fn the_socket_of_a_service_that_was_killed_is_replaced_and_goes_with_the_new_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.sock");
        drop(UnixListener::bind(&path).unwrap());
        assert!(path.exists(), "the system leaves it there");
        let listener = Listener::bind(&unix(&path)).unwrap();
        UnixStream::connect(&path).unwrap();
        drop(listener);
        assert!(!path.exists());
    }

    #[test]
    fn a_socket_in_use_and_a_file_that_is_none_stay_as_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let [socket, file] = ["metrics.sock", "notes.txt"].map(|name| folder.path().join(name));
        let _other = UnixListener::bind(&socket).unwrap();
        fs::write(&file, "mine").unwrap();
        for path in [&socket, &file] {
            assert_eq!(Listener::bind(&unix(path)).unwrap_err().kind(), ErrorKind::AddrInUse);
        }
        UnixStream::connect(&socket).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
    }

    #[test]
    fn a_reader_that_says_nothing_is_given_up_in_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.sock");
        let listener = Listener::bind(&unix(&path)).unwrap();
        let _silent = UnixStream::connect(&path).unwrap();
        let mut peer = listener.accept(Duration::from_millis(20)).unwrap();
        let error = peer.read(&mut [0; 1]).unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut));
        std::thread::sleep(Duration::from_millis(20));
        assert_eq!(peer.read(&mut [0; 1]).unwrap_err().kind(), ErrorKind::TimedOut);
    }
}
