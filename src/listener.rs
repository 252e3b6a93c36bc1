//! A listening socket, TCP or Unix, and the connections accepted on it.

use std::fs::{self, Permissions, metadata, set_permissions};
use std::io::{self, ErrorKind};
use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _};
use std::os::unix::net::UnixListener;
use std::path::{Path, PathBuf};

use rustix::io::{Errno, ioctl_fionbio};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, accept_with, connect, socket_with};

use crate::config::Listen;

/// The mode of a runtime directory whose group may use the sockets in it.
const SHARED_FOLDER: u32 = 0o710;

/// An open listening socket, and the path of its file if it has one, which is deleted on drop.
#[derive(Debug)]
pub struct Listener {
    pub socket: OwnedFd,
    path: Option<PathBuf>,
}

impl Listener {
    /// Opens the socket. A socket file without a listener, left behind by a service that was killed, is replaced. Any
    /// other file at the path, including a socket in use, is left untouched and makes this fail. In a runtime directory that is
    /// shared with a group, the group may use the socket.
    pub fn bind(listen: &Listen) -> io::Result<Self> {
        let (socket, path): (OwnedFd, _) = match listen {
            Listen::Off => return Err(ErrorKind::AddrNotAvailable.into()),
            Listen::Tcp(address) => (TcpListener::bind(address)?.into(), None),
            Listen::Unix(path) => {
                if is_stale(path) {
                    fs::remove_file(path)?;
                }
                let listener = UnixListener::bind(path)?;
                if is_shared(path) {
                    set_permissions(path, Permissions::from_mode(0o660))?;
                }
                (listener.into(), Some(path.clone()))
            }
        };
        ioctl_fionbio(&socket, true)?;
        Ok(Self { socket, path })
    }

    pub fn accept(&self) -> io::Result<OwnedFd> {
        Ok(accept_with(&self.socket, SocketFlags::NONBLOCK | SocketFlags::CLOEXEC)?)
    }
}

/// Whether the group of the folder may use a socket there. Whoever made the folder says so by its mode.
pub fn is_shared(path: &Path) -> bool {
    let folder = path.parent().and_then(|folder| metadata(folder).ok());
    folder.is_some_and(|folder| folder.permissions().mode() & 0o777 == SHARED_FOLDER)
}

/// Returns whether `path` is a Unix socket on which no process listens any more. Does not block if the listener is too
/// busy to accept a connection.
fn is_stale(path: &Path) -> bool {
    let is_socket = fs::symlink_metadata(path).is_ok_and(|file| file.file_type().is_socket());
    let try_connect = || {
        let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
        let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
        connect(socket, &SocketAddrUnix::new(path)?)
    };
    is_socket && try_connect() == Err(Errno::CONNREFUSED)
}

impl Drop for Listener {
    fn drop(&mut self) {
        // If this fails, the next service finds the file stale and replaces it.
        if let Some(path) = &self.path {
            let _ = fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::net::UnixStream;

    use super::*;

    #[test]
    fn a_socket_in_use_and_a_regular_file_are_left_untouched() {
        let folder = tempfile::tempdir().unwrap();
        let [stale, used, file] = ["stale", "used", "notes.txt"].map(|name| folder.path().join(name));
        let _in_use = UnixListener::bind(&used).unwrap();
        fs::write(&file, "mine").unwrap();
        let refusal = |path: &PathBuf| Listener::bind(&Listen::Unix(path.clone())).unwrap_err().kind();
        assert_eq!([&used, &file].map(refusal), [ErrorKind::AddrInUse; 2]);
        UnixStream::connect(&used).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "mine");

        drop(UnixListener::bind(&stale).unwrap());
        assert!(stale.exists(), "closing a socket leaves its file in place");
        let listener = Listener::bind(&Listen::Unix(stale.clone())).unwrap();
        UnixStream::connect(&stale).unwrap();
        drop(listener);
        assert!(!stale.exists());
    }
}
