//! The connection to the service's control socket.

use std::io::{BufRead as _, BufReader, ErrorKind, Write as _};
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::time::Duration;

use super::super::failure::Failure;
use crate::service::{Reply, Request, control_sockets};

/// Longest time between two lines of a service that works.
const PATIENCE: Duration = Duration::from_secs(10);

/// A connection to the service.
pub(in crate::cli) struct Connection {
    path: PathBuf,
    stream: BufReader<UnixStream>,
}

impl Connection {
    /// Connects to the service that runs on this machine. `None` if there is none.
    pub(in crate::cli) fn open() -> Result<Option<Self>, Failure> {
        for path in control_sockets() {
            match UnixStream::connect(&path) {
                Ok(stream) => {
                    let timeouts = stream.set_read_timeout(Some(PATIENCE));
                    timeouts.and_then(|()| stream.set_write_timeout(Some(PATIENCE))).map_err(|e| lost(&path, &e))?;
                    return Ok(Some(Self { path, stream: BufReader::new(stream) }));
                }
                Err(error) if error.kind() == ErrorKind::PermissionDenied => {
                    let path = path.display();
                    return Err(Failure::failed(format!(
                        "the service at {path} belongs to another user: try again with sudo"
                    )));
                }
                // Nobody listens there.
                Err(_) => {}
            }
        }
        Ok(None)
    }

    /// Asks the service.
    pub(in crate::cli) fn ask(&mut self, request: &Request) -> Result<(), Failure> {
        let line = serde_json::to_string(request).map_err(|error| Failure::failed(error.to_string()))?;
        let stream = self.stream.get_mut();
        writeln!(stream, "{line}").map_err(|error| lost(&self.path, &error))
    }

    /// Returns the next line of the answer.
    pub(in crate::cli) fn reply(&mut self) -> Result<Reply, Failure> {
        let mut line = String::new();
        match self.stream.read_line(&mut line) {
            Ok(0) => Err(lost(&self.path, &ErrorKind::ConnectionReset.into())),
            Ok(_) => serde_json::from_str(&line).map_err(|_| {
                let path = self.path.display();
                Failure::failed(format!("the service at {path} is of another version: restart it"))
            }),
            Err(error) => Err(lost(&self.path, &error)),
        }
    }
}

fn lost(path: &std::path::Path, error: &std::io::Error) -> Failure {
    let path = path.display();
    Failure::failed(format!("the service at {path} does not answer ({error}): see its log, and try again"))
}
