//! PCA9685: servos by I2C.
//!
//! Role: the thread of the chip is the receiver of the link's packets. From each it takes the next step of all channels, and
//! writes the registers from the first to the last channel in use. It keeps the limits of speed and acceleration itself,
//! because the chip has none.
//! Contract: motion goes on from the pulses that the chip makes when the link opens, so that nothing jumps after a crash,
//! a reload or a failure of the bus, and only while the chip takes registers. The chip is set up if it does not make the
//! wanted pulses: after power-on, after its power failed for a moment, and after another program changed it.
//! Limits: a servo without pulses begins at neutral, or where this link has moved it last. When the service stops, or a
//! reload removes the link, a servo whose limits keep it from reaching neutral in time stops on its way. The chip has no
//! time-out. If the machine crashes, it repeats its last pulses until its power is cut.

mod chip;

use std::fmt::Display;
use std::fs::File;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use facewire_packet::Packet;
use i2cdev::core::I2CDevice as _;
use i2cdev::linux::LinuxI2CDevice;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc::{F_WRLCK, SEEK_SET, c_short, flock};
use rustix::io::Errno;

pub use self::chip::{CHANNELS, Period};
use self::chip::{Found, Registers, write_channels};
use super::{Background, Device, LinkError, LinkErrorKind, Traffic};
use crate::config::Pca9685Settings;
use crate::servo::{Channel, ChannelInput};

/// Time between two checks whether the chip still makes pulses.
const CHECK_PERIOD: Duration = Duration::from_secs(1);

/// Starts the thread that writes to the chip. The chip may get its power later.
pub fn carrier(settings: &Pca9685Settings, traffic: Arc<Traffic>) -> Result<Background, LinkError> {
    let settings = settings.clone();
    let chip = Chip { servos: Servos::new(&settings), open: None, checked_at: Instant::now(), settings };
    Background::start(name(&chip.settings), "fw-i2c", chip, true, traffic)
}

fn name(settings: &Pca9685Settings) -> String {
    format!("I2C bus {}, address {:#04x}", settings.bus, settings.address)
}

fn refused(name: impl Display, error: &io::Error) -> LinkError {
    let sentence = match error.raw_os_error().map(Errno::from_raw_os_error) {
        Some(Errno::NOENT) => {
            "there is no /dev/i2c bus of this number; switch I2C on, run `modprobe i2c-dev`, or give a number that \
             `ls /dev/i2c-*` shows"
        }
        Some(Errno::ACCESS) => "this user may not open the bus; add the user to the group i2c and log in again",
        Some(Errno::PERM) => {
            "the rules of the service's unit or of the container exclude I2C buses; install the unit's drop-in i2c.conf \
             (docs/service.md, \"What the service may access\")"
        }
        Some(Errno::BUSY) => {
            "a driver of the kernel has the chip; remove its overlay from the system's settings, and restart"
        }
        // Adapters report an address that nobody acknowledges in these ways.
        Some(Errno::NXIO | Errno::REMOTEIO | Errno::NODEV | Errno::IO) => {
            "no chip answers; check its power, the wires SDA, SCL and ground, and its address with `i2cdetect -y`"
        }
        Some(Errno::TIMEDOUT | Errno::AGAIN) => {
            "the bus hangs; check that SDA and SCL are not connected to ground or to each other, and cut the board's \
             power for a moment"
        }
        _ => {
            let sentence = format!("{error}; check the wires and the power of the board");
            return LinkError::new(LinkErrorKind::Other, name, sentence);
        }
    };
    LinkError::new(LinkErrorKind::Other, name, sentence)
}

/// One chip on a bus of Linux, `/dev/i2c-N`.
///
/// Transfers are those of `SMBus`, of 32 bytes at most, because every adapter supports them. The adapters of PCs and
/// the kernel's `i2c-stub` support no others.
///
/// The chip is claimed by a lock on one byte of the bus's device node, the byte at the chip's address. Only programs that
/// may open the bus can take the lock. It holds in all namespaces that have the same node, and the kernel frees it when
/// the program ends. The driver of the bus ignores the lock, so it does not stop programs that never ask for it, such
/// as `i2cdetect`.
#[derive(Debug)]
pub struct Bus {
    name: String,
    chip: LinuxI2CDevice,
    period: Period,
    /// The lock belongs to this open file.
    _claim: File,
}

impl Bus {
    /// Opens the bus and claims the chip, for one link of one program.
    pub fn open(settings: &Pca9685Settings) -> Result<Self, LinkError> {
        let name = name(settings);
        let (node, address) = (PathBuf::from(format!("/dev/i2c-{}", settings.bus)), settings.address as u8);
        // A lock for writing needs a file that is open for writing.
        let claim = File::options().read(true).write(true).open(&node).map_err(|error| refused(&name, &error))?;
        match lock_byte(&claim, address) {
            Ok(()) => {}
            Err(Errno::AGAIN | Errno::ACCESS) => {
                let sentence = "another program moves servos there; end that program, or stop the service with \
                    `systemctl stop facewire`";
                return Err(LinkError::new(LinkErrorKind::Claimed, &name, sentence));
            }
            Err(error) => return Err(refused(&name, &error.into())),
        }
        let chip = LinuxI2CDevice::new(node, address.into()).map_err(|error| refused(&name, &error.into()))?;
        Ok(Self { name, chip, period: period(settings), _claim: claim })
    }

    fn run<T>(&mut self, work: impl FnOnce(&mut LinuxI2CDevice) -> io::Result<T>) -> Result<T, LinkError> {
        work(&mut self.chip).map_err(|error| refused(&self.name, &error))
    }

    /// Checks that the chip answers. Changes nothing.
    pub fn probe(&mut self) -> Result<(), LinkError> {
        self.run(chip::probe)
    }

    /// Makes the chip ready if it is not, and gives a channel this pulse, or none.
    pub fn set_pulse(&mut self, channel: u8, pulse_us: Option<f32>) -> Result<(), LinkError> {
        let period = self.period;
        self.run(|chip| {
            chip::prepare(chip, period)?;
            write_channels(chip, channel, &period.registers(pulse_us))
        })
    }
}

/// Locks one byte of the file for as long as it is open.
fn lock_byte(file: &File, byte: u8) -> Result<(), Errno> {
    let [l_type, l_whence] = [F_WRLCK, SEEK_SET].map(|constant| constant as c_short);
    let lock = flock { l_type, l_whence, l_start: byte.into(), l_len: 1, l_pid: 0 };
    let locked = fcntl(file, FcntlArg::F_OFD_SETLK(&lock));
    locked.map(drop).map_err(|error| Errno::from_raw_os_error(error as i32))
}

impl Registers for LinuxI2CDevice {
    fn read(&mut self, register: u8) -> io::Result<u8> {
        Ok(self.smbus_read_byte_data(register)?)
    }

    fn write(&mut self, register: u8, bytes: &[u8]) -> io::Result<()> {
        Ok(self.smbus_write_i2c_block_data(register, bytes)?)
    }
}

fn period(settings: &Pca9685Settings) -> Period {
    Period::new(settings.pulses_hz, settings.oscillator_hz)
}

/// The servos of one chip, and their motion.
#[derive(Debug)]
struct Servos {
    period: Period,
    channels: Vec<Channel>,
    stepped_at: Option<Instant>,
}

impl Servos {
    fn new(settings: &Pca9685Settings) -> Self {
        let channels = settings.channels.iter().map(Channel::new).collect();
        Self { period: period(settings), channels, stepped_at: None }
    }

    /// Makes the chip ready. Servos that it moves already go on from where its pulses hold them, whether this process or
    /// one that has crashed gave the pulses.
    fn start(&mut self, chip: &mut impl Registers) -> io::Result<()> {
        for channel in &mut self.channels {
            if let Some(pulse_us) = chip::read_pulse_us(chip, channel.number, self.period)? {
                channel.rest_at(pulse_us);
            }
        }
        self.stepped_at = None;
        chip::prepare(chip, self.period).map(drop)
    }

    /// Moves all channels on. Channels between those in use get no pulses.
    fn show(&mut self, packet: &Packet, chip: &mut impl Registers) -> io::Result<()> {
        let now = Instant::now();
        let step_s = self.stepped_at.replace(now).map_or(0.0, |before| (now - before).as_secs_f32());
        let input = ChannelInput::new(packet.state, packet.reason, packet.rotation, &packet.coefficients);
        let mut registers = [self.period.registers(None); CHANNELS as usize];
        let (mut first, mut last) = (CHANNELS, 0);
        for channel in &mut self.channels {
            let pulses = channel.step(&input, step_s);
            if let Some(registers) = registers.get_mut(usize::from(channel.number)) {
                *registers = self.period.registers(pulses.map(|pulses| pulses.now_us));
            }
            (first, last) = (first.min(channel.number), last.max(channel.number));
        }
        let registers = registers.get(usize::from(first)..=usize::from(last)).unwrap_or_default();
        write_channels(chip, first, registers.as_flattened())
    }
}

/// The chip as a device of a thread of its own: a bus that hangs blocks that thread alone.
#[derive(Debug)]
struct Chip {
    settings: Pca9685Settings,
    servos: Servos,
    open: Option<Bus>,
    checked_at: Instant,
}

impl Device for Chip {
    fn open(&mut self) -> Result<(), LinkError> {
        let mut bus = Bus::open(&self.settings)?;
        if bus.run(chip::has_external_clock)? {
            tracing::warn!(
                "link {}: another program has told the chip to go by a clock at its pin EXTCLK; if nothing is connected \
                 there, it makes no pulses: cut the chip's power for a moment",
                bus.name
            );
        }
        bus.run(|chip| self.servos.start(chip))?;
        tracing::info!("link opened: {}", bus.name);
        self.open = Some(bus);
        Ok(())
    }

    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
        let (Some(bus), Ok(packet)) = (&mut self.open, Packet::decode(message)) else { return Ok(false) };
        bus.run(|chip| self.servos.show(&packet, chip))?;
        Ok(true)
    }

    /// Checks once a second whether the chip still makes pulses, and makes it ready again if not.
    fn attend(&mut self) -> Result<(), LinkError> {
        let Some(bus) = &mut self.open else { return Ok(()) };
        if self.checked_at.elapsed() < CHECK_PERIOD {
            return Ok(());
        }
        self.checked_at = Instant::now();
        let period = self.servos.period;
        let cause = match bus.run(|chip| chip::prepare(chip, period))? {
            Found::Ready => return Ok(()),
            Found::Asleep => "the chip lost its power for a moment and was set up again; check its supply",
            Found::Altered => "another program changed the chip, which was set up again; end that program",
        };
        tracing::warn!("link {}: {cause}", bus.name);
        Ok(())
    }

    fn close(&mut self) {
        self.open = None;
    }
}

#[cfg(test)]
mod tests {
    use facewire_packet::{Reason, State};

    use super::chip::tests::Simulated;
    use super::*;
    use crate::config::{self, LinkKind};

    const JAW_OPEN: usize = 17;
    /// At 2.0 a second, the first servo moves by 1600 microseconds a second.
    const SETTINGS: &str = "[[link]]\nkind = \"pca9685\"\n\
        [[link.channel]]\nchannel = 9\nsources = { jawOpen = 1.0 }\npulse_at_0_us = 1900\npulse_at_1_us = 1100\n\
        speed_per_s = 2.0\nacceleration_per_s2 = 1000.0\n\
        [[link.channel]]\nchannel = 4\nsources = { jawOpen = 1.0, headYaw = 0.01 }\nloss = \"release\"\n";
    const SPEED_US_PER_S: f32 = 1600.0;

    fn servos(settings: &str) -> Servos {
        let settings = config::parse("test", settings).unwrap();
        let LinkKind::Pca9685(settings) = &settings.links[0].kind else { panic!("another kind") };
        Servos::new(settings)
    }

    fn started() -> (Servos, Simulated) {
        let (mut servos, mut chip) = (servos(SETTINGS), Simulated::powered_on());
        servos.start(&mut chip).unwrap();
        (servos, chip)
    }

    /// Shows a jaw and returns the pulses of channels 9 and 4.
    fn show((servos, chip): (&mut Servos, &mut Simulated), state: State, jaw_open: f32) -> [Option<f32>; 2] {
        let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
        let mut packet = Packet { state, reason, ..Packet::NEUTRAL };
        packet.coefficients[JAW_OPEN] = jaw_open;
        servos.show(&packet, chip).unwrap();
        [9, 4].map(|channel| chip.pulse_us(channel, 25e6))
    }

    #[test]
    fn the_pulse_goes_no_faster_than_the_limit_and_stays_between_both_ends_whatever_comes_in() {
        let ((mut servos, mut chip), begun) = (started(), Instant::now());
        let [first, _] = show((&mut servos, &mut chip), State::Live, 0.0).map(Option::unwrap);
        assert!((first - 1900.0).abs() < 3.0, "{first}");
        for wild in [1.0, f32::NAN, f32::INFINITY, 1e30, f32::NEG_INFINITY, 0.5, 1.0].iter().cycle().take(2000) {
            let [jaw, direct] = show((&mut servos, &mut chip), State::Live, *wild).map(Option::unwrap);
            // The way at the highest speed, and a step of the chip.
            let most_us = SPEED_US_PER_S * begun.elapsed().as_secs_f32() + 5.0;
            assert!(first - jaw <= most_us, "{jaw} after {:?}", begun.elapsed());
            assert!((1097.0..=1903.0).contains(&jaw) && (997.0..=2003.0).contains(&direct), "{jaw} {direct}");
        }
    }

    #[test]
    fn after_a_crash_servos_go_on_from_the_pulses_that_the_chip_has_kept_at_whatever_rate() {
        for pulses_hz in [50, 200] {
            let mut chip = Simulated::powered_on();
            let mut crashed = servos(&SETTINGS.replacen('\n', &format!("\npulses_hz = {pulses_hz}\n"), 1));
            crashed.start(&mut chip).unwrap();
            write_channels(&mut chip, 9, &crashed.period.registers(Some(1200.0))).unwrap();
            let mut servos = servos(SETTINGS);
            let begun = Instant::now();
            servos.start(&mut chip).unwrap();
            for _ in 0..5 {
                let [jaw, _] = show((&mut servos, &mut chip), State::Neutral, 0.0);
                let moved_us = jaw.unwrap() - 1200.0;
                let most_us = SPEED_US_PER_S * begun.elapsed().as_secs_f32() + 5.0;
                assert!((-5.0..=most_us).contains(&moved_us), "{moved_us} us after {:?}", begun.elapsed());
            }
        }
    }

    #[test]
    fn a_servo_whose_bus_has_failed_goes_on_from_where_it_is() {
        let (mut servos, mut chip) = started();
        let [before, _] = show((&mut servos, &mut chip), State::Live, 0.0).map(Option::unwrap);
        std::thread::sleep(Duration::from_millis(50));
        servos.start(&mut chip).unwrap();
        let [jaw, direct] = show((&mut servos, &mut chip), State::Live, 1.0).map(Option::unwrap);
        assert!((jaw - before).abs() < 5.0, "{jaw}");
        assert!((direct - 2000.0).abs() < 3.0, "a servo without limits is where the face wants it: {direct}");
    }

    #[test]
    fn channels_without_settings_get_no_pulses_and_a_lost_face_releases_only_those_that_ask_for_it() {
        let (mut servos, mut chip) = started();
        assert!(show((&mut servos, &mut chip), State::Live, 0.0).iter().all(Option::is_some));
        let others = (0..CHANNELS).filter(|channel| ![9, 4].contains(channel));
        assert!(others.into_iter().all(|channel| chip.pulse_us(channel, 25e6).is_none()));
        let [jaw, direct] = show((&mut servos, &mut chip), State::Neutral, 0.0);
        assert!(jaw.is_some() && direct.is_none());
    }

    #[test]
    fn each_error_of_a_bus_is_told_with_what_to_do() {
        for (errno, told) in [
            (Errno::NOENT, "switch I2C on"),
            (Errno::ACCESS, "group i2c"),
            (Errno::PERM, "i2c.conf"),
            (Errno::BUSY, "a driver of the kernel"),
            (Errno::NXIO, "no chip answers"),
            (Errno::TIMEDOUT, "the bus hangs"),
            (Errno::INVAL, "check the wires"),
        ] {
            let error = refused("I2C bus 1, address 0x40", &io::Error::from(errno)).to_string();
            assert!(error.starts_with("link I2C bus 1, address 0x40: ") && error.contains(told), "{error}");
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
}
