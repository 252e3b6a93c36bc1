//! PCA9685: servos by I2C on Linux.
//!
//! Role: for each packet of the link, the thread of the chip moves all channels by a step.
//! Limits: when the service stops, a slow servo may stop on its way to neutral. If the machine crashes, the chip repeats its
//! last pulses until its power is cut; if the service crashes, until `facewire rest`.

use std::fmt::Display;
use std::fs::File;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use facewire_board::i2c_refusal;
use facewire_packet::Packet;
use facewire_servo::pca9685::{Period, Registers, Servos};
use facewire_servo::{Board, Dials};
use i2cdev::core::I2CDevice as _;
use i2cdev::linux::LinuxI2CDevice;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc::{F_WRLCK, SEEK_SET, c_short, flock};
use rustix::io::Errno;

use super::background::Device;
use super::{LinkError, LinkErrorKind};
use crate::config::Pca9685Settings;

/// Time between two checks whether the chip still makes pulses.
const CHECK_PERIOD: Duration = Duration::from_secs(1);

fn refused(name: impl Display, error: impl Into<io::Error>) -> LinkError {
    let error = error.into();
    let sentence = error.raw_os_error().and_then(|error| i2c_refusal(Errno::from_raw_os_error(error)));
    let other = || format!("{error}; check the wires and the power of the board");
    LinkError::new(LinkErrorKind::Other, name, sentence.map_or_else(other, str::to_owned))
}

/// One chip on a bus of Linux, `/dev/i2c-N`.
///
/// The chip is claimed by a lock on one byte of the bus's device node, the byte at the chip's address. Only programs that
/// may open the bus can take the lock. It holds in all namespaces that have the same node, and the kernel frees it when
/// the program ends. The driver of the bus ignores the lock, so it does not stop programs that never ask for it, such
/// as `i2cdetect`.
pub struct Bus {
    name: String,
    chip: LinuxI2CDevice,
    period: Period,
    _claim: File,
}

impl Bus {
    /// Opens the bus and claims the chip, for one link of one program.
    pub fn open(settings: &Pca9685Settings) -> Result<Self, LinkError> {
        let name = settings.to_string();
        let node = PathBuf::from(format!("/dev/i2c-{}", settings.bus));
        let address = settings.address as u8;
        // A lock for writing needs a file that is open for writing.
        let claim = File::options().read(true).write(true).open(&node).map_err(|error| refused(&name, error))?;
        lock_byte(&claim, address).map_err(|error| match error {
            Errno::AGAIN | Errno::ACCESS => {
                let sentence = "another program moves servos there; end that program, or stop the service with \
                    `systemctl stop facewire`";
                LinkError::new(LinkErrorKind::Claimed, &name, sentence)
            }
            error => refused(&name, error),
        })?;
        let chip = LinuxI2CDevice::new(node, address.into()).map_err(|error| refused(&name, error))?;
        let mut bus = Self { name, chip, period: settings.period(), _claim: claim };
        // A chip that does not answer is told at once.
        bus.has_external_clock()?;
        Ok(bus)
    }

    /// Makes the chip ready if it is not, and gives a channel this pulse, or none.
    pub fn set_pulse(&mut self, channel: u8, pulse_us: Option<f32>) -> Result<(), LinkError> {
        self.prepare(self.period)?;
        self.write_channels(channel, &self.period.registers(pulse_us))
    }
}

fn lock_byte(file: &File, byte: u8) -> Result<(), Errno> {
    let [l_type, l_whence] = [F_WRLCK, SEEK_SET].map(|constant| constant as c_short);
    let lock = flock { l_type, l_whence, l_start: byte.into(), l_len: 1, l_pid: 0 };
    let locked = fcntl(file, FcntlArg::F_OFD_SETLK(&lock));
    locked.map(drop).map_err(|error| Errno::from_raw_os_error(error as i32))
}

impl Registers for Bus {
    type Error = LinkError;

    fn get(&mut self, register: u8) -> Result<u8, LinkError> {
        self.chip.smbus_read_byte_data(register).map_err(|error| refused(&self.name, error))
    }

    fn put(&mut self, register: u8, bytes: &[u8]) -> Result<(), LinkError> {
        self.chip.smbus_write_i2c_block_data(register, bytes).map_err(|error| refused(&self.name, error))
    }
}

/// The servos of one chip as a device of a thread of its own: a bus that hangs blocks that thread alone.
pub struct Chip {
    settings: Pca9685Settings,
    servos: Servos,
    has_external_clock: bool,
    checked_at: Instant,
}

impl Chip {
    /// The chip may get its power later.
    pub fn new(settings: &Pca9685Settings, dials: &Arc<Dials>) -> Self {
        let servos = Servos::new(settings.period(), Board::new(&settings.channels, dials));
        Self { settings: settings.clone(), servos, has_external_clock: false, checked_at: Instant::now() }
    }
}

impl Device for Chip {
    type Open = Bus;

    fn open(&mut self) -> Result<Bus, LinkError> {
        let mut bus = Bus::open(&self.settings)?;
        self.has_external_clock = bus.has_external_clock()?;
        self.servos.start(&mut bus)?;
        Ok(bus)
    }

    fn log_opened(&mut self, bus: &Bus) {
        if self.has_external_clock {
            tracing::warn!(
                "link {}: another program has set the chip to use a clock at its pin EXTCLK; if nothing is connected \
                 there, it makes no pulses: cut the chip's power for a moment",
                bus.name
            );
        }
        tracing::info!("link opened: {}", bus.name);
    }

    fn write(&mut self, bus: &mut Bus, message: &[u8]) -> Result<bool, LinkError> {
        let Ok(packet) = Packet::decode(message) else { return Ok(false) };
        self.servos.show(&packet, bus, Instant::now()).map(|()| true)
    }

    fn attend(&mut self, bus: &mut Bus) -> Result<(), LinkError> {
        if self.checked_at.elapsed() >= CHECK_PERIOD {
            self.checked_at = Instant::now();
            if let Some(trouble) = bus.prepare(bus.period)? {
                tracing::warn!("link {}: {trouble}", bus.name);
            }
        }
        Ok(())
    }

    fn let_go(&mut self, bus: &mut Bus) -> Result<(), LinkError> {
        self.servos.release(bus)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chip_belongs_to_one_open_file_at_a_time_and_other_chips_on_the_bus_are_free() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let [first, second] = [(); 2].map(|()| File::options().read(true).write(true).open(file.path()).unwrap());
        assert_eq!(lock_byte(&first, 0x40), Ok(()));
        assert_eq!([0x40, 0x41].map(|chip| lock_byte(&second, chip)), [Err(Errno::AGAIN), Ok(())]);
        drop(first);
        assert_eq!(lock_byte(&second, 0x40), Ok(()));
    }
}
