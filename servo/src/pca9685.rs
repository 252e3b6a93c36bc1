//! NXP's PCA9685: servos by I2C. The registers are those of its data sheet (revision 4).
//!
//! Contract: the chip is set up if it does not make the wanted pulses: after power-on, after its power failed for a moment,
//! and after another program changed it. Motion goes on from the pulses that the chip makes, so that nothing jumps after a
//! crash or a failure of the bus. The limits of speed and acceleration are kept here, because the chip has none.
//! Limits: a servo without pulses begins at neutral, or where it was moved last.

use std::thread;
use std::time::{Duration, Instant};

use facewire_packet::Packet;

use crate::{Board, Channel};

pub const CHANNELS: u8 = 16;
const STEPS: u16 = 4096;

const MODE1: u8 = 0x00;
const MODE2: u8 = 0x01;
/// First register of channel 0. Each channel has four: ON low, ON high, OFF low, OFF high.
const LED0_ON_L: u8 = 0x06;
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
/// MODE2: the bits that can be written, and those of them that say what a pulse looks like: inversion, and open drain if
/// it is 0.
const OUTPUT_BITS: u8 = 0x1F;
const POLARITY_BITS: u8 = 0x14;
/// High ON and OFF registers: no pulses, but always on or always off.
const FULL: u8 = 0x10;

const OSCILLATOR_START: Duration = Duration::from_micros(500);
/// Most bytes of one transfer of `SMBus`. Every adapter supports these; those of PCs and the kernel's `i2c-stub` support no
/// longer ones.
const TRANSFER_BYTES: usize = 32;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    prescale: u8,
    oscillator_hz: f32,
}

impl Period {
    /// Returns the period that the chip can make and that is nearest to this rate of pulses.
    pub fn new(pulses_hz: u32, oscillator_hz: u32) -> Self {
        let oscillator_hz = oscillator_hz as f32;
        let prescale = (oscillator_hz / (f32::from(STEPS) * pulses_hz as f32)).round() - 1.0;
        Self { prescale: prescale.clamp(3.0, 255.0) as u8, oscillator_hz }
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
}

/// The registers of a chip, by which it is set up and moved.
pub trait Registers {
    type Error;

    fn get(&mut self, register: u8) -> Result<u8, Self::Error>;

    fn put(&mut self, register: u8, bytes: &[u8]) -> Result<(), Self::Error>;

    /// Makes the chip ready if it is not: sets outputs and period and starts the oscillator. All channels are without
    /// pulses then. A chip that is ready keeps its pulses. Returns what has happened to one that was not.
    fn prepare(&mut self, period: Period) -> Result<Option<&'static str>, Self::Error> {
        let (mode, outputs, prescale) = (self.get(MODE1)?, self.get(MODE2)?, self.get(PRE_SCALE)?);
        let is_asleep = mode & SLEEP != 0;
        let is_set_up = outputs & OUTPUT_BITS == OUTPUTS && prescale == period.prescale;
        if !is_asleep && mode & AUTO_INCREMENT != 0 && is_set_up {
            return Ok(None);
        }
        self.put(MODE1, &[AUTO_INCREMENT | SLEEP])?;
        self.put(ALL_LED_OFF_H, &[FULL])?;
        self.put(MODE2, &[OUTPUTS])?;
        self.put(PRE_SCALE, &[period.prescale])?;
        self.put(MODE1, &[AUTO_INCREMENT])?;
        thread::sleep(OSCILLATOR_START);
        self.put(MODE1, &[AUTO_INCREMENT | RESTART])?;
        Ok(Some(if is_asleep {
            "the chip lost its power for a moment and was set up again; check its supply"
        } else {
            "another program changed the chip, which was set up again; end that program"
        }))
    }

    /// Returns the pulse in microseconds that the chip now makes on a channel, at whichever step it begins.
    fn read_pulse_us(&mut self, channel: u8, period: Period) -> Result<Option<f32>, Self::Error> {
        if self.get(MODE1)? & SLEEP != 0 || (self.get(MODE2)? ^ OUTPUTS) & POLARITY_BITS != 0 {
            return Ok(None);
        }
        let period = Period { prescale: self.get(PRE_SCALE)?, ..period };
        let first = first_register(channel);
        let mut word = |register| Ok(u16::from_le_bytes([self.get(register)?, self.get(register + 1)?]));
        let (on, off) = (word(first)?, word(first + 2)?);
        let steps = off.wrapping_sub(on) % STEPS;
        let has_pulses = (on | off) >> 8 & u16::from(FULL) == 0 && steps > 0;
        Ok(has_pulses.then(|| f32::from(steps) * period.step_us()))
    }

    /// Whether the chip goes by a clock at its pin EXTCLK instead of its own.
    fn has_external_clock(&mut self) -> Result<bool, Self::Error> {
        Ok(self.get(MODE1)? & EXTERNAL_CLOCK != 0)
    }

    fn write_channels(&mut self, first: u8, bytes: &[u8]) -> Result<(), Self::Error> {
        let registers = (first_register(first)..).step_by(TRANSFER_BYTES);
        registers.zip(bytes.chunks(TRANSFER_BYTES)).try_for_each(|(register, bytes)| self.put(register, bytes))
    }
}

/// Reads the address of a chip, such as 0x40 or 64.
///
/// # Errors
/// If the text is none.
pub fn address(text: &str) -> Result<u32, String> {
    let number = text.strip_prefix("0x").map_or_else(|| text.parse(), |hex| u32::from_str_radix(hex, 16));
    let number = number.ok().filter(|number| (0x40..=0x7F).contains(number));
    number.ok_or_else(|| "write a number from 0x40 to 0x7f".to_owned())
}

fn first_register(channel: u8) -> u8 {
    LED0_ON_L + 4 * channel.min(CHANNELS - 1)
}

/// The servos of one chip. Motion goes on from the pulses that the chip makes.
pub struct Servos {
    period: Period,
    pub board: Board,
}

impl Servos {
    pub fn new(period: Period, board: Board) -> Self {
        Self { period, board }
    }

    /// Makes the chip ready. Servos that it moves already go on from where its pulses hold them, whether this process or
    /// one that has crashed gave the pulses.
    pub fn start<R: Registers>(&mut self, chip: &mut R) -> Result<(), R::Error> {
        let period = self.period;
        self.board.moved_at = None;
        for channel in &mut self.board.channels {
            if let Some(pulse_us) = chip.read_pulse_us(channel.number as u8, period)? {
                channel.rest_at(pulse_us);
            }
        }
        chip.prepare(period).map(drop)
    }

    /// Moves all channels on. Channels between those in use get no pulses.
    pub fn show<R: Registers>(&mut self, packet: &Packet, chip: &mut R, now: Instant) -> Result<(), R::Error> {
        self.board.follow(packet, now);
        if !self.board.is_off {
            // Some channels have pulses even if the chip fails while it is written to.
            self.board.dials.note_released(false);
        }
        self.write(chip, Channel::place_now)?;
        self.board.dials.note_released(self.board.is_off);
        Ok(())
    }

    /// Takes the pulses of all channels.
    pub fn release<R: Registers>(&self, chip: &mut R) -> Result<(), R::Error> {
        self.write(chip, |_| None)
    }

    fn write<R: Registers>(&self, chip: &mut R, pulse_us: fn(&Channel) -> Option<f32>) -> Result<(), R::Error> {
        let Self { period, board } = self;
        let channels = &board.channels;
        let [first, last] = [channels.first(), channels.last()].map(|channel| channel.map_or(0, |it| it.number as u8));
        let pulse_us = |number| channels.iter().find(|channel| channel.number == u16::from(number)).and_then(pulse_us);
        let registers: Vec<u8> = (first..=last).flat_map(|number| period.registers(pulse_us(number))).collect();
        chip.write_channels(first, &registers)
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;
    use std::sync::Arc;

    use facewire_packet::{Reason, State};

    use super::*;
    use crate::{AtLoss, ChannelSettings, Dials, channel::tests::valued};

    // The numbers of the data sheet, written again, so that the simulated chip shares no mistake with the code above.
    const MODE1: u8 = 0x00;
    const ALL_LED_OFF_H: u8 = 0xFD;
    const PRE_SCALE: u8 = 0xFE;
    const RESTART: u8 = 0x80;
    const EXTERNAL_CLOCK: u8 = 0x40;
    const AUTO_INCREMENT: u8 = 0x20;
    const SLEEP: u8 = 0x10;
    const OUTPUTS: u8 = 0x04;
    const FULL: u8 = 0x10;

    const JAW_OPEN: usize = 17;
    /// The first servo moves by 2.0 of its range a second.
    const SPEED_US_PER_S: f32 = 1600.0;

    fn period(pulses_hz: u32) -> Period {
        Period::new(pulses_hz, 25_000_000)
    }

    /// A chip that behaves as its data sheet says.
    struct Simulated([u8; 256]);

    impl Simulated {
        /// A chip that another program has set up.
        fn new(mode1: u8, mode2: u8, prescale: u8) -> Self {
            let mut chip = Self([0; 256]);
            (chip.0[0], chip.0[1], chip.0[usize::from(PRE_SCALE)]) = (mode1, mode2, prescale);
            chip.set(ALL_LED_OFF_H, FULL);
            chip
        }

        fn powered_on() -> Self {
            Self::new(SLEEP | 1, OUTPUTS, 30)
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
                    (0..16).for_each(|channel| self.0[6 + 4 * channel + 3] = byte);
                }
                _ => self.0[usize::from(register)] = byte,
            }
        }

        /// The pulses of these channels, microseconds; 0 for none.
        fn pulses_us<const N: usize>(&mut self, channels: [u8; N]) -> [f32; N] {
            channels.map(|channel| self.read_pulse_us(channel, period(50)).unwrap().unwrap_or(0.0))
        }
    }

    impl Registers for Simulated {
        type Error = Infallible;

        fn get(&mut self, register: u8) -> Result<u8, Infallible> {
            Ok(self.0[usize::from(register)])
        }

        fn put(&mut self, register: u8, bytes: &[u8]) -> Result<(), Infallible> {
            assert!(bytes.len() <= 32, "more than SMBus carries");
            let increment = u8::from(self.0[0] & AUTO_INCREMENT != 0);
            (0..).zip(bytes).for_each(|(place, byte)| self.set(register + place * increment, *byte));
            Ok(())
        }
    }

    fn start(chip: &mut Simulated) -> Servos {
        let limited = ChannelSettings { speed_per_s: 2.0, acceleration_per_s2: 1000.0, ..ChannelSettings::default() };
        let (pulse_at_0_us, pulse_at_1_us, sources) = (1900, 1100, valued(&[("jawOpen", 1.0)]));
        let jaw = ChannelSettings { channel: 9, sources, pulse_at_0_us, pulse_at_1_us, ..limited };
        let sources = valued(&[("jawOpen", 1.0), ("headYaw", 0.01)]);
        let direct = ChannelSettings { channel: 4, sources, loss: AtLoss::Release, ..ChannelSettings::default() };
        let board = Board::new(&[jaw, direct], &Arc::<Dials>::default());
        let mut servos = Servos::new(period(50), board);
        servos.start(chip).unwrap();
        servos
    }

    /// Shows a jaw and returns the pulses of channels 9 and 4.
    fn show(servos: &mut Servos, chip: &mut Simulated, state: State, jaw_open: f32) -> [f32; 2] {
        let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
        let mut packet = Packet { state, reason, ..Packet::NEUTRAL };
        packet.coefficients[JAW_OPEN] = jaw_open;
        servos.show(&packet, chip, Instant::now()).unwrap();
        chip.pulses_us([9, 4])
    }

    #[test]
    fn addresses_are_read_as_data_sheets_write_them() {
        assert_eq!(["0x40", "64", "0x7F"].map(address), [Ok(0x40), Ok(64), Ok(0x7F)]);
        assert!(["0x3f", "128", "", "x"].map(address).iter().all(Result::is_err));
    }

    #[test]
    fn after_a_crash_servos_go_on_from_the_pulses_that_the_chip_has_kept_at_whatever_rate() {
        for pulses_hz in [50, 200] {
            let (mut chip, crashed) = (Simulated::powered_on(), period(pulses_hz));
            chip.prepare(crashed).unwrap();
            chip.write_channels(9, &crashed.registers(Some(1200.0))).unwrap();
            let begun = Instant::now();
            let mut servos = start(&mut chip);
            for _ in 0..5 {
                let [jaw_us, direct_us] = show(&mut servos, &mut chip, State::Neutral, 0.0);
                let most_us = 1205.0 + SPEED_US_PER_S * begun.elapsed().as_secs_f32();
                assert!((1195.0..=most_us).contains(&jaw_us), "{jaw_us} us after {:?}", begun.elapsed());
                assert_eq!(direct_us, 0.0, "a channel that is to be released");
            }
            // After a failure of the bus they go on from where they are, too.
            let [before_us] = chip.pulses_us([9]);
            thread::sleep(Duration::from_millis(50));
            servos.start(&mut chip).unwrap();
            let [jaw_us, direct_us] = show(&mut servos, &mut chip, State::Live, 1.0);
            assert!((jaw_us - before_us).abs() < 5.0, "{jaw_us}");
            assert!((direct_us - 2000.0).abs() < 3.0, "{direct_us}: a servo without limits is where the face wants it");
            assert_eq!(chip.pulses_us([0, 5, 8, 15]), [0.0; 4], "channels without settings");
        }
    }

    /// Prepares the chip twice: it must be ready the second time. Returns what had happened to it.
    fn found(chip: &mut Simulated, period: Period) -> &'static str {
        let [found, ready] = [(); 2].map(|()| chip.prepare(period).unwrap());
        assert_eq!(ready, None);
        found.unwrap()
    }

    #[test]
    fn a_chip_that_has_just_got_power_makes_the_pulses_of_its_channels_after_it_was_prepared() {
        // The data sheet gives the prescaler 30 for 200 Hz, and 121 for 50 Hz.
        for (pulses_hz, prescale) in [(200, 30), (50, 121)] {
            let (mut chip, period) = (Simulated::powered_on(), period(pulses_hz));
            assert!(found(&mut chip, period).contains("lost its power") && period.prescale == prescale);
            let channels: [u8; 16] = std::array::from_fn(|channel| channel as u8);
            assert_eq!(chip.pulses_us(channels), [0.0; 16]);
            let wanted_us = channels.map(|channel| if channel == 5 { 0.0 } else { 1000.0 + 50.0 * f32::from(channel) });
            let bytes: Vec<u8> = wanted_us.iter().flat_map(|wanted_us| period.registers(Some(*wanted_us))).collect();
            chip.write_channels(0, &bytes).unwrap();
            let pulses_us = chip.pulses_us(channels);
            assert!(pulses_us.iter().zip(wanted_us).all(|(pulse, want)| (pulse - want).abs() <= 2.5), "{pulses_us:?}");
        }
        assert_eq!([Period::new(50, 27_000_000), period(24)].map(|period| period.prescale), [131, 253]);
        // No pulse reaches the reserved bits or lasts a whole period.
        let registers = |pulse_us| period(50).registers(Some(pulse_us));
        assert_eq!([f32::NAN, f32::NEG_INFINITY, -5.0, 0.0].map(registers), [[0, 0, 0, FULL]; 4]);
        assert_eq!([f32::INFINITY, 1e9, 20_000.0].map(registers), [[0, 0, 0xFF, 0x0F]; 3]);
    }

    #[test]
    fn what_another_program_has_set_is_set_right_and_a_clock_that_cannot_be_is_told() {
        for (mode1, mode2, prescale) in [
            (AUTO_INCREMENT, 0x14, 121),
            (AUTO_INCREMENT, 0x00, 121),
            (AUTO_INCREMENT, 0x0D, 121),
            (0, OUTPUTS, 121),
            (AUTO_INCREMENT, OUTPUTS, 30),
            (AUTO_INCREMENT | EXTERNAL_CLOCK, OUTPUTS, 30),
        ] {
            let mut chip = Simulated::new(mode1, mode2, prescale);
            assert!(found(&mut chip, period(50)).contains("another program"), "{mode1:#x} {mode2:#x}");
            chip.write_channels(3, &period(50).registers(Some(1500.0))).unwrap();
            assert!((chip.pulses_us([3])[0] - 1500.0).abs() <= 2.5 && chip.0[1] == OUTPUTS, "{mode1:#x} {mode2:#x}");
            assert_eq!(chip.has_external_clock().unwrap(), mode1 & EXTERNAL_CLOCK != 0);
        }
    }

    #[test]
    fn a_pulse_is_read_wherever_it_begins_and_no_pulse_is_read_of_channels_that_are_off_or_mean_something_else() {
        // 1512 of 4096 steps at 200 Hz, which begin near the end of the period.
        let (late, full_on, empty) = ([0xA0, 0x0F, 0x88, 0x05], [0, FULL, 0x33, 0x01], [0x33, 0x01, 0x33, 0x01]);
        for (mode1, mode2, contents, want_us) in [
            (AUTO_INCREMENT, OUTPUTS, late, 1875.0),
            (AUTO_INCREMENT, OUTPUTS, [0, 0, 0, FULL], 0.0),
            (AUTO_INCREMENT, OUTPUTS, full_on, 0.0),
            (AUTO_INCREMENT, OUTPUTS, empty, 0.0),
            (AUTO_INCREMENT | SLEEP, OUTPUTS, late, 0.0),
            (AUTO_INCREMENT, 0x14, late, 0.0),
            (AUTO_INCREMENT, 0x00, late, 0.0),
        ] {
            let mut chip = Simulated::new(mode1, mode2, 30);
            chip.0[6..10].copy_from_slice(&contents);
            assert_eq!(chip.pulses_us([0])[0].round(), want_us, "{mode1:#x} {mode2:#x} {contents:?}");
        }
    }

    /// A chip that fails while it is written to.
    struct Failing(Simulated);

    impl Registers for Failing {
        type Error = ();

        fn get(&mut self, register: u8) -> Result<u8, ()> {
            self.0.get(register).map_err(|never| match never {})
        }

        fn put(&mut self, _: u8, _: &[u8]) -> Result<(), ()> {
            Err(())
        }
    }

    #[test]
    fn a_chip_that_fails_while_it_gets_pulses_has_not_released_them_and_all_pulses_can_be_taken() {
        let mut chip = Simulated::powered_on();
        let mut servos = start(&mut chip);
        servos.show(&Packet::NEUTRAL, &mut chip, Instant::now()).unwrap();
        assert!(chip.pulses_us([9])[0] > 1000.0);
        servos.release(&mut chip).unwrap();
        assert_eq!(chip.pulses_us([9, 4]), [0.0; 2]);
        servos.board.dials.note_released(true);
        assert!(servos.show(&Packet::NEUTRAL, &mut Failing(chip), Instant::now()).is_err());
        assert!(!servos.board.dials.has_released());
    }
}
