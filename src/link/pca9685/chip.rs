//! The registers of the PCA9685, by its data sheet (NXP, revision 4).

use std::io;
use std::thread;
use std::time::Duration;

/// Number of channels.
pub const CHANNELS: u8 = 16;
/// Steps of one period.
const STEPS: f32 = 4096.0;
/// Values of the prescaler that the chip takes.
const PRESCALES: [f32; 2] = [3.0, 255.0];

/// First register of mode.
const MODE1: u8 = 0x00;
/// Second register of mode.
const MODE2: u8 = 0x01;
/// First register of channel 0. Each channel has four: ON low, ON high, OFF low, OFF high.
const LED0_ON_L: u8 = 0x06;
/// High OFF register of all channels at once.
const ALL_LED_OFF_H: u8 = 0xFD;
/// The divider of the oscillator. It can be written only while the chip sleeps.
const PRE_SCALE: u8 = 0xFE;

/// MODE1: continue the pulses that sleep has stopped.
const RESTART: u8 = 0x80;
/// MODE1: a transfer writes to one register after the other.
const AUTO_INCREMENT: u8 = 0x20;
/// MODE1: the oscillator is off. A chip that has just got power sleeps.
const SLEEP: u8 = 0x10;
/// MODE2: outputs drive high and low, and change at the end of a transfer.
const TOTEM_POLE: u8 = 0x04;
/// High OFF register: no pulses.
const FULL_OFF: u8 = 0x10;

/// Time that the oscillator takes to start.
const OSCILLATOR_START: Duration = Duration::from_micros(500);
/// Most bytes of one transfer. More would need an adapter that does not only speak `SMBus`.
const TRANSFER_BYTES: usize = 32;

/// Access to the registers of a chip.
pub trait Registers {
    /// Reads one register.
    ///
    /// # Errors
    /// Returns the error of the bus.
    fn read(&mut self, register: u8) -> io::Result<u8>;

    /// Writes to this register and those after it.
    ///
    /// # Errors
    /// Returns the error of the bus.
    fn write(&mut self, register: u8, bytes: &[u8]) -> io::Result<()>;
}

/// The period of the pulses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    prescale: u8,
    step_us: f32,
}

impl Period {
    /// Returns the period that the chip can make and that is nearest to this rate.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "limited to a byte")]
    pub fn new(pulses_hz: u32, oscillator_hz: u32) -> Self {
        let [least, most] = PRESCALES;
        let oscillator_hz = oscillator_hz as f32;
        let prescale = ((oscillator_hz / (STEPS * pulses_hz as f32)).round() - 1.0).clamp(least, most);
        Self { prescale: prescale as u8, step_us: (prescale + 1.0) * 1e6 / oscillator_hz }
    }

    /// The longest pulse, microseconds.
    #[must_use]
    pub fn longest_pulse_us(self) -> f32 {
        (STEPS - 1.0) * self.step_us
    }

    /// Returns the contents of a channel's four registers for this pulse; `None` ends the pulses.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "limited to 12 bits")]
    pub fn channel(self, pulse_us: Option<f32>) -> [u8; 4] {
        let steps = pulse_us.map(|pulse_us| (pulse_us / self.step_us).round());
        match steps.filter(|steps| *steps >= 1.0) {
            Some(steps) => {
                let [low, high] = (steps.min(STEPS - 1.0) as u16).to_le_bytes();
                [0, 0, low, high]
            }
            None => [0, 0, 0, FULL_OFF],
        }
    }
}

/// Returns the first register of a channel.
#[must_use]
pub fn register(channel: u8) -> u8 {
    LED0_ON_L + 4 * channel.min(CHANNELS - 1)
}

/// Reads a register, to know whether the chip answers.
///
/// # Errors
/// Returns the error of the bus.
pub fn probe(chip: &mut impl Registers) -> io::Result<()> {
    chip.read(MODE1).map(drop)
}

/// Makes the chip ready if it is not. Returns whether it was not.
///
/// # Errors
/// Returns the error of the bus.
pub fn prepare(chip: &mut impl Registers, period: Period) -> io::Result<bool> {
    let is_ready = is_ready(chip, period)?;
    if !is_ready {
        initialise(chip, period)?;
    }
    Ok(!is_ready)
}

/// Whether the chip makes pulses of this period. A chip that lost its power in the meantime does not.
fn is_ready(chip: &mut impl Registers, period: Period) -> io::Result<bool> {
    let mode = chip.read(MODE1)?;
    Ok(mode & SLEEP == 0 && mode & AUTO_INCREMENT != 0 && chip.read(PRE_SCALE)? == period.prescale)
}

/// Sets the period and starts the oscillator. All channels are without pulses then.
fn initialise(chip: &mut impl Registers, period: Period) -> io::Result<()> {
    chip.write(MODE1, &[AUTO_INCREMENT | SLEEP])?;
    chip.write(ALL_LED_OFF_H, &[FULL_OFF])?;
    chip.write(MODE2, &[TOTEM_POLE])?;
    chip.write(PRE_SCALE, &[period.prescale])?;
    chip.write(MODE1, &[AUTO_INCREMENT])?;
    thread::sleep(OSCILLATOR_START);
    chip.write(MODE1, &[AUTO_INCREMENT | RESTART])
}

/// Writes the registers of neighbouring channels, from this register on.
///
/// # Errors
/// Returns the error of the bus.
pub fn write_channels(chip: &mut impl Registers, first: u8, bytes: &[u8]) -> io::Result<()> {
    let registers = (first..).step_by(TRANSFER_BYTES);
    registers.zip(bytes.chunks(TRANSFER_BYTES)).try_for_each(|(register, bytes)| chip.write(register, bytes))
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A chip that holds to its data sheet.
    pub struct Simulated {
        pub registers: [u8; 256],
        /// What the bus answers instead of the chip.
        pub fault: Option<io::ErrorKind>,
        pub transfers: usize,
    }

    impl Simulated {
        /// A chip that has just got power.
        pub fn powered_on() -> Self {
            let mut registers = [0; 256];
            registers[usize::from(MODE1)] = SLEEP | 1;
            registers[usize::from(PRE_SCALE)] = 30;
            (0..CHANNELS).for_each(|channel| registers[usize::from(register(channel)) + 3] = FULL_OFF);
            Self { registers, fault: None, transfers: 0 }
        }

        fn set(&mut self, register: u8, byte: u8) {
            let is_asleep = self.registers[usize::from(MODE1)] & SLEEP != 0;
            match register {
                // Writing 1 to RESTART clears it; sleep sets it.
                MODE1 => {
                    let was_running = !is_asleep && byte & SLEEP != 0;
                    self.registers[0] = byte & !RESTART | if was_running { RESTART } else { 0 };
                }
                PRE_SCALE if !is_asleep => {}
                ALL_LED_OFF_H => {
                    (0..CHANNELS).for_each(|channel| self.registers[usize::from(LED0_ON_L + 4 * channel) + 3] = byte);
                }
                _ => self.registers[usize::from(register)] = byte,
            }
        }

        /// The pulse that a channel makes, microseconds.
        pub fn pulse_us(&self, channel: u8, oscillator_hz: f32) -> Option<f32> {
            let first = usize::from(register(channel));
            let [on_low, on_high, off_low, off_high] = [0, 1, 2, 3].map(|place| self.registers[first + place]);
            let is_on = self.registers[0] & SLEEP == 0 && off_high & FULL_OFF == 0;
            let steps = u16::from_le_bytes([off_low, off_high]) - u16::from_le_bytes([on_low, on_high]);
            let step_us = (f32::from(self.registers[usize::from(PRE_SCALE)]) + 1.0) * 1e6 / oscillator_hz;
            is_on.then_some(f32::from(steps) * step_us)
        }
    }

    impl Registers for Simulated {
        fn read(&mut self, register: u8) -> io::Result<u8> {
            self.fault.map_or(Ok(self.registers[usize::from(register)]), |fault| Err(fault.into()))
        }

        fn write(&mut self, register: u8, bytes: &[u8]) -> io::Result<()> {
            if let Some(fault) = self.fault {
                return Err(fault.into());
            }
            assert!(bytes.len() <= 32, "more than SMBus carries");
            self.transfers += 1;
            let increment = u8::from(self.registers[usize::from(MODE1)] & AUTO_INCREMENT != 0);
            for (place, byte) in (0..).zip(bytes) {
                self.set(register + place * increment, *byte);
            }
            Ok(())
        }
    }

    #[test]
    fn the_prescaler_is_that_of_the_data_sheet_and_follows_the_oscillator() {
        assert_eq!(Period::new(200, 25_000_000).prescale, 30, "the value after power-on, for 200 Hz");
        assert_eq!(Period::new(50, 25_000_000).prescale, 121);
        assert_eq!(Period::new(50, 27_000_000).prescale, 131);
        assert!((Period::new(50, 27_000_000).longest_pulse_us() - 20_000.0).abs() < 80.0);
        assert_eq!([24, 4000].map(|hz| Period::new(hz, 25_000_000).prescale), [253, 3]);
    }

    #[test]
    fn a_chip_that_has_just_got_power_makes_the_pulses_of_its_channels_after_it_was_initialised() {
        let (mut chip, period) = (Simulated::powered_on(), Period::new(50, 25_000_000));
        assert!(!is_ready(&mut chip, period).unwrap());
        initialise(&mut chip, period).unwrap();
        assert!(is_ready(&mut chip, period).unwrap());
        assert!((0..CHANNELS).all(|channel| chip.pulse_us(channel, 25e6).is_none()));
        let pulses: Vec<Option<f32>> =
            (0_u8..16).map(|channel| (channel != 5).then_some(1000.0 + 50.0 * f32::from(channel))).collect();
        let bytes: Vec<u8> = pulses.iter().flat_map(|pulse_us| period.channel(*pulse_us)).collect();
        let before = chip.transfers;
        write_channels(&mut chip, register(0), &bytes).unwrap();
        assert_eq!(chip.transfers - before, 2, "16 channels in two transfers");
        for (channel, wanted) in (0..).zip(pulses) {
            let pulse_us = chip.pulse_us(channel, 25e6);
            let error = wanted.zip(pulse_us).map_or(0.0, |(wanted, pulse_us)| (wanted - pulse_us).abs());
            assert!(wanted.is_some() == pulse_us.is_some() && error <= 2.5, "{channel}: {pulse_us:?}");
        }
    }

    #[test]
    fn another_period_is_set_while_the_chip_sleeps() {
        let mut chip = Simulated::powered_on();
        for pulses_hz in [50, 200] {
            let period = Period::new(pulses_hz, 25_000_000);
            initialise(&mut chip, period).unwrap();
            assert!(is_ready(&mut chip, period).unwrap(), "{pulses_hz}");
        }
    }

    #[test]
    fn no_pulse_reaches_the_reserved_bits_or_lasts_a_whole_period() {
        let period = Period::new(50, 25_000_000);
        for pulse_us in [f32::NAN, f32::NEG_INFINITY, -5.0, 0.0] {
            assert_eq!(period.channel(Some(pulse_us)), period.channel(None));
        }
        for pulse_us in [f32::INFINITY, 1e9, 20_000.0] {
            assert_eq!(period.channel(Some(pulse_us)), [0, 0, 0xFF, 0x0F]);
        }
    }
}
