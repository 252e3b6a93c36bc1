//! Opening serial ports: raw bytes, 8N1, no flow control, exclusive to this program.
//!
//! Arduino-like boards restart when DTR rises. Linux raises DTR when a port is opened, and lowers it when the port is
//! closed unless HUPCL is cleared; `serialport` leaves both to the system. HUPCL is therefore cleared: a board restarts when
//! its port is opened for the first time, not whenever the service restarts. HUPCL that is set tells that the port is
//! opened for the first time; for a board that restarts, it is cleared when the restart is over ([`Restart`]).

use std::{
    fmt, io,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use rustix::{
    fs::{Mode, OFlags},
    io::Errno,
    termios::{ControlModes, tcgetattr},
};
use serialport::{ErrorKind, TTYPort};

use super::board::CLASS;
use super::restart::{Restart, keep_dtr, restarts_board};

/// A serial port, and what is wrong with it.
#[derive(Debug, thiserror::Error)]
#[error("{}: {trouble}", device.display())]
pub struct PortError {
    device: PathBuf,
    trouble: PortTrouble,
}

/// What is wrong with a serial port.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum PortTrouble {
    /// No microcontroller board is plugged in, only these other serial ports.
    #[error("waits for a microcontroller board; none of a known maker is plugged in{}", hint(.0))]
    NoBoard(Vec<PathBuf>),
    /// No Maestro is plugged in.
    #[error("waits for a Pololu Maestro; none is plugged into USB")]
    NoMaestro,
    /// More than one board of the kind that is looked for is plugged in.
    #[error("more than one such board is plugged in; give the path of one as link.device: {}", list(.0))]
    SeveralBoards(Vec<PathBuf>),
    /// The board that was used is away, and another one is plugged in.
    #[error("waits for {}; another board takes its place after half a minute", .0.display())]
    Away(PathBuf),
    /// There is no device at this path.
    #[error("there is no such serial port; plug it in, or give one that `facewire devices` lists")]
    NotFound,
    /// The user has no access to the device.
    #[error("this user may not open it; add the user to the group dialout and log in again")]
    NotAllowed,
    /// Another program has the port open.
    #[error("another program has it open; end that program, or give another port")]
    Busy,
    /// A link that new settings have replaced has not closed the port yet.
    #[error(
        "the link that the reload replaced has not closed it yet; check that its receiver reads, or unplug it and plug it in again"
    )]
    Closing,
    /// Another link uses the same device under another name.
    #[error(
        "it is the same device as {} at the moment, which another link uses; plug in the device that is missing, or give \
         each link a port of its own", .0.display()
    )]
    Shared(PathBuf),
    /// The path is a file, or a device of another kind.
    #[error("not a serial port; give one that `facewire devices` lists")]
    NotSerial,
    /// Any other error.
    #[error("cannot be opened ({0}); check its cable, and plug it in again")]
    Refused(String),
    /// The port failed while it was open.
    #[error("went away ({0}); check its cable, and plug it in again")]
    Lost(String),
}

impl PortError {
    fn new(device: &Path, trouble: PortTrouble) -> Self {
        Self { device: device.to_owned(), trouble }
    }

    /// The error of a port that the link at `holder` has claimed.
    #[must_use]
    pub fn claimed(device: &Path, holder: PathBuf) -> Self {
        Self::new(device, if holder == device { PortTrouble::Closing } else { PortTrouble::Shared(holder) })
    }

    /// The error of a link to the board that is plugged in.
    #[must_use]
    pub fn of_the_board(trouble: PortTrouble) -> Self {
        Self::new(Path::new("auto"), trouble)
    }

    /// Whether another program has the port open.
    #[must_use]
    pub fn is_busy(&self) -> bool {
        self.trouble == PortTrouble::Busy
    }

    /// Whether no board of the kind that is looked for is plugged in, as with a service whose board comes later.
    #[must_use]
    pub fn waits_for_a_board(&self) -> bool {
        matches!(self.trouble, PortTrouble::NoBoard(_) | PortTrouble::NoMaestro)
    }

    /// The error of a port that failed while it was open.
    pub fn lost(device: &Path, error: impl fmt::Display) -> Self {
        Self::new(device, PortTrouble::Lost(error.to_string()))
    }
}

/// Names serial ports that anything may be connected to.
fn hint(others: &[PathBuf]) -> String {
    if others.is_empty() {
        return String::new();
    }
    format!("; if your board is one of these, give its path as link.device: {}", list(others))
}

fn list(ports: &[PathBuf]) -> String {
    ports.iter().map(|port| port.display().to_string()).collect::<Vec<_>>().join(", ")
}

impl From<Errno> for PortTrouble {
    fn from(error: Errno) -> Self {
        match error {
            Errno::NOENT | Errno::NOTDIR | Errno::NODEV | Errno::NXIO => Self::NotFound,
            Errno::ACCESS | Errno::PERM => Self::NotAllowed,
            Errno::BUSY => Self::Busy,
            Errno::NOTTY | Errno::ISDIR | Errno::INVAL => Self::NotSerial,
            other => Self::Refused(io::Error::from(other).to_string()),
        }
    }
}

impl From<serialport::Error> for PortTrouble {
    /// `serialport` reports the lock of another program as `NoDevice`.
    fn from(error: serialport::Error) -> Self {
        match error.kind {
            ErrorKind::NoDevice => Self::Busy,
            ErrorKind::Io(io::ErrorKind::NotFound) => Self::NotFound,
            ErrorKind::Io(io::ErrorKind::PermissionDenied) => Self::NotAllowed,
            _ => Self::Refused(error.description),
        }
    }
}

/// Opens the serial port. Reading and writing wait for `patience` at most. Also returns the restart of the board, if the
/// opening has caused one.
///
/// # Errors
/// Says what is wrong with the port.
pub fn open(device: &Path, baud: u32, patience: Duration) -> Result<(TTYPort, Option<Restart>), PortError> {
    opened(device, baud, patience).map_err(|trouble| PortError::new(device, trouble))
}

fn opened(device: &Path, baud: u32, patience: Duration) -> Result<(TTYPort, Option<Restart>), PortTrouble> {
    // Stays open until the port is open for good: otherwise DTR would fall in between.
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let prepared = rustix::fs::open(device, flags, Mode::empty())?;
    let dtr_rose = tcgetattr(&prepared)?.control_modes.contains(ControlModes::HUPCL);
    let restarts = dtr_rose && restarts_board(device, Path::new(CLASS));
    if !restarts {
        keep_dtr(&prepared)?;
    }
    let tty = serialport::new(device.to_string_lossy(), baud).timeout(patience).open_native()?;
    Ok((tty, restarts.then(|| Restart::new(prepared, Instant::now()))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_access_names_the_group_to_join() {
        let error = PortError::new(Path::new("/dev/ttyUSB0"), Errno::ACCESS.into());
        let want = "/dev/ttyUSB0: this user may not open it; add the user to the group dialout and log in again";
        assert_eq!(error.to_string(), want);
    }

    #[test]
    fn the_lock_of_another_program_is_reported_as_busy_by_open_and_by_flock() {
        let locked = serialport::Error::new(ErrorKind::NoDevice, "Unable to acquire exclusive lock on serial port");
        assert_eq!(PortTrouble::from(locked), PortTrouble::Busy);
        assert_eq!(PortTrouble::from(Errno::BUSY), PortTrouble::Busy);
    }
}
