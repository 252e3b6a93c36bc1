//! Settings of servo boards: the channels, which all boards share, and the link to each kind of board.

use toml::de::DeValue;

use super::{
    section::{Section, section, write_setting},
    value::{Choice, SerialDevice, Value},
};
use crate::link::maestro::COMMAND_BYTES;
use crate::link::pca9685::Place;
use crate::servo::{AtLoss, Ends, Gains, Limits, Mapping, SOURCE_COUNT, SOURCE_NAMES};

/// Bounds of a gain, which the sum of a channel has for each source.
const GAINS: std::ops::RangeInclusive<f32> = -10.0..=10.0;
/// Highest baud rate of a Maestro.
pub(super) const MOST_MAESTRO_BAUD: u32 = 200_000;
/// The key of the channels of a link.
const CHANNEL: &str = "channel";
/// The key of the sources of a channel.
const SOURCES: &str = "sources";

section! {
    /// The numbers of a channel.
    ServoSettings {
        /// The number of the channel, as it is printed on the board.
        channel: u32 = 0, 0..=23, "";
        /// The position if all sources are 0. The position is this plus the sum of all sources, each multiplied by its
        /// number, and stays within 0 to 1.
        offset: f32 = 0.0, -10.0..=10.0, "";
        /// Pulse at position 0. `facewire servo` finds the pulses at both ends.
        pulse_at_0_us: u32 = 1000, 64..=4080, " (microseconds)";
        /// Pulse at position 1. It may be the shorter one.
        pulse_at_1_us: u32 = 2000, 64..=4080, " (microseconds)";
        /// The position without a face. -1 stands for that of the neutral face, which is `offset`.
        neutral: f32 = -1.0, -1.0..=1.0, "";
        /// Highest speed of the position: at 2.0 the servo goes from 0 to 1 in half a second. 0 means no limit.
        speed_per_s: f32 = 0.0, 0.0..=100.0, " (1/s)";
        /// Highest change of the speed. 0 means no limit.
        acceleration_per_s2: f32 = 0.0, 0.0..=1000.0, " (1/s²)";
        /// Changes of the position up to this size are ignored, so that a servo does not hum while the face is at rest.
        dead_zone: f32 = 0.0, 0.0..=0.2, "";
        /// What happens once the face is lost and the channel is at its neutral position:
        /// - "neutral": it stays there
        /// - "release": the servo gets no more pulses, so that it is silent and can be turned by hand
        loss: AtLoss = AtLoss::Neutral, (), "";
    }
}

impl Choice for AtLoss {
    const ALL: &'static [(&'static str, Self)] = &[("neutral", Self::Neutral), ("release", Self::Release)];
}

/// One `[[link.channel]]`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ChannelSettings {
    /// Its numbers.
    pub servo: ServoSettings,
    /// What it follows.
    pub sources: Sources,
}

/// `sources`: how much each source moves a channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Sources(pub Gains);

impl Default for Sources {
    fn default() -> Self {
        Self([0.0; SOURCE_COUNT])
    }
}

impl Sources {
    /// The assignment of each source that moves the channel.
    fn lines(&self) -> Vec<String> {
        self.used().map(|(name, gain)| format!("{name} = {gain:?}")).collect()
    }

    /// The sources that move the channel.
    pub(super) fn used(&self) -> impl Iterator<Item = (&'static str, f32)> {
        SOURCE_NAMES.into_iter().zip(self.0).filter(|(_, gain)| *gain != 0.0)
    }

    /// The gain of the source of this name, if there is one.
    fn gain(&mut self, source: &str) -> Option<&mut f32> {
        SOURCE_NAMES.iter().zip(&mut self.0).find(|(name, _)| **name == source).map(|(_, gain)| gain)
    }
}

impl Section for Sources {
    fn keys(&self) -> &'static [&'static str] {
        &SOURCE_NAMES
    }

    fn set(&mut self, key: &str, value: &DeValue<'_>) -> Result<(), String> {
        if let Some(gain) = self.gain(key) {
            *gain = f32::read(value, &GAINS).ok_or_else(|| f32::expected(&GAINS))?;
        }
        Ok(())
    }

    fn write(&self) -> String {
        self.lines().join("\n")
    }
}

impl ChannelSettings {
    /// A jaw.
    pub(super) fn example() -> Self {
        let mut jaw = Self::default();
        if let Some(gain) = jaw.sources.gain("jawOpen") {
            *gain = 1.0;
        }
        jaw
    }

    /// The position without a face.
    #[must_use]
    pub fn neutral(&self) -> f32 {
        let ServoSettings { neutral, offset, .. } = self.servo;
        if neutral < 0.0 { offset.clamp(0.0, 1.0) } else { neutral }
    }

    /// The pulses at both ends.
    #[must_use]
    #[expect(clippy::cast_precision_loss, reason = "some thousands")]
    pub fn ends(&self) -> Ends {
        Ends { at_0_us: self.servo.pulse_at_0_us as f32, at_1_us: self.servo.pulse_at_1_us as f32 }
    }

    /// The limits of the motion.
    #[must_use]
    pub fn limits(&self) -> Limits {
        let limit = |value| if value > 0.0 { value } else { f32::INFINITY };
        Limits {
            speed_per_s: limit(self.servo.speed_per_s),
            acceleration_per_s2: limit(self.servo.acceleration_per_s2),
        }
    }

    /// How the position follows the face.
    #[must_use]
    pub fn mapping(&self) -> Mapping {
        let ServoSettings { offset, dead_zone, .. } = self.servo;
        Mapping { gains: self.sources.0, offset, dead_zone, neutral: self.neutral() }
    }

    /// Returns the least and the greatest position that the sum can have before it is limited, for coefficients from 0 to
    /// 1 and angles of the head up to 90 degrees.
    pub(super) fn range(&self) -> [f32; 2] {
        let at = |end: fn(f32, f32) -> f32| {
            let term = |(name, gain): (&str, f32)| {
                if name.starts_with("head") { end(-90.0 * gain, 90.0 * gain) } else { end(0.0, gain) }
            };
            self.servo.offset + self.sources.used().map(term).sum::<f32>()
        };
        [at(f32::min), at(f32::max)]
    }
}

impl Section for ChannelSettings {
    fn keys(&self) -> &'static [&'static str] {
        self.servo.keys()
    }

    fn set(&mut self, key: &str, value: &DeValue<'_>) -> Result<(), String> {
        self.servo.set(key, value)
    }

    fn write(&self) -> String {
        let mut text = String::new();
        let lines = [" What the channel follows: coefficients by their names, and the angles of the head in degrees."];
        let expected = "a number from -10.0 to 10.0 for each source";
        write_setting(&mut text, &lines, expected, &format!("sources = {{ {} }}", self.sources.lines().join(", ")));
        text + "\n" + &self.servo.write()
    }

    fn tables(&self) -> &'static [&'static str] {
        &[SOURCES]
    }

    fn table(&mut self, key: &str) -> Option<&mut dyn Section> {
        (key == SOURCES).then_some(&mut self.sources)
    }
}

/// The settings of a link to a servo board: those of the board, and its channels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WithChannels<B> {
    /// The settings of the board.
    pub board: B,
    /// `[[link.channel]]`
    pub channels: Vec<ChannelSettings>,
}

impl<B: Section> Section for WithChannels<B> {
    fn keys(&self) -> &'static [&'static str] {
        self.board.keys()
    }

    fn set(&mut self, key: &str, value: &DeValue<'_>) -> Result<(), String> {
        self.board.set(key, value)
    }

    fn write(&self) -> String {
        self.board.write()
    }

    fn tables(&self) -> &'static [&'static str] {
        &[CHANNEL]
    }

    fn table(&mut self, key: &str) -> Option<&mut dyn Section> {
        if key != CHANNEL {
            return None;
        }
        self.channels.push(ChannelSettings::default());
        self.channels.last_mut().map(|channel| channel as &mut dyn Section)
    }

    fn write_tables(&self, path: &str) -> String {
        let table = |channel: &ChannelSettings| ["\n[[", path, ".", CHANNEL, "]]\n", &channel.write()].concat();
        self.channels.iter().map(table).collect()
    }
}

impl MaestroSettings {
    /// Length of a message, bytes: a command for each channel, in the longer of both protocols and with a CRC.
    pub(super) fn message_bytes(&self) -> usize {
        COMMAND_BYTES * self.channels.len().max(1)
    }
}

/// A link to a Maestro.
pub type MaestroSettings = WithChannels<MaestroBoard>;
/// A link to a PCA9685.
pub type Pca9685Settings = WithChannels<Pca9685Board>;

section! {
    /// The settings of a Maestro.
    MaestroBoard {
        /// The serial port of the Maestro:
        /// - "auto": the command port of the Maestro that is plugged into USB
        /// - a path: `facewire devices` lists the ports. The command port is the first of a Maestro's two ports, the one
        ///   whose stable path ends with -if00
        device: SerialDevice = SerialDevice::Auto, (), "";
        /// Baud rate of a Maestro whose serial pins are connected. It has no effect by USB.
        baud: u32 = 115_200, 9_600..=MOST_MAESTRO_BAUD, " (1/s)";
        /// How commands begin:
        /// - "compact": with the command. The Maestro is alone on its line
        /// - "pololu": with the byte 170 and the number of the device. Several devices can share a line, and a Maestro that
        ///   detects its baud rate does so by these bytes
        protocol: MaestroProtocol = MaestroProtocol::Compact, (), "";
        /// The device number of the Maestro, for the Pololu protocol.
        device_number: u32 = 12, 0..=127, "";
        /// Whether each command ends with a checksum. It must be the same as "Enable CRC" in the Maestro's own settings.
        crc: bool = false, (), "";
        /// Whether one command sets the targets of neighbouring channels. Maestros with 12, 18 or 24 channels have this
        /// command, the Micro Maestro with 6 channels does not.
        multiple_targets: bool = false, (), "";
        /// Whether the Maestro is asked for its errors once a second. Set this to false if its TX is not connected.
        read_errors: bool = true, (), "";
    }
}

section! {
    /// The settings of a PCA9685.
    Pca9685Board {
        /// The number of the I2C bus: 1 for /dev/i2c-1.
        bus: u32 = 1, 0..=255, "";
        /// The address of the chip. Each soldered address jumper adds its value to 0x40.
        address: u32 = 0x40, 0x40..=0x7f, "";
        /// Pulses per second, for all channels. Analogue servos want 50; many digital ones take up to 330.
        pulses_hz: u32 = 50, 40..=400, " (1/s)";
        /// Frequency of the chip's oscillator. It differs by a few percent from chip to chip, and pulses are wrong by
        /// as much.
        oscillator_hz: u32 = 25_000_000, 20_000_000..=30_000_000, " (Hz)";
    }
}

impl Pca9685Board {
    /// Where the chip is.
    #[must_use]
    pub fn place(&self) -> Place {
        Place { bus: self.bus, address: self.address }
    }
}

/// How commands to a Maestro begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MaestroProtocol {
    /// With the command byte.
    Compact,
    /// With 0xAA and the device number.
    Pololu,
}

impl Choice for MaestroProtocol {
    const ALL: &'static [(&'static str, Self)] = &[("compact", Self::Compact), ("pololu", Self::Pololu)];
}
