//! A listening socket, TCP or Unix, and the connections accepted on it.

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

/// An open listening socket.
#[derive(Debug)]
pub enum Listener {
    Tcp(TcpListener),
    /// The socket and the path of its file, which is deleted on drop.
    Unix(UnixListener, PathBuf),
}

impl Listener {
    /// Opens the socket. A socket file without a listener, left behind by a service that was killed, is replaced. Any
    /// other file at the path, including a socket in use, is left untouched and makes `bind` fail.
    pub fn bind(listen: &Listen) -> io::Result<Self> {
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

    /// Accepts the waiting connection. Reading and writing fail once `timeout` has passed since the call.
    pub fn accept(&self, timeout: Duration) -> io::Result<Connection> {
        let stream: Box<dyn Stream> = match self {
            Self::Tcp(listener) => Box::new(listener.accept()?.0),
            Self::Unix(listener, _) => Box::new(listener.accept()?.0),
        };
        Ok(Connection { stream, deadline: Instant::now() + timeout })
    }
}

impl Listener {
    /// Accepts the waiting connection of a Unix socket. It does not block.
    pub fn accept_unix(&self) -> io::Result<UnixStream> {
        let Self::Unix(listener, _) = self else { return Err(ErrorKind::Unsupported.into()) };
        let stream = listener.accept()?.0;
        stream.set_nonblocking(true)?;
        Ok(stream)
    }
}

/// Returns whether `path` is a Unix socket on which no process listens any more.
fn is_stale(path: &Path) -> bool {
    let is_socket = fs::symlink_metadata(path).is_ok_and(|file| file.file_type().is_socket());
    is_socket && try_connect(path) == Err(Errno::CONNREFUSED)
}

/// Connects to a Unix socket. Does not block if the listener is too busy to accept the connection.
fn try_connect(path: &Path) -> rustix::io::Result<()> {
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
            // If this fails, the next service finds the file stale and replaces it.
            let _ = fs::remove_file(path);
        }
    }
}

/// A TCP or Unix connection.
trait Stream: Read + Write {
    /// Sets the timeout of each read and each write.
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

/// A connection with a deadline for all its reads and writes together. A client that sends or receives byte by byte
/// therefore cannot block the thread for longer than any other.
pub struct Connection {
    stream: Box<dyn Stream>,
    deadline: Instant,
}

impl Connection {
    /// Returns the stream, set to time out at the deadline.
    fn stream_before_deadline(&mut self) -> io::Result<&mut dyn Stream> {
        let remaining = self.deadline.saturating_duration_since(Instant::now());
        if remaining.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        self.stream.set_timeout(remaining)?;
        Ok(&mut *self.stream)
    }
}

impl Read for Connection {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        self.stream_before_deadline()?.read(bytes)
    }
}

impl Write for Connection {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.stream_before_deadline()?.write(bytes)
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
    fn the_socket_file_of_a_killed_service_is_replaced_and_deleted_with_the_new_listener() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.sock");
        drop(UnixListener::bind(&path).unwrap());
        assert!(path.exists(), "closing a socket leaves its file in place");
        let listener = Listener::bind(&unix(&path)).unwrap();
        UnixStream::connect(&path).unwrap();
        drop(listener);
        assert!(!path.exists());
    }

    #[test]
    fn a_socket_in_use_and_a_regular_file_are_left_untouched() {
        let folder = tempfile::tempdir().unwrap();
        let [socket, file] = ["metrics.sock", "notes.txt"].map(|name| folder.path().join(name));
        let _in_use = UnixListener::bind(&socket).unwrap();
        fs::write(&file, "mine").unwrap();
        for path in [&socket, &file] {
            assert_eq!(Listener::bind(&unix(path)).unwrap_err().kind(), ErrorKind::AddrInUse);
        }
        UnixStream::connect(&socket).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "mine");
    }

    #[test]
    fn a_client_that_sends_nothing_is_dropped_at_the_deadline() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.sock");
        let listener = Listener::bind(&unix(&path)).unwrap();
        let _silent = UnixStream::connect(&path).unwrap();
        let mut connection = listener.accept(Duration::from_millis(20)).unwrap();
        let error = connection.read(&mut [0; 1]).unwrap_err();
        assert!(matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut));
        std::thread::sleep(Duration::from_millis(20));
        assert_eq!(connection.read(&mut [0; 1]).unwrap_err().kind(), ErrorKind::TimedOut);
    }
}
