//! A client of the control thread, and what it is told: by the control socket, one JSON value a line in both directions,
//! or by HTTP.

use std::fs::File;
use std::io::{self, ErrorKind, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::calibration::{KeptProfile, Listed, Progress};
use crate::service::metrics::MAX_REQUEST_BYTES;

pub(super) const MAX_LINE: usize = 256;
const SOCKET: &str = "control";
/// Where the service manager puts the runtime directory of the service.
const SYSTEM_FOLDER: &str = "/run/facewire";

/// What a client asks. A client asks once for each connection.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Request {
    /// Calibrate this wearer, or the one in use. The answer is any number of [`Reply::Progress`] and one other reply. A
    /// client that closes the connection cancels the calibration.
    Calibrate {
        wearer: Option<String>,
    },
    Use {
        wearer: Option<String>,
    },
    List {},
    Delete {
        wearer: String,
    },
    /// Tell what every frame shows, as [`Reply::Frame`], until the client closes the connection.
    Record {},
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reply {
    Progress(Progress),
    /// The calibration has ended, and its profile is in use.
    Calibrated(KeptProfile),
    Wearers {
        wearers: Vec<Listed>,
        in_use: Option<String>,
        folder: String,
    },
    /// The bytes of a [`Recorded`](crate::recording::Recorded) in Base64.
    Frame(String),
    /// How many frames were lost since the recording began. Also sent once a second while no frame comes.
    Lost(u64),
    Done(String),
    /// It cannot be done: one sentence that says why, and what to do.
    Refused(String),
}

/// Where a client looks for the service: where one started like this process listens, then the system's service.
pub fn control_sockets() -> Vec<PathBuf> {
    let of_system = std::env::var("RUNTIME_DIRECTORY").is_err().then(|| Path::new(SYSTEM_FOLDER).join(SOCKET));
    socket_path().into_iter().chain(of_system).collect()
}

/// Where the service listens: in the runtime directory of the service manager, or else of the user.
pub(in crate::service) fn socket_path() -> Option<PathBuf> {
    let of_service = || std::env::var("RUNTIME_DIRECTORY").ok()?.split(':').next().map(PathBuf::from);
    let of_user = || std::env::var("XDG_RUNTIME_DIR").ok().map(|folder| Path::new(&folder).join("facewire"));
    let folder = of_service().or_else(of_user).filter(|folder| folder.is_absolute())?;
    Some(folder.join(SOCKET))
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Speaks {
    Requests,
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
        let left = most.saturating_sub(self.input.len());
        match (&self.stream).take(left as u64).read_to_end(&mut self.input) {
            Ok(_) => Ok(true),
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
