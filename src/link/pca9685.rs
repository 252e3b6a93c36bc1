//! PCA9685: servos by I2C. The registers are those of its data sheet (NXP, revision 4).
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

use std::fmt::Display;
use std::fs::File;
use std::io;
use std::path::PathBuf;
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};

use facewire_packet::Packet;
use i2cdev::core::I2CDevice as _;
use i2cdev::linux::LinuxI2CDevice;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc::{F_WRLCK, SEEK_SET, c_short, flock};
use rustix::io::Errno;

use super::background::{Background, Device, Session};
use super::{LinkError, LinkErrorKind, Traffic};
use crate::config::Pca9685Settings;
use crate::servo::{Channel, ChannelInput};

/// Time between two checks whether the chip still makes pulses.
const CHECK_PERIOD: Duration = Duration::from_secs(1);

pub const CHANNELS: u8 = 16;
/// Steps of one period.
const STEPS: u16 = 4096;
/// Values of the prescaler that the chip takes.
const PRESCALES: [f32; 2] = [3.0, 255.0];

const MODE1: u8 = 0x00;
const MODE2: u8 = 0x01;
/// First register of channel 0. Each channel has four: ON low, ON high, OFF low, OFF high.
const LED0_ON_L: u8 = 0x06;
/// High OFF register of all channels at once.
const ALL_LED_OFF_H: u8 = 0xFD;
/// The divider of the oscillator. It can be written only while the chip sleeps.
const PRE_SCALE: u8 = 0xFE;

/// MODE1: continue the pulses that sleep has stopped.
const RESTART: u8 = 0x80;
/// MODE1: the clock comes from the pin EXTCLK. Once set, only a loss of power clears this bit, or a reset of all chips on
/// the bus.
const EXTERNAL_CLOCK: u8 = 0x40;
/// MODE1: a transfer writes to one register after the other.
const AUTO_INCREMENT: u8 = 0x20;
/// MODE1: the oscillator is off. A chip that has just got power sleeps.
const SLEEP: u8 = 0x10;
/// MODE2: outputs drive high and low, are not inverted, change at the end of a transfer, and are low while OE is high.
const OUTPUTS: u8 = 0x04;
/// MODE2: the bits that can be written.
const OUTPUT_BITS: u8 = 0x1F;
/// MODE2: of these, the bits that say what a pulse looks like: inversion, and open drain if it is 0.
const POLARITY_BITS: u8 = 0x14;
/// High ON and OFF registers: no pulses, but always on or always off.
const FULL: u8 = 0x10;

/// Time that the oscillator takes to start.
const OSCILLATOR_START: Duration = Duration::from_micros(500);
/// Most bytes of one transfer. More would need an adapter that does not only speak `SMBus`.
const TRANSFER_BYTES: usize = 32;

/// Starts the thread that writes to the chip. The chip may get its power later.
pub fn carrier(settings: &Pca9685Settings, traffic: Arc<Traffic>) -> Result<Background, LinkError> {
    let chip = Chip { servos: Servos::new(settings), settings: settings.clone() };
    Background::start(name(settings), "fw-i2c", chip, true, traffic)
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
        Ok(Self { name, chip, period: Period::of(settings), _claim: claim })
    }

    fn run<T>(&mut self, work: impl FnOnce(&mut LinuxI2CDevice) -> io::Result<T>) -> Result<T, LinkError> {
        work(&mut self.chip).map_err(|error| refused(&self.name, &error))
    }

    /// Checks that the chip answers. Changes nothing.
    pub fn probe(&mut self) -> Result<(), LinkError> {
        self.run(|chip| chip.get(MODE1).map(drop))
    }

    /// Makes the chip ready if it is not, and gives a channel this pulse, or none.
    pub fn set_pulse(&mut self, channel: u8, pulse_us: Option<f32>) -> Result<(), LinkError> {
        let period = self.period;
        self.run(|chip| {
            chip.prepare(period)?;
            chip.write_channels(channel, &period.registers(pulse_us))
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

/// The period of the pulses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    prescale: u8,
    oscillator_hz: f32,
}

impl Period {
    /// Returns the period that the chip can make and that is nearest to the rate in the settings.
    pub fn of(settings: &Pca9685Settings) -> Self {
        let ([least, most], oscillator_hz) = (PRESCALES, settings.oscillator_hz as f32);
        let prescale = (oscillator_hz / (f32::from(STEPS) * settings.pulses_hz as f32)).round() - 1.0;
        Self { prescale: prescale.clamp(least, most) as u8, oscillator_hz }
    }

    fn step_us(self) -> f32 {
        (f32::from(self.prescale) + 1.0) * 1e6 / self.oscillator_hz
    }

    pub fn longest_pulse_us(self) -> f32 {
        f32::from(STEPS - 1) * self.step_us()
    }

    /// Returns the contents of a channel's four registers for this pulse; `None` ends the pulses.
    fn registers(self, pulse_us: Option<f32>) -> [u8; 4] {
        let steps = pulse_us.map(|pulse_us| (pulse_us / self.step_us()).round());
        match steps.filter(|steps| *steps >= 1.0) {
            Some(steps) => {
                let [low, high] = (steps.min(f32::from(STEPS - 1)) as u16).to_le_bytes();
                [0, 0, low, high]
            }
            None => [0, 0, 0, FULL],
        }
    }

    /// Returns the pulse that these contents of a channel's registers make, which may begin at any step of the period.
    fn pulse_us(self, [on_low, on_high, off_low, off_high]: [u8; 4]) -> Option<f32> {
        let [on, off] = [[on_low, on_high], [off_low, off_high]].map(u16::from_le_bytes);
        let steps = off.wrapping_sub(on) % STEPS;
        let has_pulses = (on_high | off_high) & FULL == 0 && steps > 0;
        has_pulses.then(|| f32::from(steps) * self.step_us())
    }
}

/// What a chip was doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Found {
    /// It made pulses of the wanted period.
    Ready,
    /// It had no power before.
    Asleep,
    /// Another program has set it up.
    Altered,
}

/// Access to the registers of a chip.
trait Registers {
    fn get(&mut self, register: u8) -> io::Result<u8>;

    /// Writes to this register and those after it.
    fn put(&mut self, register: u8, bytes: &[u8]) -> io::Result<()>;

    /// Makes the chip ready if it is not: sets outputs and period and starts the oscillator. All channels are without
    /// pulses then. A chip that is ready keeps its pulses.
    fn prepare(&mut self, period: Period) -> io::Result<Found> {
        let (mode, outputs, prescale) = (self.get(MODE1)?, self.get(MODE2)?, self.get(PRE_SCALE)?);
        let is_asleep = mode & SLEEP != 0;
        let is_set_up = outputs & OUTPUT_BITS == OUTPUTS && prescale == period.prescale;
        if !is_asleep && mode & AUTO_INCREMENT != 0 && is_set_up {
            return Ok(Found::Ready);
        }
        self.put(MODE1, &[AUTO_INCREMENT | SLEEP])?;
        self.put(ALL_LED_OFF_H, &[FULL])?;
        self.put(MODE2, &[OUTPUTS])?;
        self.put(PRE_SCALE, &[period.prescale])?;
        self.put(MODE1, &[AUTO_INCREMENT])?;
        thread::sleep(OSCILLATOR_START);
        self.put(MODE1, &[AUTO_INCREMENT | RESTART])?;
        Ok(if is_asleep { Found::Asleep } else { Found::Altered })
    }

    /// Returns the pulse of a channel that the chip makes now, whatever its period is.
    fn read_pulse_us(&mut self, channel: u8, period: Period) -> io::Result<Option<f32>> {
        if self.get(MODE1)? & SLEEP != 0 || (self.get(MODE2)? ^ OUTPUTS) & POLARITY_BITS != 0 {
            return Ok(None);
        }
        let period = Period { prescale: self.get(PRE_SCALE)?, ..period };
        let mut contents = [0; 4];
        for (register, byte) in (first_register(channel)..).zip(&mut contents) {
            *byte = self.get(register)?;
        }
        Ok(period.pulse_us(contents))
    }

    /// Whether the chip goes by a clock at its pin EXTCLK instead of its own.
    fn has_external_clock(&mut self) -> io::Result<bool> {
        Ok(self.get(MODE1)? & EXTERNAL_CLOCK != 0)
    }

    /// Writes the registers of neighbouring channels, from those of this channel on.
    fn write_channels(&mut self, first: u8, bytes: &[u8]) -> io::Result<()> {
        let registers = (first_register(first)..).step_by(TRANSFER_BYTES);
        registers.zip(bytes.chunks(TRANSFER_BYTES)).try_for_each(|(register, bytes)| self.put(register, bytes))
    }
}

fn first_register(channel: u8) -> u8 {
    LED0_ON_L + 4 * channel.min(CHANNELS - 1)
}

impl Registers for LinuxI2CDevice {
    fn get(&mut self, register: u8) -> io::Result<u8> {
        Ok(self.smbus_read_byte_data(register)?)
    }

    fn put(&mut self, register: u8, bytes: &[u8]) -> io::Result<()> {
        Ok(self.smbus_write_i2c_block_data(register, bytes)?)
    }
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
        Self { period: Period::of(settings), channels, stepped_at: None }
    }

    /// Makes the chip ready. Servos that it moves already go on from where its pulses hold them, whether this process or
    /// one that has crashed gave the pulses.
    fn start(&mut self, chip: &mut impl Registers) -> io::Result<()> {
        for channel in &mut self.channels {
            if let Some(pulse_us) = chip.read_pulse_us(channel.number, self.period)? {
                channel.rest_at(pulse_us);
            }
        }
        self.stepped_at = None;
        chip.prepare(self.period).map(drop)
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
        chip.write_channels(first, registers.as_flattened())
    }
}

/// The chip as a device of a thread of its own: a bus that hangs blocks that thread alone.
#[derive(Debug)]
struct Chip {
    settings: Pca9685Settings,
    servos: Servos,
}

/// The chip on its open bus.
struct Moving<'a> {
    servos: &'a mut Servos,
    bus: Bus,
    checked_at: Instant,
}

impl Device for Chip {
    fn open(&mut self) -> Result<impl Session, LinkError> {
        let (servos, mut bus) = (&mut self.servos, Bus::open(&self.settings)?);
        if bus.run(Registers::has_external_clock)? {
            tracing::warn!(
                "link {}: another program has told the chip to go by a clock at its pin EXTCLK; if nothing is connected \
                 there, it makes no pulses: cut the chip's power for a moment",
                bus.name
            );
        }
        bus.run(|chip| servos.start(chip))?;
        tracing::info!("link opened: {}", bus.name);
        Ok(Moving { servos, bus, checked_at: Instant::now() })
    }
}

impl Session for Moving<'_> {
    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
        let Ok(packet) = Packet::decode(message) else { return Ok(false) };
        self.bus.run(|chip| self.servos.show(&packet, chip))?;
        Ok(true)
    }

    /// Checks once a second whether the chip still makes pulses, and makes it ready again if not.
    fn attend(&mut self) -> Result<(), LinkError> {
        if self.checked_at.elapsed() < CHECK_PERIOD {
            return Ok(());
        }
        self.checked_at = Instant::now();
        let cause = match self.bus.run(|chip| chip.prepare(self.servos.period))? {
            Found::Ready => return Ok(()),
            Found::Asleep => "the chip lost its power for a moment and was set up again; check its supply",
            Found::Altered => "another program changed the chip, which was set up again; end that program",
        };
        tracing::warn!("link {}: {cause}", self.bus.name);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use facewire_packet::{Reason, State};

    use super::*;
    use crate::config::LinkKind;
    use crate::link::testing::kind;

    const JAW_OPEN: usize = 17;
    /// At 2.0 a second, the first servo moves by 1600 microseconds a second.
    const SETTINGS: &str = "\
        [[link.channel]]\nchannel = 9\nsources = { jawOpen = 1.0 }\npulse_at_0_us = 1900\npulse_at_1_us = 1100\n\
        speed_per_s = 2.0\nacceleration_per_s2 = 1000.0\n\
        [[link.channel]]\nchannel = 4\nsources = { jawOpen = 1.0, headYaw = 0.01 }\nloss = \"release\"\n";
    const SPEED_US_PER_S: f32 = 1600.0;

    fn settings(keys: &str) -> Pca9685Settings {
        let LinkKind::Pca9685(settings) = kind("pca9685", &[keys, SETTINGS].concat()) else { unreachable!() };
        settings
    }

    fn period(pulses_hz: u32, oscillator_hz: u32) -> Period {
        Period::of(&Pca9685Settings { pulses_hz, oscillator_hz, ..Pca9685Settings::default() })
    }

    /// A chip that holds to its data sheet, and the number of transfers to it.
    struct Simulated([u8; 256], usize);

    impl Simulated {
        /// A chip that has just got power.
        fn powered_on() -> Self {
            let mut chip = Self([0; 256], 0);
            chip.set_up(SLEEP | 1, OUTPUTS, 30);
            chip.set(ALL_LED_OFF_H, FULL);
            chip
        }

        /// Lets another program set these registers.
        fn set_up(&mut self, mode1: u8, mode2: u8, prescale: u8) {
            (self.0[0], self.0[1], self.0[usize::from(PRE_SCALE)]) = (mode1, mode2, prescale);
        }

        fn set(&mut self, register: u8, byte: u8) {
            let mode = self.0[0];
            match register {
                // Writing 1 to RESTART clears it; sleep sets it.
                MODE1 => {
                    let restart = if mode & SLEEP == 0 && byte & SLEEP != 0 { RESTART } else { 0 };
                    self.0[0] = byte & !RESTART | restart | mode & EXTERNAL_CLOCK;
                }
                PRE_SCALE if mode & SLEEP == 0 => {}
                ALL_LED_OFF_H => {
                    (0..CHANNELS).for_each(|channel| self.0[usize::from(first_register(channel)) + 3] = byte);
                }
                _ => self.0[usize::from(register)] = byte,
            }
        }

        /// The pulse that a servo gets by an oscillator of 25 MHz, microseconds.
        fn pulse_us(&self, channel: u8) -> Option<f32> {
            let first = usize::from(first_register(channel));
            let [on_low, on_high, off_low, off_high] = [0, 1, 2, 3].map(|place| self.0[first + place]);
            let is_on = self.0[0] & SLEEP == 0 && self.0[1] == OUTPUTS && off_high & FULL == 0;
            let steps = u16::from_le_bytes([off_low, off_high]) - u16::from_le_bytes([on_low, on_high]);
            let step_us = (f32::from(self.0[usize::from(PRE_SCALE)]) + 1.0) / 25.0;
            is_on.then_some(f32::from(steps) * step_us)
        }
    }

    impl Registers for Simulated {
        fn get(&mut self, register: u8) -> io::Result<u8> {
            Ok(self.0[usize::from(register)])
        }

        fn put(&mut self, register: u8, bytes: &[u8]) -> io::Result<()> {
            assert!(bytes.len() <= 32, "more than SMBus carries");
            self.1 += 1;
            let increment = u8::from(self.0[0] & AUTO_INCREMENT != 0);
            (0..).zip(bytes).for_each(|(place, byte)| self.set(register + place * increment, *byte));
            Ok(())
        }
    }

    fn started() -> (Servos, Simulated) {
        let (mut servos, mut chip) = (Servos::new(&settings("")), Simulated::powered_on());
        servos.start(&mut chip).unwrap();
        (servos, chip)
    }

    /// Shows a jaw and returns the pulses of channels 9 and 4.
    fn show((servos, chip): (&mut Servos, &mut Simulated), state: State, jaw_open: f32) -> [Option<f32>; 2] {
        let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
        let mut packet = Packet { state, reason, ..Packet::NEUTRAL };
        packet.coefficients[JAW_OPEN] = jaw_open;
        servos.show(&packet, chip).unwrap();
        [9, 4].map(|channel| chip.pulse_us(channel))
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
            let crashed = period(pulses_hz, 25_000_000);
            chip.prepare(crashed).unwrap();
            chip.write_channels(9, &crashed.registers(Some(1200.0))).unwrap();
            let (mut servos, begun) = (Servos::new(&settings("")), Instant::now());
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
        thread::sleep(Duration::from_millis(50));
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
        assert!(others.into_iter().all(|channel| chip.pulse_us(channel).is_none()));
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
        let [first, second] = [(); 2].map(|()| File::options().read(true).write(true).open(file.path()).unwrap());
        assert_eq!(lock_byte(&first, 0x40), Ok(()));
        assert_eq!(lock_byte(&second, 0x40), Err(Errno::AGAIN));
        assert_eq!(lock_byte(&second, 0x41), Ok(()), "another chip");
        drop(first);
        assert_eq!(lock_byte(&second, 0x40), Ok(()));
    }

    #[test]
    fn the_prescaler_is_that_of_the_data_sheet_and_follows_the_oscillator() {
        // After power-on, it is 30 for 200 Hz.
        for (pulses_hz, oscillator_hz, prescale) in
            [(200, 25_000_000, 30), (50, 25_000_000, 121), (50, 27_000_000, 131), (24, 25_000_000, 253)]
        {
            assert_eq!(period(pulses_hz, oscillator_hz).prescale, prescale);
        }
        assert!((period(50, 27_000_000).longest_pulse_us() - 20_000.0).abs() < 80.0);
    }

    #[test]
    fn a_chip_that_has_just_got_power_makes_the_pulses_of_its_channels_after_it_was_prepared() {
        let (mut chip, period) = (Simulated::powered_on(), period(50, 25_000_000));
        assert_eq!([(); 2].map(|()| chip.prepare(period).unwrap()), [Found::Asleep, Found::Ready]);
        assert!((0..CHANNELS).all(|channel| chip.pulse_us(channel).is_none()));
        let pulse_us = |channel: u8| (channel != 5).then_some(1000.0 + 50.0 * f32::from(channel));
        let pulses: Vec<Option<f32>> = (0..CHANNELS).map(pulse_us).collect();
        let bytes: Vec<u8> = pulses.iter().flat_map(|pulse_us| period.registers(*pulse_us)).collect();
        let before = chip.1;
        chip.write_channels(0, &bytes).unwrap();
        assert_eq!(chip.1 - before, 2, "16 channels in two transfers");
        for (channel, wanted) in (0..).zip(pulses) {
            let pulse_us = chip.pulse_us(channel);
            let error = wanted.zip(pulse_us).map_or(0.0, |(wanted, pulse_us)| (wanted - pulse_us).abs());
            assert!(wanted.is_some() == pulse_us.is_some() && error <= 2.5, "{channel}: {pulse_us:?}");
            assert_eq!(chip.read_pulse_us(channel, period).unwrap(), pulse_us);
        }
    }

    #[test]
    fn what_another_program_has_set_is_set_right_and_a_clock_that_cannot_be_is_told() {
        let period = period(50, 25_000_000);
        for (mode1, mode2, prescale) in [
            (AUTO_INCREMENT, 0x14, 121),
            (AUTO_INCREMENT, 0x00, 121),
            (AUTO_INCREMENT, 0x0D, 121),
            (0, OUTPUTS, 121),
            (AUTO_INCREMENT, OUTPUTS, 30),
            (AUTO_INCREMENT | EXTERNAL_CLOCK, OUTPUTS, 30),
        ] {
            let mut chip = Simulated::powered_on();
            chip.set_up(mode1, mode2, prescale);
            let found = [(); 2].map(|()| chip.prepare(period).unwrap());
            assert_eq!(found, [Found::Altered, Found::Ready], "{mode1:#x} {mode2:#x}");
            chip.write_channels(3, &period.registers(Some(1500.0))).unwrap();
            assert!((chip.pulse_us(3).unwrap() - 1500.0).abs() <= 2.5, "{mode1:#x} {mode2:#x}");
            assert_eq!(chip.has_external_clock().unwrap(), mode1 & EXTERNAL_CLOCK != 0);
        }
    }

    #[test]
    fn a_pulse_is_read_wherever_it_begins_and_no_pulse_is_read_of_channels_that_are_off_or_mean_something_else() {
        let mut chip = Simulated::powered_on();
        // 1512 of 4096 steps at 200 Hz, which begin near the end of the period.
        let (late, full_on, empty) = ([0xA0, 0x0F, 0x88, 0x05], [0, FULL, 0x33, 0x01], [0x33, 0x01, 0x33, 0x01]);
        for (mode1, mode2, contents, want_us) in [
            (AUTO_INCREMENT, OUTPUTS, late, Some(1874.9)),
            (AUTO_INCREMENT, OUTPUTS, [0, 0, 0, FULL], None),
            (AUTO_INCREMENT, OUTPUTS, full_on, None),
            (AUTO_INCREMENT, OUTPUTS, empty, None),
            (AUTO_INCREMENT | SLEEP, OUTPUTS, late, None),
            (AUTO_INCREMENT, 0x14, late, None),
            (AUTO_INCREMENT, 0x00, late, None),
        ] {
            chip.set_up(mode1, mode2, 30);
            chip.0[6..10].copy_from_slice(&contents);
            let read_us = chip.read_pulse_us(0, period(50, 25_000_000)).unwrap();
            let is_right = read_us.zip(want_us).map_or(read_us == want_us, |(read, want)| (read - want).abs() < 0.1);
            assert!(is_right, "{mode1:#x} {mode2:#x} {contents:?} {read_us:?}");
        }
    }

    #[test]
    fn no_pulse_reaches_the_reserved_bits_or_lasts_a_whole_period() {
        let registers = |pulse_us| period(50, 25_000_000).registers(Some(pulse_us));
        assert_eq!([f32::NAN, f32::NEG_INFINITY, -5.0, 0.0].map(registers), [[0, 0, 0, FULL]; 4]);
        assert_eq!([f32::INFINITY, 1e9, 20_000.0].map(registers), [[0, 0, 0xFF, 0x0F]; 3]);
    }
}
