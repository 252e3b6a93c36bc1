//! An I2C bus of Linux, `/dev/i2c-N`, and one chip on it.
//!
//! Transfers are those of `SMBus`, of 32 bytes at most, because every adapter knows them: those of PCs know no others, and
//! neither does the kernel's `i2c-stub`.

use std::fmt;
use std::io;
use std::os::linux::net::SocketAddrExt as _;
use std::os::unix::net::{SocketAddr, UnixListener};
use std::time::{Duration, Instant};

use i2cdev::core::I2CDevice as _;
use i2cdev::linux::LinuxI2CDevice;
use rustix::io::Errno;

use super::chip::{self, Period, Registers};

/// Time from one look whether the chip still makes pulses to the next.
const LOOK: Duration = Duration::from_secs(1);

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

    /// Claims the chip for this program, and opens the bus.
    fn claimed(self) -> io::Result<(UnixListener, LinuxI2CDevice)> {
        let Self { bus, address } = self;
        let name = SocketAddr::from_abstract_name(format!("facewire-i2c-{bus}-{address}"))?;
        let claim = UnixListener::bind_addr(&name)?;
        let chip = LinuxI2CDevice::new(format!("/dev/i2c-{bus}"), u16::try_from(address).unwrap_or_default())?;
        Ok((claim, chip))
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "I2C bus {}, address {:#04x}", self.bus, self.address)
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
            Some(Errno::ADDRINUSE) => Self::Busy,
            // Adapters report an address that nobody acknowledges in these ways.
            Some(Errno::NXIO | Errno::REMOTEIO | Errno::NODEV | Errno::IO) => Self::NoAnswer,
            Some(Errno::TIMEDOUT | Errno::AGAIN) => Self::Hangs,
            _ => Self::Other(error.to_string()),
        }
    }
}

/// A chip on an I2C bus. It is this program's alone while it is open.
#[derive(Debug)]
pub struct Bus {
    place: Place,
    chip: LinuxI2CDevice,
    period: Period,
    looked_at: Instant,
    /// Held for as long as the chip is open. Other programs of this kind find it taken; the kernel frees it in any event.
    _claim: UnixListener,
}

impl Bus {
    /// Opens the bus and makes the chip ready.
    ///
    /// # Errors
    /// Says why the chip cannot be reached.
    pub fn open(place: Place, period: Period) -> Result<Self, I2cError> {
        Self::opened(place, period).map_err(|error| place.error(error))
    }

    fn opened(place: Place, period: Period) -> io::Result<Self> {
        let (claim, mut chip) = place.claimed()?;
        chip::prepare(&mut chip, period)?;
        Ok(Self { place, chip, period, looked_at: Instant::now(), _claim: claim })
    }

    /// Looks whether the chip answers, and changes nothing.
    ///
    /// # Errors
    /// Says why the chip cannot be reached.
    pub fn check(place: Place) -> Result<(), I2cError> {
        let checked = place.claimed().and_then(|(_claim, mut chip)| chip::is_there(&mut chip));
        checked.map_err(|error| place.error(error))
    }

    /// Writes a message: a register, and the contents of it and those after it.
    ///
    /// # Errors
    /// Says why the chip cannot be reached.
    pub fn write(&mut self, message: &[u8]) -> Result<(), I2cError> {
        let Some((first, registers)) = message.split_first() else { return Ok(()) };
        chip::write_channels(&mut self.chip, *first, registers).map_err(|error| self.place.error(error))
    }

    /// Looks now and then whether the chip still makes pulses, and makes it ready again if its power failed. Returns
    /// whether it did.
    ///
    /// # Errors
    /// Says why the chip cannot be reached.
    pub fn attend(&mut self) -> Result<bool, I2cError> {
        if self.looked_at.elapsed() < LOOK {
            return Ok(false);
        }
        self.looked_at = Instant::now();
        chip::prepare(&mut self.chip, self.period).map_err(|error| self.place.error(error))
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
            (Errno::ADDRINUSE, "systemctl stop facewire"),
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
    fn a_chip_belongs_to_one_program_at_a_time() {
        let claim = |address| Place { bus: 254, address }.claimed().map(drop).unwrap_err().raw_os_error();
        let name = SocketAddr::from_abstract_name("facewire-i2c-254-64").unwrap();
        let taken = UnixListener::bind_addr(&name).unwrap();
        assert_eq!(claim(64), Some(Errno::ADDRINUSE.raw_os_error()));
        assert_eq!(claim(65), Some(Errno::NOENT.raw_os_error()), "another chip on the same bus");
        drop(taken);
        assert_eq!(claim(64), Some(Errno::NOENT.raw_os_error()));
    }
}
