//! The failure of a command, with an exit status for each kind of failure as in `sysexits.h`.

use std::fmt::Display;
use std::io::{self, ErrorKind, Write as _};
use std::path::Path;
use std::process::ExitCode;

use facewire_face::{InferError, ModelError};

use crate::calibration::StoreError;
use crate::capture::CaptureError;
use crate::config::{EX_CONFIG, Faults};
use crate::link::{LinkError, LinkErrorKind};
use crate::pipeline::SetupError;
use crate::recording::RecordingError;
use crate::service::ServiceError;

const EX_FAILED: u8 = 1;
const EX_DATAERR: u8 = 65;
const EX_NOINPUT: u8 = 66;
const EX_NOHOST: u8 = 68;
const EX_UNAVAILABLE: u8 = 69;
const EX_IOERR: u8 = 74;

pub const STANDARD_OUTPUT: &str = "standard output";

#[derive(Debug)]
pub struct Failure {
    status: u8,
    /// One sentence for the operator, or a line for each fault of the settings or for each link that failed.
    pub message: String,
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
        let remedy = match error.kind() {
            ErrorKind::AlreadyExists => {
                let message =
                    format!("{} exists already; give another name, or remove that file first", path.display());
                return Self { status: EX_IOERR, message };
            }
            ErrorKind::BrokenPipe => return Self { status: 0, message: String::new() },
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "free some space, or write to another disk",
            _ if path == Path::new(STANDARD_OUTPUT) => "check where it goes",
            _ => "check the folder, its permissions and the disk",
        };
        Self { status: EX_IOERR, message: format!("cannot write {}: {error}; {remedy}", path.display()) }
    }

    pub fn recording(path: &Path, error: &RecordingError) -> Self {
        let status = if matches!(error, RecordingError::Read(_)) { EX_NOINPUT } else { EX_DATAERR };
        Self { status, message: format!("{}: {error}", path.display()) }
    }

    pub fn unavailable(message: String) -> Self {
        Self { status: EX_UNAVAILABLE, message }
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

pub fn print(text: &str) -> Result<(), Failure> {
    io::stdout().write_all(text.as_bytes()).map_err(|error| Failure::unwritable(Path::new(STANDARD_OUTPUT), &error))
}

pub trait ExitStatus: Display {
    fn exit_status(&self) -> u8;
}

impl<E: ExitStatus> From<E> for Failure {
    fn from(error: E) -> Self {
        Self { status: error.exit_status(), message: error.to_string() }
    }
}

macro_rules! exit_statuses {
    ($( $error:ty { $( $kind:pat => $status:expr, )* } )*) => { $(
        impl ExitStatus for $error {
            fn exit_status(&self) -> u8 {
                match self {
                    $( $kind => $status, )*
                }
            }
        }
    )* };
}

exit_statuses! {
    Faults { _ => EX_CONFIG, }
    CaptureError {
        Self::BadFile(_) | Self::Frame { .. } => EX_DATAERR,
        Self::NotStopped { .. } => EX_UNAVAILABLE,
        Self::Read(_) => EX_IOERR,
        _ => EX_NOINPUT,
    }
    InferError { _ => EX_UNAVAILABLE, }
    SetupError {
        Self::Networks(error) => error.exit_status(),
        Self::Model { error: ModelError::Unreadable { .. }, .. } => EX_NOINPUT,
        Self::Model { .. } => EX_CONFIG,
    }
    StoreError {
        Self::Unreadable(_) => EX_NOINPUT,
        Self::Bad(_) => EX_DATAERR,
        Self::Unwritable(_) => EX_IOERR,
    }
    LinkError {
        Self { kind: LinkErrorKind::Host, .. } => EX_NOHOST,
        Self { kind: LinkErrorKind::Output, .. } => EX_IOERR,
        _ => EX_UNAVAILABLE,
    }
    ServiceError {
        Self::Setup(error) => error.exit_status(),
        Self::Link(error) => error.exit_status(),
        Self::Camera(error) => error.exit_status(),
        Self::System(_) | Self::Panicked(_) => EX_FAILED,
    }
}
