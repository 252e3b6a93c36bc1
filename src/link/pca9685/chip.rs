//! The registers of the PCA9685, by its data sheet (NXP, revision 4).

use std::io;
use std::thread;
use std::time::Duration;

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

/// Access to the registers of a chip.
pub trait Registers {
    fn read(&mut self, register: u8) -> io::Result<u8>;

    /// Writes to this register and those after it.
    fn write(&mut self, register: u8, bytes: &[u8]) -> io::Result<()>;
}

/// The period of the pulses.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    prescale: u8,
    oscillator_hz: f32,
}

impl Period {
    /// Returns the period that the chip can make and that is nearest to this rate.
    pub fn new(pulses_hz: u32, oscillator_hz: u32) -> Self {
        let ([least, most], oscillator_hz) = (PRESCALES, oscillator_hz as f32);
        let prescale = (oscillator_hz / (f32::from(STEPS) * pulses_hz as f32)).round() - 1.0;
        Self { prescale: prescale.clamp(least, most) as u8, oscillator_hz }
    }

    fn step_us(self) -> f32 {
        (f32::from(self.prescale) + 1.0) * 1e6 / self.oscillator_hz
    }

    pub fn longest_pulse_us(self) -> f32 {
        f32::from(STEPS - 1) * self.step_us()
    }

    /// Returns the contents of a channel's four registers for this pulse; `None` ends the pulses.
    pub fn registers(self, pulse_us: Option<f32>) -> [u8; 4] {
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
pub enum Found {
    /// It made pulses of the wanted period.
    Ready,
    /// It had no power before.
    Asleep,
    /// Another program has set it up.
    Altered,
}

/// Reads a register, to know whether the chip answers.
pub fn probe(chip: &mut impl Registers) -> io::Result<()> {
    chip.read(MODE1).map(drop)
}

/// Makes the chip ready if it is not: sets outputs and period and starts the oscillator. All channels are without pulses
/// then. A chip that is ready keeps its pulses.
pub fn prepare(chip: &mut impl Registers, period: Period) -> io::Result<Found> {
    let (mode, outputs, prescale) = (chip.read(MODE1)?, chip.read(MODE2)?, chip.read(PRE_SCALE)?);
    let is_asleep = mode & SLEEP != 0;
    if !is_asleep && mode & AUTO_INCREMENT != 0 && outputs & OUTPUT_BITS == OUTPUTS && prescale == period.prescale {
        return Ok(Found::Ready);
    }
    chip.write(MODE1, &[AUTO_INCREMENT | SLEEP])?;
    chip.write(ALL_LED_OFF_H, &[FULL])?;
    chip.write(MODE2, &[OUTPUTS])?;
    chip.write(PRE_SCALE, &[period.prescale])?;
    chip.write(MODE1, &[AUTO_INCREMENT])?;
    thread::sleep(OSCILLATOR_START);
    chip.write(MODE1, &[AUTO_INCREMENT | RESTART])?;
    Ok(if is_asleep { Found::Asleep } else { Found::Altered })
}

/// Returns the pulse of a channel that the chip makes now, whatever its period is.
pub fn read_pulse_us(chip: &mut impl Registers, channel: u8, period: Period) -> io::Result<Option<f32>> {
    if chip.read(MODE1)? & SLEEP != 0 || (chip.read(MODE2)? ^ OUTPUTS) & POLARITY_BITS != 0 {
        return Ok(None);
    }
    let period = Period { prescale: chip.read(PRE_SCALE)?, ..period };
    let mut contents = [0; 4];
    for (register, byte) in (first_register(channel)..).zip(&mut contents) {
        *byte = chip.read(register)?;
    }
    Ok(period.pulse_us(contents))
}

/// Whether the chip goes by a clock at its pin EXTCLK instead of its own.
pub fn has_external_clock(chip: &mut impl Registers) -> io::Result<bool> {
    Ok(chip.read(MODE1)? & EXTERNAL_CLOCK != 0)
}

/// Writes the registers of neighbouring channels, from those of this channel on.
pub fn write_channels(chip: &mut impl Registers, first: u8, bytes: &[u8]) -> io::Result<()> {
    let registers = (first_register(first)..).step_by(TRANSFER_BYTES);
    registers.zip(bytes.chunks(TRANSFER_BYTES)).try_for_each(|(register, bytes)| chip.write(register, bytes))
}

fn first_register(channel: u8) -> u8 {
    LED0_ON_L + 4 * channel.min(CHANNELS - 1)
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A chip that holds to its data sheet.
    pub struct Simulated {
        pub registers: [u8; 256],
        pub transfers: usize,
    }

    impl Simulated {
        /// A chip that has just got power.
        pub fn powered_on() -> Self {
            let mut registers = [0; 256];
            registers[usize::from(MODE1)] = SLEEP | 1;
            registers[usize::from(MODE2)] = OUTPUTS;
            registers[usize::from(PRE_SCALE)] = 30;
            (0..CHANNELS).for_each(|channel| registers[usize::from(first_register(channel)) + 3] = FULL);
            Self { registers, transfers: 0 }
        }

        fn set(&mut self, register: u8, byte: u8) {
            let mode = self.registers[0];
            match register {
                // Writing 1 to RESTART clears it; sleep sets it.
                MODE1 => {
                    let was_running = mode & SLEEP == 0 && byte & SLEEP != 0;
                    let restart = if was_running { RESTART } else { 0 };
                    self.registers[0] = byte & !RESTART | restart | mode & EXTERNAL_CLOCK;
                }
                PRE_SCALE if mode & SLEEP == 0 => {}
                ALL_LED_OFF_H => {
                    (0..CHANNELS).for_each(|channel| self.registers[usize::from(first_register(channel)) + 3] = byte);
                }
                _ => self.registers[usize::from(register)] = byte,
            }
        }

        /// Lets another program set MODE1 or MODE2.
        pub fn altered(mut self, mode1: u8, mode2: u8) -> Self {
            (self.registers[0], self.registers[1]) = (mode1, mode2);
            self
        }

        /// The pulse that a servo gets, microseconds.
        pub fn pulse_us(&self, channel: u8, oscillator_hz: f32) -> Option<f32> {
            let first = usize::from(first_register(channel));
            let [on_low, on_high, off_low, off_high] = [0, 1, 2, 3].map(|place| self.registers[first + place]);
            let is_on = self.registers[0] & SLEEP == 0 && self.registers[1] == OUTPUTS && off_high & FULL == 0;
            let steps = u16::from_le_bytes([off_low, off_high]) - u16::from_le_bytes([on_low, on_high]);
            let step_us = (f32::from(self.registers[usize::from(PRE_SCALE)]) + 1.0) * 1e6 / oscillator_hz;
            is_on.then_some(f32::from(steps) * step_us)
        }
    }

    impl Registers for Simulated {
        fn read(&mut self, register: u8) -> io::Result<u8> {
            Ok(self.registers[usize::from(register)])
        }

        fn write(&mut self, register: u8, bytes: &[u8]) -> io::Result<()> {
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
        assert_eq!([25_000_000, 27_000_000].map(|hz| Period::new(50, hz).prescale), [121, 131]);
        assert!((Period::new(50, 27_000_000).longest_pulse_us() - 20_000.0).abs() < 80.0);
        assert_eq!([24, 4000].map(|hz| Period::new(hz, 25_000_000).prescale), [253, 3]);
    }

    #[test]
    fn a_chip_that_has_just_got_power_makes_the_pulses_of_its_channels_after_it_was_prepared() {
        let (mut chip, period) = (Simulated::powered_on(), Period::new(50, 25_000_000));
        let found = [(); 2].map(|()| prepare(&mut chip, period).unwrap());
        assert_eq!(found, [Found::Asleep, Found::Ready]);
        assert!((0..CHANNELS).all(|channel| chip.pulse_us(channel, 25e6).is_none()));
        let pulses: Vec<Option<f32>> =
            (0_u8..16).map(|channel| (channel != 5).then_some(1000.0 + 50.0 * f32::from(channel))).collect();
        let bytes: Vec<u8> = pulses.iter().flat_map(|pulse_us| period.registers(*pulse_us)).collect();
        let before = chip.transfers;
        write_channels(&mut chip, 0, &bytes).unwrap();
        assert_eq!(chip.transfers - before, 2, "16 channels in two transfers");
        for (channel, wanted) in (0..).zip(pulses) {
            let pulse_us = chip.pulse_us(channel, 25e6);
            let error = wanted.zip(pulse_us).map_or(0.0, |(wanted, pulse_us)| (wanted - pulse_us).abs());
            assert!(wanted.is_some() == pulse_us.is_some() && error <= 2.5, "{channel}: {pulse_us:?}");
            assert_eq!(read_pulse_us(&mut chip, channel, period).unwrap(), pulse_us);
        }
    }

    #[test]
    fn what_another_program_has_set_is_set_right_and_a_clock_that_cannot_be_is_told() {
        let period = Period::new(50, 25_000_000);
        for (mode1, mode2, prescale) in [
            (AUTO_INCREMENT, 0x14, 121),
            (AUTO_INCREMENT, 0x00, 121),
            (AUTO_INCREMENT, 0x0D, 121),
            (0, OUTPUTS, 121),
            (AUTO_INCREMENT, OUTPUTS, 30),
            (AUTO_INCREMENT | EXTERNAL_CLOCK, OUTPUTS, 30),
        ] {
            let mut chip = Simulated::powered_on().altered(mode1, mode2);
            chip.registers[usize::from(PRE_SCALE)] = prescale;
            let found = [(); 2].map(|()| prepare(&mut chip, period).unwrap());
            assert_eq!(found, [Found::Altered, Found::Ready], "{mode1:#x} {mode2:#x}");
            write_channels(&mut chip, 3, &period.registers(Some(1500.0))).unwrap();
            assert!((chip.pulse_us(3, 25e6).unwrap() - 1500.0).abs() <= 2.5, "{mode1:#x} {mode2:#x}");
            assert_eq!(has_external_clock(&mut chip).unwrap(), mode1 & EXTERNAL_CLOCK != 0);
        }
    }

    #[test]
    fn a_pulse_is_read_wherever_it_begins_and_no_pulse_is_read_of_channels_that_are_off_or_mean_something_else() {
        let period = Period { prescale: 121, oscillator_hz: 25e6 };
        let mut chip = Simulated::powered_on().altered(AUTO_INCREMENT, OUTPUTS);
        chip.registers[usize::from(PRE_SCALE)] = 30;
        // 1512 of 4096 steps at 200 Hz, which begin near the end of the period.
        for (contents, pulse_us) in [
            ([0xA0, 0x0F, 0x88, 0x05], Some(1874.9)),
            ([0, 0, 0, FULL], None),
            ([0, FULL, 0x33, 0x01], None),
            ([0x33, 0x01, 0x33, 0x01], None),
        ] {
            chip.registers[6..10].copy_from_slice(&contents);
            let read = read_pulse_us(&mut chip, 0, period).unwrap();
            assert!(read.zip(pulse_us).map_or(read == pulse_us, |(a, b)| (a - b).abs() < 0.1), "{contents:?} {read:?}");
        }
        chip.registers[6..10].copy_from_slice(&[0, 0, 0x33, 0x01]);
        for (mode1, mode2) in [(AUTO_INCREMENT | SLEEP, OUTPUTS), (AUTO_INCREMENT, 0x14), (AUTO_INCREMENT, 0x00)] {
            chip = chip.altered(mode1, mode2);
            assert_eq!(read_pulse_us(&mut chip, 0, period).unwrap(), None, "{mode1:#x} {mode2:#x}");
        }
    }

    #[test]
    fn no_pulse_reaches_the_reserved_bits_or_lasts_a_whole_period() {
        let period = Period::new(50, 25_000_000);
        for pulse_us in [f32::NAN, f32::NEG_INFINITY, -5.0, 0.0] {
            assert_eq!(period.registers(Some(pulse_us)), period.registers(None));
        }
        for pulse_us in [f32::INFINITY, 1e9, 20_000.0] {
            assert_eq!(period.registers(Some(pulse_us)), [0, 0, 0xFF, 0x0F]);
        }
    }
}
