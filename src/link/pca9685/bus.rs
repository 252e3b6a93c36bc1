//! An I2C bus of Linux, `/dev/i2c-N`, and one chip on it.
//!
//! Transfers are those of `SMBus`, of 32 bytes at most, because every adapter supports them. The adapters of PCs and
//! the kernel's `i2c-stub` support no others.
//!
//! A chip is claimed by a lock on one byte of the bus's device node, the byte at the chip's address. Only programs that
//! may open the bus can take the lock. It holds in all namespaces that have the same node, and the kernel frees it when
//! the program ends. The driver of the bus ignores the lock, so it does not stop programs that never ask for it, such
//! as `i2cdetect`.

use std::fmt;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use i2cdev::core::I2CDevice as _;
use i2cdev::linux::LinuxI2CDevice;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc::{F_WRLCK, SEEK_SET, c_short, flock};
use rustix::io::Errno;

use super::chip::{self, Period, Registers};

/// Time between two checks whether the chip still makes pulses.
const CHECK_PERIOD: Duration = Duration::from_secs(1);

/// Why a chip cannot be reached.
#[derive(Debug, thiserror::Error)]
#[error("{place}: {trouble}")]
pub struct I2cError {
    place: Place,
    trouble: I2cTrouble,
}

/// Where a chip is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    /// The number of the bus.
    pub bus: u32,
    /// The address of the chip.
    pub address: u32,
}

impl Place {
    fn error(self, error: io::Error) -> I2cError {
        I2cError { place: self, trouble: error.into() }
    }

    /// Claims the chip, for one link of one program.
    ///
    /// # Errors
    /// Says why the bus cannot be opened, or that another link or program has the chip.
    pub fn claim(self) -> Result<Claim, I2cError> {
        let node = self.open_node().map_err(|error| self.error(error))?;
        match lock_byte(&node, u8::try_from(self.address).unwrap_or_default()) {
            Ok(()) => Ok(Claim { place: self, _node: node }),
            Err(Errno::AGAIN | Errno::ACCESS) => Err(I2cError { place: self, trouble: I2cTrouble::Busy }),
            Err(error) => Err(self.error(error.into())),
        }
    }

    /// Opens the node of the bus. A lock for writing needs a file that is open for writing.
    fn open_node(self) -> io::Result<File> {
        File::options().read(true).write(true).open(self.node())
    }

    fn node(self) -> PathBuf {
        Path::new("/dev").join(format!("i2c-{}", self.bus))
    }

    fn chip(self) -> io::Result<LinuxI2CDevice> {
        Ok(LinuxI2CDevice::new(self.node(), u16::try_from(self.address).unwrap_or_default())?)
    }
}

/// Locks one byte of the file for as long as it is open.
#[expect(clippy::cast_possible_truncation, reason = "the constants are 0 and 1")]
fn lock_byte(file: &File, byte: u8) -> Result<(), Errno> {
    let [l_type, l_whence] = [F_WRLCK, SEEK_SET].map(|constant| constant as c_short);
    let lock = flock { l_type, l_whence, l_start: byte.into(), l_len: 1, l_pid: 0 };
    let locked = fcntl(file, FcntlArg::F_OFD_SETLK(&lock));
    locked.map(drop).map_err(|error| Errno::from_raw_os_error(error as i32))
}

/// The exclusive right to a chip, until it is dropped.
#[derive(Debug)]
pub struct Claim {
    place: Place,
    /// The lock belongs to this open file.
    _node: File,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "I2C bus {}, address {:#04x}", self.bus, self.address)
    }
}

impl I2cError {
    /// Whether another link or program has the chip.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.trouble == I2cTrouble::Busy
    }
}

#[derive(Debug, PartialEq, Eq, thiserror::Error)]
enum I2cTrouble {
    #[error(
        "there is no /dev/i2c bus of this number; switch I2C on, run `modprobe i2c-dev`, or give a number that `ls /dev/i2c-*` shows"
    )]
    NoBus,
    #[error("this user may not open the bus; add the user to the group i2c and log in again")]
    NotAllowed,
    #[error("a driver of the kernel has the chip; remove its overlay from the system's settings, and restart")]
    Taken,
    #[error("another program moves servos there; end that program, or stop the service with `systemctl stop facewire`")]
    Busy,
    #[error("no chip answers; check its power, the wires SDA, SCL and ground, and its address with `i2cdetect -y`")]
    NoAnswer,
    #[error(
        "the bus hangs; check that SDA and SCL are not connected to ground or to each other, and cut the board's power for a moment"
    )]
    Hangs,
    #[error("{0}; check the wires and the power of the board")]
    Other(String),
}

impl From<io::Error> for I2cTrouble {
    fn from(error: io::Error) -> Self {
        match error.raw_os_error().map(Errno::from_raw_os_error) {
            Some(Errno::NOENT) => Self::NoBus,
            Some(Errno::ACCESS | Errno::PERM) => Self::NotAllowed,
            Some(Errno::BUSY) => Self::Taken,
            // Adapters report an address that nobody acknowledges in these ways.
            Some(Errno::NXIO | Errno::REMOTEIO | Errno::NODEV | Errno::IO) => Self::NoAnswer,
            Some(Errno::TIMEDOUT | Errno::AGAIN) => Self::Hangs,
            _ => Self::Other(error.to_string()),
        }
    }
}

/// A chip on an I2C bus.
#[derive(Debug)]
pub struct Bus {
    claim: Claim,
    chip: LinuxI2CDevice,
    period: Period,
    looked_at: Instant,
}

impl Bus {
    /// Opens the bus and makes the claimed chip ready.
    ///
    /// # Errors
    /// Says why the chip cannot be reached.
    pub fn open(claim: Claim, period: Period) -> Result<Self, I2cError> {
        let place = claim.place;
        Self::opened(claim, period).map_err(|error| place.error(error))
    }

    fn opened(claim: Claim, period: Period) -> io::Result<Self> {
        let mut chip = claim.place.chip()?;
        chip::prepare(&mut chip, period)?;
        Ok(Self { claim, chip, period, looked_at: Instant::now() })
    }

    /// Checks that the chip answers. Changes nothing.
    ///
    /// # Errors
    /// Says why the chip cannot be reached.
    pub fn check(place: Place) -> Result<(), I2cError> {
        let _claim = place.claim()?;
        place.chip().and_then(|mut chip| chip::probe(&mut chip)).map_err(|error| place.error(error))
    }

    /// Writes a message: the number of a register, then the contents of this register and of those after it.
    ///
    /// # Errors
    /// Says why the chip cannot be reached.
    pub fn write(&mut self, message: &[u8]) -> Result<(), I2cError> {
        let Some((first, registers)) = message.split_first() else { return Ok(()) };
        chip::write_channels(&mut self.chip, *first, registers).map_err(|error| self.claim.place.error(error))
    }

    /// Checks once a second whether the chip still makes pulses, and makes it ready again if its power failed. Returns
    /// whether its power failed.
    ///
    /// # Errors
    /// Says why the chip cannot be reached.
    pub fn attend(&mut self) -> Result<bool, I2cError> {
        if self.looked_at.elapsed() < CHECK_PERIOD {
            return Ok(false);
        }
        self.looked_at = Instant::now();
        chip::prepare(&mut self.chip, self.period).map_err(|error| self.claim.place.error(error))
    }
}

impl Registers for LinuxI2CDevice {
    fn read(&mut self, register: u8) -> io::Result<u8> {
        Ok(self.smbus_read_byte_data(register)?)
    }

    fn write(&mut self, register: u8, bytes: &[u8]) -> io::Result<()> {
        Ok(self.smbus_write_i2c_block_data(register, bytes)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_error_of_a_bus_is_told_with_what_to_do() {
        for (errno, told) in [
            (Errno::NOENT, "switch I2C on"),
            (Errno::ACCESS, "group i2c"),
            (Errno::BUSY, "a driver of the kernel"),
            (Errno::REMOTEIO, "no chip answers"),
            (Errno::NXIO, "no chip answers"),
            (Errno::TIMEDOUT, "the bus hangs"),
            (Errno::INVAL, "check the wires"),
        ] {
            let error = Place { bus: 1, address: 0x40 }.error(io::Error::from(errno)).to_string();
            assert!(error.starts_with("I2C bus 1, address 0x40: ") && error.contains(told), "{error}");
        }
    }

    #[test]
    fn a_chip_belongs_to_one_open_file_at_a_time_and_other_chips_on_the_bus_are_free() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let open = || File::options().read(true).write(true).open(file.path()).unwrap();
        let (first, second) = (open(), open());
        assert_eq!(lock_byte(&first, 0x40), Ok(()));
        assert_eq!(lock_byte(&second, 0x40), Err(Errno::AGAIN));
        assert_eq!(lock_byte(&second, 0x41), Ok(()), "another chip");
        drop(first);
        assert_eq!(lock_byte(&second, 0x40), Ok(()));
    }

    #[test]
    fn a_bus_that_is_missing_is_told_at_once_and_a_chip_that_is_held_is_told_with_who_holds_it() {
        let place = Place { bus: 254, address: 0x40 };
        let missing = place.claim().unwrap_err();
        assert!(!missing.is_held() && missing.to_string().contains("switch I2C on"), "{missing}");
        let held = I2cError { place, trouble: I2cTrouble::Busy };
        assert!(held.is_held() && held.to_string().contains("systemctl stop facewire"), "{held}");
    }
}
