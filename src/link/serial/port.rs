//! Opening serial ports: raw bytes, 8N1, no flow control, exclusive to this program and to one of its links.
//!
//! `serialport` locks an open port against other processes: with TIOCEXCL, which does not hold off root, and with
//! `flock`, which does. Its attempt to open a locked port takes TIOCEXCL off the port, though, and its error does not
//! say who has the port. Links therefore claim a port before they touch it.
//!
//! Arduino-like boards restart when DTR rises. Linux raises DTR when a port is opened, and lowers it when the port is
//! closed unless HUPCL is cleared; `serialport` leaves both to the system. HUPCL is therefore cleared: a board restarts when
//! its port is opened for the first time, not whenever the service restarts. HUPCL that is set tells that the port is
//! opened for the first time; for a board that restarts, it is cleared only when the restart is over. Whoever closes the
//! port earlier lowers DTR, so that the next one to open it restarts the board again and waits again.

use std::fmt::Display;
use std::fs::metadata;
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileTypeExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};
use serialport::{ErrorKind, TTYPort};

use super::board::{CLASS, restarts_board};
use crate::link::{LinkError, LinkErrorKind};

const BUSY: &str = "another program has it open; end that program (the service: `sudo systemctl stop facewire`), or give \
    another port";

/// The error of a port that failed while it was open.
pub fn lost(device: &Path, error: impl Display) -> LinkError {
    port_error(device, format!("went away ({error}); check its cable, and plug it in again"))
}

fn port_error(device: &Path, sentence: impl Display) -> LinkError {
    LinkError::new(LinkErrorKind::Other, device.display(), sentence)
}

fn refused(device: &Path, error: Errno) -> LinkError {
    let sentence = match error {
        Errno::NOENT | Errno::NOTDIR | Errno::NODEV | Errno::NXIO => {
            "there is no such serial port; plug it in, or give one that `facewire devices` lists"
        }
        Errno::ACCESS => "this user may not open it; add the user to the group dialout and log in again",
        // The permissions of files are refused with EACCES, the device rules of a unit or a container with EPERM.
        Errno::PERM => {
            "the rules of the service's unit or of the container exclude this device; add DeviceAllow= for its driver to \
             the unit (docs/service.md, \"What the service may access\")"
        }
        Errno::BUSY => BUSY,
        Errno::NOTTY | Errno::ISDIR | Errno::INVAL => "not a serial port; give one that `facewire devices` lists",
        other => return cannot_be_opened(device, io::Error::from(other)),
    };
    port_error(device, sentence)
}

fn cannot_be_opened(device: &Path, error: impl Display) -> LinkError {
    port_error(device, format!("cannot be opened ({error}); check its cable, and plug it in again"))
}

/// The claimed devices by their device numbers, and the path of the link that claimed each.
static CLAIMS: Mutex<Vec<(u64, PathBuf)>> = Mutex::new(Vec::new());

/// The exclusive right of one link of this process to a serial port, until it is dropped.
#[derive(Debug)]
pub struct PortClaim(u64);

impl PortClaim {
    /// Claims the port by its device number, which is the same under all names of a device.
    pub fn acquire(device: &Path) -> Result<Self, LinkError> {
        let node = metadata(device);
        let node = node.map_err(|error| refused(device, Errno::from_io_error(&error).unwrap_or(Errno::IO)))?;
        if !node.file_type().is_char_device() {
            return Err(refused(device, Errno::NOTTY));
        }
        let mut claims = claims();
        let Some((_, holder)) = claims.iter().find(|(claimed, _)| *claimed == node.rdev()) else {
            claims.push((node.rdev(), device.to_owned()));
            return Ok(Self(node.rdev()));
        };
        let sentence = if holder == device {
            "the link that the reload replaced has not closed it yet; check that its receiver reads, or unplug it and plug \
             it in again"
                .to_owned()
        } else {
            let holder = holder.display();
            format!(
                "it is the same device as {holder} at the moment, which another link uses; plug in the device that is \
                 missing, or give each link a port of its own"
            )
        };
        Err(LinkError::new(LinkErrorKind::Claimed, device.display(), sentence))
    }
}

impl Drop for PortClaim {
    fn drop(&mut self) {
        claims().retain(|(claimed, _)| *claimed != self.0);
    }
}

fn claims() -> MutexGuard<'static, Vec<(u64, PathBuf)>> {
    CLAIMS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Opens the serial port. Reading and writing wait for `timeout` at most. If a board there may restart now, also returns
/// what [`keep_dtr`] takes when the restart is over.
pub fn open(device: &Path, baud: u32, timeout: Duration) -> Result<(TTYPort, Option<OwnedFd>), LinkError> {
    let prepare = || {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let prepared = rustix::fs::open(device, flags, Mode::empty())?;
        let dtr_rose = tcgetattr(&prepared)?.control_modes.contains(ControlModes::HUPCL);
        let restarts = dtr_rose && restarts_board(device, Path::new(CLASS));
        if !restarts {
            keep_dtr(&prepared)?;
        }
        Ok((prepared, restarts))
    };
    // Stays open until the port is open for good: otherwise DTR would fall in between.
    let (prepared, restarts) = prepare().map_err(|error| refused(device, error))?;
    let tty = serialport::new(device.to_string_lossy(), baud).timeout(timeout).open_native();
    let tty = tty.map_err(|error| match error.kind {
        // This is how `serialport` reports the lock of another program.
        ErrorKind::NoDevice => refused(device, Errno::BUSY),
        _ => cannot_be_opened(device, error.description),
    })?;
    Ok((tty, restarts.then_some(prepared)))
}

/// Clears HUPCL, so that closing the port does not lower DTR.
pub fn keep_dtr(port: &OwnedFd) -> rustix::io::Result<()> {
    let mut modes = tcgetattr(port)?;
    modes.control_modes.remove(ControlModes::HUPCL);
    tcsetattr(port, OptionalActions::Now, &modes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_that_the_user_may_not_open_names_the_group_and_one_that_the_unit_excludes_its_device_rules() {
        let [user, unit] =
            [Errno::ACCESS, Errno::PERM].map(|error| refused(Path::new("/dev/rfcomm0"), error).to_string());
        assert!(user.contains("/dev/rfcomm0") && user.contains("group dialout"), "{user}");
        assert!(unit.contains("DeviceAllow=") && !unit.contains("dialout"), "{unit}");
    }
}
