//! Serial ports: how one is opened, and why it is not.
//!
//! Raw bytes, 8N1, no flow control, for this program alone.
//!
//! Boards of the Arduino kind restart when DTR goes from off to on. Linux switches it on with every opening, and off
//! with every closing unless HUPCL is cleared; `serialport` leaves both to the system. So HUPCL is cleared before the
//! port is opened for good: a board restarts when it is opened first after plugging in, and not when the service does.

use std::{
    fmt, io,
    os::fd::OwnedFd,
    path::{Path, PathBuf},
    time::Duration,
};

use rustix::{
    fs::{Mode, OFlags},
    io::Errno,
    termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr},
};
use serialport::{ErrorKind, TTYPort};

/// What is wrong with a serial port, and with which.
#[derive(Debug, thiserror::Error)]
#[error("{}: {trouble}", device.display())]
pub struct PortError {
    device: PathBuf,
    trouble: PortTrouble,
}

/// What is wrong with a serial port.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum PortTrouble {
    /// Nothing has this path.
    #[error("there is no such serial port; plug it in, or give one that `facewire devices` lists")]
    NotFound,
    /// The user lacks the rights.
    #[error("this user may not open it; add the user to the group dialout and log in again")]
    NotAllowed,
    /// Opened elsewhere.
    #[error("another program has it open; end that program, or give another port")]
    Busy,
    /// Opened by a link that new settings have ended.
    #[error(
        "it is not closed yet since the settings changed; check that its receiver reads, or unplug it and plug it in again"
    )]
    Closing,
    /// A file, or a device of another kind.
    #[error("not a serial port; give one that `facewire devices` lists")]
    NotSerial,
    /// Whatever else keeps it from opening.
    #[error("cannot be opened ({0}); check its cable, and plug it in again")]
    Refused(String),
    /// It was open, and is no more.
    #[error("went away ({0}); check its cable, and plug it in again")]
    Lost(String),
}

impl PortError {
    /// The port and what is wrong with it.
    fn new(device: &Path, trouble: PortTrouble) -> Self {
        Self { device: device.to_owned(), trouble }
    }

    /// A port at which another link still is.
    #[must_use]
    pub fn closing(device: &Path) -> Self {
        Self::new(device, PortTrouble::Closing)
    }

    /// A port that failed while it was open.
    pub fn lost(device: &Path, error: impl fmt::Display) -> Self {
        Self::new(device, PortTrouble::Lost(error.to_string()))
    }
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
    /// `NoDevice` stands for a lock that another program has.
    fn from(error: serialport::Error) -> Self {
        match error.kind {
            ErrorKind::NoDevice => Self::Busy,
            ErrorKind::Io(io::ErrorKind::NotFound) => Self::NotFound,
            ErrorKind::Io(io::ErrorKind::PermissionDenied) => Self::NotAllowed,
            _ => Self::Refused(error.description),
        }
    }
}

/// Opens the serial port at `baud` bits a second. Reading and writing wait for `patience` at most.
///
/// # Errors
/// The port, and what is wrong with it.
pub fn open(device: &Path, baud: u32, patience: Duration) -> Result<TTYPort, PortError> {
    opened(device, baud, patience).map_err(|trouble| PortError::new(device, trouble))
}

fn opened(device: &Path, baud: u32, patience: Duration) -> Result<TTYPort, PortTrouble> {
    // Open until the other is, lest the last closing switches DTR off.
    let _prepared = prepared(device)?;
    Ok(serialport::new(device.to_string_lossy(), baud).timeout(patience).open_native()?)
}

/// The port, told to keep DTR when it is closed.
fn prepared(device: &Path) -> Result<OwnedFd, PortTrouble> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let port = rustix::fs::open(device, flags, Mode::empty())?;
    let mut modes = tcgetattr(&port)?;
    modes.control_modes.remove(ControlModes::HUPCL);
    tcsetattr(&port, OptionalActions::Now, &modes)?;
    Ok(port)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_rights_name_the_group() {
        let error = PortError::new(Path::new("/dev/ttyUSB0"), Errno::ACCESS.into());
        let want = "/dev/ttyUSB0: this user may not open it; add the user to the group dialout and log in again";
        assert_eq!(error.to_string(), want);
    }

    #[test]
    fn a_lock_of_another_program_is_busy_whichever_way_it_is_told() {
        let locked = serialport::Error::new(ErrorKind::NoDevice, "Unable to acquire exclusive lock on serial port");
        assert_eq!(PortTrouble::from(locked), PortTrouble::Busy);
        assert_eq!(PortTrouble::from(Errno::BUSY), PortTrouble::Busy);
    }
}
