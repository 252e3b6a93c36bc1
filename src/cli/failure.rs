//! The failure of a command, with an exit status for each kind of failure as in `sysexits.h`.

use std::fmt::Display;
use std::io::{self, ErrorKind, Write as _};
use std::path::Path;
use std::process::ExitCode;

use crate::calibration::StoreError;
use crate::capture::CaptureError;
use crate::config::{EX_CONFIG, Faults};
use crate::link::{LinkError, LinkErrorKind};
use crate::playback::PlaybackError;
use crate::preflight::SetupError;
use crate::recording::RecordingError;
use crate::service::ServiceError;
use facewire_face::InferError;
use facewire_face::ModelError;

const EX_FAILED: u8 = 1;
const EX_DATAERR: u8 = 65;
const EX_NOINPUT: u8 = 66;
const EX_NOHOST: u8 = 68;
const EX_UNAVAILABLE: u8 = 69;
const EX_IOERR: u8 = 74;

/// The name of standard output in messages.
pub const STANDARD_OUTPUT: &str = "standard output";

/// Why a command failed.
#[derive(Debug)]
pub struct Failure {
    status: u8,
    /// One sentence for the operator. Invalid settings give one line for each fault.
    message: String,
}

impl Failure {
    pub fn data(message: String) -> Self {
        Self { status: EX_DATAERR, message }
    }

    pub fn failed(message: String) -> Self {
        Self { status: EX_FAILED, message }
    }

    /// A file could not be written. A closed pipe is not a failure, because its reader has read enough.
    pub fn unwritable(path: &Path, error: &io::Error) -> Self {
        if error.kind() == ErrorKind::BrokenPipe {
            return Self { status: 0, message: String::new() };
        }
        let remedy = match error.kind() {
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "free some space, or write to another disk",
            ErrorKind::AlreadyExists => "give another name, or remove that file first",
            _ if path == Path::new(STANDARD_OUTPUT) => "check where it goes",
            _ => "check the folder, its permissions and the disk",
        };
        Self { status: EX_IOERR, message: format!("cannot write {}: {error}; {remedy}", path.display()) }
    }

    /// A recording could not be read.
    pub fn recording(path: &Path, error: &RecordingError) -> Self {
        let status = if matches!(error, RecordingError::Read(_)) { EX_NOINPUT } else { EX_DATAERR };
        Self { status, message: format!("{}: {error}", path.display()) }
    }

    /// Output could not be written.
    pub fn unwritten(message: String) -> Self {
        Self { status: EX_IOERR, message }
    }

    /// A device does not answer.
    pub fn unavailable(message: String) -> Self {
        Self { status: EX_UNAVAILABLE, message }
    }

    pub fn message(&self) -> &str {
        &self.message
    }

    /// Prints the message on standard error and returns the exit status, which is success if there is no message.
    pub fn report(&self) -> ExitCode {
        if self.message.is_empty() {
            return ExitCode::SUCCESS;
        }
        self.message.lines().for_each(say);
        ExitCode::from(self.status)
    }
}

/// Prints a line on standard error. Ignores errors, because standard error may be closed.
pub fn say(line: impl Display) {
    let _ = writeln!(io::stderr(), "facewire: {line}");
}

/// Prints text on standard output.
pub fn print(text: &str) -> Result<(), Failure> {
    io::stdout().write_all(text.as_bytes()).map_err(|error| Failure::unwritable(Path::new(STANDARD_OUTPUT), &error))
}

impl From<Faults> for Failure {
    fn from(faults: Faults) -> Self {
        Self { status: EX_CONFIG, message: faults.to_string() }
    }
}

impl From<CaptureError> for Failure {
    fn from(error: CaptureError) -> Self {
        let status = match error {
            CaptureError::BadFile(_) | CaptureError::Frame { .. } => EX_DATAERR,
            CaptureError::NotStopped { .. } => EX_UNAVAILABLE,
            CaptureError::Read(_) => EX_IOERR,
            _ => EX_NOINPUT,
        };
        Self { status, message: error.to_string() }
    }
}

impl From<InferError> for Failure {
    fn from(error: InferError) -> Self {
        Self { status: EX_UNAVAILABLE, message: error.to_string() }
    }
}

impl From<PlaybackError> for Failure {
    fn from(error: PlaybackError) -> Self {
        match error {
            PlaybackError::Capture(error) => error.into(),
            PlaybackError::Infer(error) => error.into(),
        }
    }
}

impl From<SetupError> for Failure {
    fn from(error: SetupError) -> Self {
        match error {
            SetupError::Networks(error) => error.into(),
            SetupError::Model { error: ModelError::Unreadable { .. }, .. } => {
                Self { status: EX_NOINPUT, message: error.to_string() }
            }
            SetupError::Model { .. } => Self { status: EX_CONFIG, message: error.to_string() },
        }
    }
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        let status = match error {
            StoreError::Missing { .. } | StoreError::Unreadable { .. } => EX_NOINPUT,
            StoreError::Bad { .. } => EX_DATAERR,
            StoreError::Unwritable { .. } => EX_IOERR,
        };
        Self { status, message: error.to_string() }
    }
}

impl From<LinkError> for Failure {
    fn from(error: LinkError) -> Self {
        let status = match error.kind {
            LinkErrorKind::Host => EX_NOHOST,
            LinkErrorKind::Output => EX_IOERR,
            LinkErrorKind::Waiting | LinkErrorKind::Claimed | LinkErrorKind::Other => EX_UNAVAILABLE,
        };
        Self { status, message: error.to_string() }
    }
}

impl From<ServiceError> for Failure {
    fn from(error: ServiceError) -> Self {
        match error {
            ServiceError::Setup(error) => error.into(),
            ServiceError::Link(error) => error.into(),
            ServiceError::Camera(error) => error.into(),
            ServiceError::System(_) | ServiceError::Panicked(_) => Self::failed(error.to_string()),
        }
    }
}
