//! PCA9685: servos by I2C.
//!
//! Role: each output becomes one message, the registers of all channels from the first to the last that is in use. The
//! format keeps the limits of speed and acceleration itself, because the chip has none. While the bus fails, motion waits: it
//! goes on from the last position that was written.
//! Contract: the chip is initialised if it does not make the wanted pulses: after power-on, and after its power failed for a
//! moment. A chip that makes them already keeps its pulses, so that servos do not twitch when the service starts again.
//! Limits: a format knows only the positions that it gave itself. After a start, or a reload that changes its channels,
//! it begins at neutral. On a bus that is too slow for `rate_hz`, servos with limits move more slowly than their limits
//! allow. When the service stops, or a reload removes the link, a servo whose limits keep it from reaching neutral in
//! time stops on its way. The chip has no time-out. If the machine crashes, it repeats its last pulses until its power
//! is cut.

mod bus;
mod chip;

pub use bus::{Bus, Claim, I2cError, Place};
pub use chip::{CHANNELS, Period, register};

use std::mem;
use std::sync::Arc;

use super::clock::Clock;
use super::handover::Handover;
use super::{Background, Device, Format, LinkError, Output, Shared, Traffic};
use crate::config::{Pca9685Board, Pca9685Settings};
use crate::servo::{Channel, values};

/// Starts the thread that writes to the chip. The chip may get its power later.
///
/// # Errors
/// Returns an error if the system refuses a thread.
pub fn carrier(board: &Pca9685Board, traffic: Arc<Traffic>) -> Result<Background, LinkError> {
    let place = board.place();
    let period = Period::new(board.pulses_hz, board.oscillator_hz);
    let chip = Chip { place, period, handover: Handover::begin(), open: None };
    Background::start(place.to_string(), "fw-i2c", chip, true, traffic)
}

/// The chip as a device of a thread of its own: a bus that hangs blocks that thread alone.
#[derive(Debug)]
struct Chip {
    place: Place,
    period: Period,
    handover: Handover,
    open: Option<Bus>,
}

impl Device for Chip {
    fn open(&mut self, shared: &Shared) -> Result<bool, LinkError> {
        let claimed = self.handover.claim(shared, I2cError::is_held, || self.place.claim())?;
        let Some(claim) = claimed else { return Ok(false) };
        self.open = Some(Bus::open(claim, self.period)?);
        tracing::info!("link opened: {}", self.place);
        Ok(true)
    }

    fn write(&mut self, message: &[u8]) -> Result<bool, LinkError> {
        let Some(bus) = &mut self.open else { return Ok(false) };
        bus.write(message)?;
        Ok(true)
    }

    fn attend(&mut self) -> Result<(), LinkError> {
        let Some(bus) = &mut self.open else { return Ok(()) };
        if bus.attend()? {
            let place = self.place;
            tracing::warn!("link {place}: the chip lost its power for a moment and was set up again; check its supply");
        }
        Ok(())
    }

    fn close(&mut self) {
        self.open = None;
    }
}

/// Bytes of one channel.
const CHANNEL_BYTES: usize = 4;

/// The registers of one chip.
#[derive(Debug)]
pub struct Pca9685 {
    period: Period,
    channels: Vec<Channel>,
    clock: Clock,
    /// Whether the last message has not been written yet. Motion then pauses, so that it goes on from where the servo
    /// is.
    is_held: bool,
    /// The first register, and the contents of all from there on. Channels between those in use get no pulses.
    message: Vec<u8>,
    /// The lowest channel in use.
    first: u8,
}

impl Pca9685 {
    /// The format of a link with these settings.
    #[must_use]
    pub fn new(settings: &Pca9685Settings) -> Self {
        let channels: Vec<Channel> = settings.channels.iter().map(Channel::new).collect();
        let numbers = || channels.iter().map(|channel| channel.number);
        let (first, last) = (numbers().min().unwrap_or(0), numbers().max().unwrap_or(0));
        let period = Period::new(settings.board.pulses_hz, settings.board.oscillator_hz);
        let off = (first..=last).flat_map(|_| period.channel(None));
        let message = [register(first)].into_iter().chain(off).collect();
        Self { period, channels, clock: Clock::default(), is_held: false, message, first }
    }
}

impl Format for Pca9685 {
    fn encode(&mut self, output: &Output, _sequence: u32, send: &mut dyn FnMut(&[u8])) {
        let (values, step_s) = (values(&output.pose), self.clock.step_s());
        let step_s = if mem::take(&mut self.is_held) { 0.0 } else { step_s };
        for channel in &mut self.channels {
            let step = channel.step(output, &values, step_s);
            let pulse_us = (!step.is_released).then(|| channel.ends.pulse_us(step.position));
            let place = 1 + CHANNEL_BYTES * usize::from(channel.number.saturating_sub(self.first));
            if let Some(registers) = self.message.get_mut(place..place + CHANNEL_BYTES) {
                registers.copy_from_slice(&self.period.channel(pulse_us));
            }
        }
        send(&self.message);
    }

    fn pause_motion(&mut self) {
        self.is_held = true;
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use facewire_packet::{Reason, State};

    use super::chip::tests::Simulated;
    use super::*;
    use crate::config::{self, LinkKind};
    use crate::link::Pose;

    const JAW_OPEN: usize = 17;
    const SETTINGS: &str = "[[link]]\nkind = \"pca9685\"\n\
        [[link.channel]]\nchannel = 9\nsources = { jawOpen = 1.0 }\npulse_at_0_us = 1900\npulse_at_1_us = 1100\n\
        speed_per_s = 2.0\nacceleration_per_s2 = 1000.0\n\
        [[link.channel]]\nchannel = 4\nsources = { jawOpen = 1.0, headYaw = 0.01 }\nloss = \"release\"\n";

    /// A link's format, and the chip that it writes to.
    struct Linked {
        format: Pca9685,
        chip: Simulated,
    }

    impl Linked {
        fn new() -> Self {
            let settings = config::parse("test", SETTINGS).unwrap();
            let LinkKind::Pca9685(settings) = &settings.links[0].kind else { panic!("another kind") };
            let (format, mut chip) = (Pca9685::new(settings), Simulated::powered_on());
            chip::prepare(&mut chip, format.period).unwrap();
            Self { format, chip }
        }

        /// Shows a jaw and returns the pulses of channels 9 and 4.
        fn show(&mut self, state: State, jaw_open: f32) -> [Option<f32>; 2] {
            let mut pose = Pose::NEUTRAL;
            pose.coefficients[JAW_OPEN] = jaw_open;
            let reason = if state == State::Live { Reason::None } else { Reason::NoFace };
            let output = Output { state, reason, pose, age_us: 0, capture_us: 0, followed: true, moving: false };
            let chip = &mut self.chip;
            self.format.encode(&output, 0, &mut |message| {
                chip::write_channels(chip, message[0], &message[1..]).unwrap();
            });
            [9, 4].map(|channel| self.chip.pulse_us(channel, 25e6))
        }
    }

    #[test]
    fn the_pulse_goes_no_faster_than_the_limit_and_stays_between_both_ends_whatever_comes_in() {
        let (mut linked, begun) = (Linked::new(), Instant::now());
        let [first, _] = linked.show(State::Live, 0.0).map(Option::unwrap);
        assert!((first - 1900.0).abs() < 3.0, "{first}");
        for wild in [1.0, f32::NAN, f32::INFINITY, 1e30, f32::NEG_INFINITY, 0.5, 1.0].iter().cycle().take(2000) {
            let [jaw, direct] = linked.show(State::Live, *wild).map(Option::unwrap);
            // A range of 800 µs at 2.0 a second, and a step of the chip.
            let most_us = 1600.0 * begun.elapsed().as_secs_f32() + 5.0;
            assert!(first - jaw <= most_us, "{jaw} after {:?}", begun.elapsed());
            assert!((1097.0..=1903.0).contains(&jaw) && (997.0..=2003.0).contains(&direct), "{jaw} {direct}");
        }
    }

    #[test]
    fn a_servo_whose_bus_has_failed_for_seconds_goes_on_from_where_it_is() {
        let mut linked = Linked::new();
        let [before, _] = linked.show(State::Live, 0.0).map(Option::unwrap);
        let (mut last, failed) = (Instant::now(), Instant::now());
        // In this time the servo would go by 80 µs.
        while failed.elapsed() < Duration::from_millis(50) {
            last = Instant::now();
            linked.format.pause_motion();
            let [jaw, direct] = linked.show(State::Live, 1.0).map(Option::unwrap);
            assert!((jaw - before).abs() < 1e-3, "{jaw}");
            assert!((direct - 2000.0).abs() < 3.0, "a servo without limits is where the face wants it");
        }
        let [jaw, _] = linked.show(State::Live, 1.0).map(Option::unwrap);
        assert!(before - jaw <= 1600.0 * last.elapsed().as_secs_f32() + 5.0, "{jaw}");
    }

    #[test]
    fn channels_without_settings_get_no_pulses_and_a_lost_face_releases_only_those_that_ask_for_it() {
        let mut linked = Linked::new();
        assert!(linked.show(State::Live, 0.0).iter().all(Option::is_some));
        assert!(
            (0..16)
                .filter(|channel| ![9, 4].contains(channel))
                .all(|channel| linked.chip.pulse_us(channel, 25e6).is_none())
        );
        let [jaw, direct] = linked.show(State::Neutral, 0.0);
        assert!(jaw.is_some() && direct.is_none());
    }
}
