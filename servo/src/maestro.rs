//! Pololu's Maestro: servos by serial commands, by its user's guide (<https://www.pololu.com/docs/0J40>, section 5).
//!
//! Contract: each output becomes one message that sets the targets of all channels. The Maestro itself keeps the limits of
//! speed and acceleration. A Maestro that restarts after a drop of its supply voltage has forgotten them, and does not say so:
//! a [`Reminder`] therefore puts them before the targets of each message, as far as the line carries them.
//! Limits: a Maestro does not limit the speed of the first pulse after none, because it does not know where the servo is.
//! Nobody knows of a restart in the middle of a message, whose targets then count without limits until the next message.
//! Its units of speed hold for its default period of 20 ms.

use std::io::{self, Read, Write};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::{Duration, Instant};

use facewire_packet::Packet;

use crate::{Board, Channel, ChannelSettings, Dials, Limits, Operator};

/// Longest command for one channel: 0xAA, device, command, channel, two bytes, CRC.
pub const COMMAND_BYTES: usize = 7;
pub const ANSWER_BYTES: usize = 2;
/// Begins a command of the Pololu protocol. A Maestro that detects its baud rate does so by this byte.
const POLOLU: u8 = 0xAA;
/// x^7 + x^3 + 1, the least significant bit first.
const CRC_POLYNOMIAL: u8 = 0b1001_0001;
const MOST_SPEED: f32 = 16_383.0;
const MOST_ACCELERATION: f32 = 255.0;
/// A speed of 1 in units of the Maestro: 0.25 µs per 10 ms.
pub const SPEED_UNIT_US_PER_S: f32 = 25.0;
/// An acceleration of 1 in units of the Maestro: 0.25 µs per 10 ms per 80 ms.
pub const ACCELERATION_UNIT_US_PER_S2: f32 = 312.5;

/// Share of a serial line that limits and targets together may use. The question takes some of the rest.
const LINE_SHARE: f64 = 0.9;
const BITS_PER_BYTE: f64 = 10.0;

/// The trouble if bytes come back that are no answer.
pub const NONSENSE: &str = "what comes back is no answer of a Maestro: check that the port is the Maestro's, and check the wires and the \
    baud rate";
/// The trouble if no answer comes.
pub const SILENCE: &str = "the Maestro does not answer: set its serial mode to \"USB Dual Port\" in the Maestro Control Center, \
    give its command port, whose stable path ends with -if00, and check that link.crc equals \"Enable CRC\"; set \
    link.read_errors = false if no wire leads back from it";

/// What each bit of the error register means, and what to do.
const ERRORS: [&str; 9] = [
    "a byte on its serial line had no stop bit: check the baud rate, the wires and the common ground",
    "its serial line was too fast for it: give a lower baud rate",
    "its buffer for serial bytes was full: give a lower rate_hz",
    "a command had a wrong checksum: give link.crc the same value as \"Enable CRC\" in its serial settings",
    "it received a command that it does not know: check that nothing else writes to it, that link.crc equals \"Enable CRC\" \
     in its serial settings, and that link.multiple_targets is false if it is a Micro Maestro",
    "its serial timeout ran out: raise it in its serial settings, or link.rate_hz",
    "the stack of its script overflowed: correct or remove the script",
    "the call stack of its script overflowed: correct or remove the script",
    "its script ran beyond its end: correct or remove the script",
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Code {
    SetTarget = 0x84,
    SetSpeed = 0x87,
    SetAcceleration = 0x89,
    /// Sets the pulses of neighbouring channels. The Micro Maestro does not know it.
    SetMultipleTargets = 0x9F,
    /// Returns the errors since the last time, two bytes, and clears them.
    GetErrors = 0xA1,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Protocol {
    /// The number of the device, for the Pololu protocol; `None` for the compact one.
    pub device_number: Option<u8>,
    pub crc: bool,
}

impl Protocol {
    /// Appends a command with these data, whose bytes are below 0x80.
    pub fn write(self, out: &mut Vec<u8>, code: Code, data: impl IntoIterator<Item = u8>) {
        let begin = out.len();
        match self.device_number {
            Some(number) => out.extend([POLOLU, number, code as u8 & 0x7F]),
            None => out.push(code as u8),
        }
        out.extend(data);
        if self.crc {
            out.push(crc(out.get(begin..).unwrap_or_default()));
        }
    }

    /// The command for a value of a channel.
    #[must_use]
    pub fn command(self, code: Code, channel: u8, value: u16) -> Vec<u8> {
        let ([low, high], mut command) = (data(value), Vec::new());
        self.write(&mut command, code, [channel, low, high]);
        command
    }

    /// Appends the limits of a channel. A Maestro that restarts forgets them.
    pub fn write_limits(self, channel: &Channel, out: &mut Vec<u8>) {
        let (span_us, limits) = (channel.span(), channel.limits);
        let speed = speed(limits.speed_per_s * span_us);
        let acceleration = acceleration(limits.acceleration_per_s2 * span_us);
        for (code, limit) in [(Code::SetSpeed, speed), (Code::SetAcceleration, acceleration)] {
            let [low, high] = data(limit);
            self.write(out, code, [channel.number as u8, low, high]);
        }
    }

    /// The message that ends the pulses of these channels.
    #[must_use]
    pub fn release(self, channels: &[ChannelSettings], multiple_targets: bool) -> Vec<u8> {
        let operator = Arc::<Operator>::default();
        operator.is_released.store(true, Relaxed);
        let dials = Arc::new(Dials::new(channels, &operator));
        let mut message = Vec::new();
        self.write_targets(
            Board::new(channels, &dials).follow(&Packet::NEUTRAL, Instant::now()),
            multiple_targets,
            &mut message,
        );
        message
    }

    /// Appends the targets of channels in the order of their numbers. One command sets neighbours if `multiple_targets`,
    /// otherwise each channel has its own.
    pub fn write_targets(self, channels: &[Channel], multiple_targets: bool, out: &mut Vec<u8>) {
        let is_next = |a: &Channel, b: &Channel| multiple_targets && a.number.checked_add(1) == Some(b.number);
        for block in channels.chunk_by(is_next) {
            let (first, count) = (block.first().map_or(0, |channel| channel.number as u8), block.len());
            let targets = block.iter().flat_map(|channel| data(target(channel.target_place())));
            if count == 1 {
                self.write(out, Code::SetTarget, [first].into_iter().chain(targets));
            } else {
                self.write(out, Code::SetMultipleTargets, [count as u8, first].into_iter().chain(targets));
            }
        }
    }
}

/// The limits that are sent before targets: those of as many channels as the line carries, in turn. A Maestro that restarts
/// has no limits, which suits channels without any.
///
/// At 115,200 baud and 50 messages a second, the line carries 207 bytes for each message, within [`LINE_SHARE`]. A channel has
/// 4 bytes for its target and 8 for its limits, so that up to 17 channels get their limits with every message, and 24 with
/// every second. By the Pololu protocol with a CRC, these are 7 and 14 bytes: up to 9 channels get them with every message,
/// and 24 within 9 messages.
pub struct Reminder {
    /// The commands for each channel that has limits.
    limits: Vec<Vec<u8>>,
    /// Whose limits come next.
    next: usize,
    bytes_per_s: f64,
    /// How many bytes the line has had left for limits since the last ones, at most those of all limits.
    room_bytes: f64,
    is_doubtful: bool,
}

impl Reminder {
    /// Begins with doubt.
    #[must_use]
    pub fn new(commands: Protocol, channels: &[ChannelSettings], baud: u32) -> Self {
        let limits_of = |channel: Channel| {
            let mut limits = Vec::new();
            commands.write_limits(&channel, &mut limits);
            limits
        };
        let limited = channels.iter().map(Channel::new).filter(|channel| channel.limits != Limits::NONE);
        let bytes_per_s = LINE_SHARE * f64::from(baud) / BITS_PER_BYTE;
        Self { limits: limited.map(limits_of).collect(), next: 0, bytes_per_s, room_bytes: 0.0, is_doubtful: true }
    }

    /// Puts all limits before the next message, whatever the line carries, because the Maestro may have none of them.
    pub fn doubt(&mut self) {
        self.is_doubtful = true;
    }

    /// Appends the limits that are to be sent before a message of this length, so long after the last one.
    pub fn write(&mut self, message_bytes: usize, since_last: Duration, out: &mut Vec<u8>) {
        let all_bytes = self.limits.iter().map(Vec::len).sum::<usize>() as f64;
        let carried_bytes = self.bytes_per_s * since_last.as_secs_f64();
        let room_bytes = self.room_bytes + carried_bytes - message_bytes as f64;
        self.room_bytes = room_bytes.clamp(-all_bytes, all_bytes);
        if std::mem::take(&mut self.is_doubtful) {
            self.room_bytes = all_bytes;
        }
        for _ in 0..self.limits.len() {
            let next = self.limits.get(self.next).filter(|limits| limits.len() as f64 <= self.room_bytes);
            let Some(limits) = next else { return };
            out.extend(limits);
            self.room_bytes -= limits.len() as f64;
            self.next = (self.next + 1) % self.limits.len();
        }
    }
}

/// Checks by the question for errors that a Maestro answers. Its errors are older than the question, and ignored. A Maestro
/// that detects its baud rate needs a command of the Pololu protocol first.
///
/// # Errors
/// If it does not answer in the time of the port.
pub fn check_answer(port: &mut (impl Read + Write), pololu: Protocol, commands: Protocol) -> io::Result<()> {
    let mut question = Vec::new();
    [pololu, commands].iter().for_each(|protocol| protocol.write(&mut question, Code::GetErrors, []));
    port.write_all(&question).and_then(|()| port.read_exact(&mut [0; ANSWER_BYTES]))
}

/// What a Maestro gets when its port was opened, `pololu` being its commands in the Pololu protocol. The question clears old
/// errors, and from its first byte a Maestro detects the baud rate if it is set to do so, whatever the protocol of the link
/// is. The answer is discarded.
#[must_use]
pub fn preamble(pololu: Protocol, commands: Protocol, channels: &[ChannelSettings]) -> Vec<u8> {
    let mut out = Vec::new();
    pololu.write(&mut out, Code::GetErrors, []);
    channels.iter().map(Channel::new).for_each(|channel| commands.write_limits(&channel, &mut out));
    out
}

/// What a Maestro is told and asked again and again. One whose errors are not read does not answer.
#[must_use]
pub fn question(commands: Protocol, channels: &[ChannelSettings], reads_errors: bool) -> Vec<u8> {
    let mut out = Vec::new();
    channels.iter().map(Channel::new).for_each(|channel| commands.write_limits(&channel, &mut out));
    if reads_errors {
        commands.write(&mut out, Code::GetErrors, []);
    }
    out
}

fn crc(command: &[u8]) -> u8 {
    command.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc, _| if crc & 1 == 1 { (crc ^ CRC_POLYNOMIAL) >> 1 } else { crc >> 1 })
    })
}

/// Returns a number of 14 bits as two data bytes, the low one first.
pub fn data(number: u16) -> [u8; 2] {
    [(number & 0x7F) as u8, (number >> 7 & 0x7F) as u8]
}

/// Returns the target for a pulse, in quarters of a microsecond. `None` ends the pulses.
pub fn target(pulse_us: Option<f32>) -> u16 {
    pulse_us.map_or(0, |pulse_us| (4.0 * pulse_us).round().clamp(1.0, 16_383.0) as u16)
}

/// Returns the greatest limit of the Maestro that is not above this speed; 0 means no limit.
pub fn speed(us_per_s: f32) -> u16 {
    units(us_per_s / SPEED_UNIT_US_PER_S, MOST_SPEED)
}

fn acceleration(us_per_s2: f32) -> u16 {
    units(us_per_s2 / ACCELERATION_UNIT_US_PER_S2, MOST_ACCELERATION)
}

fn units(limit: f32, most: f32) -> u16 {
    if limit.is_infinite() { 0 } else { limit.floor().clamp(1.0, most) as u16 }
}

/// The errors that an answer reports, or [`NONSENSE`] if no Maestro gives such an answer.
pub fn errors(answer: [u8; ANSWER_BYTES]) -> Result<impl Iterator<Item = &'static str>, &'static str> {
    let register = u16::from_le_bytes(answer);
    if register >> ERRORS.len() != 0 {
        return Err(NONSENSE);
    }
    Ok(ERRORS.into_iter().enumerate().filter(move |(bit, _)| register >> bit & 1 == 1).map(|(_, error)| error))
}

/// Whether the Maestro has obeyed all commands by this answer: none was lost on its line or in its buffer, or refused.
#[must_use]
pub const fn has_obeyed(answer: [u8; ANSWER_BYTES]) -> bool {
    const LOST_COMMANDS: u16 = 0b1_1111;
    u16::from_le_bytes(answer) & LOST_COMMANDS == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn command(protocol: Protocol, code: Code, data: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        protocol.write(&mut out, code, data.iter().copied());
        out
    }

    #[test]
    fn commands_and_their_crc_are_those_of_the_users_guide() {
        let compact = Protocol { device_number: None, crc: false };
        let pololu_12 = Protocol { device_number: Some(12), crc: false };
        let [low, high] = data(target(Some(1500.0)));
        assert_eq!(command(compact, Code::SetTarget, &[0, low, high]), [0x84, 0x00, 0x70, 0x2E]);
        assert_eq!(command(pololu_12, Code::SetTarget, &[0, low, high]), [0xAA, 0x0C, 0x04, 0x00, 0x70, 0x2E]);
        assert_eq!(data(speed(3500.0)), [0x0C, 0x01], "3.5 µs/ms are 140 units");
        assert_eq!(crc(&[0x83, 0x01]), 0x17);
        let with_crc = Protocol { crc: true, ..compact };
        assert_eq!(command(with_crc, Code::GetErrors, &[]), [0xA1, crc(&[0xA1])]);
    }

    /// Channels with limits, and one without.
    fn channels(count: u32) -> Vec<ChannelSettings> {
        let limited = |channel| ChannelSettings { channel, speed_per_s: 1.0, ..ChannelSettings::default() };
        let without = ChannelSettings { channel: count, ..ChannelSettings::default() };
        (0..count).map(limited).chain([without]).collect()
    }

    /// The channels whose limits these bytes hold.
    fn limited(protocol: Protocol, channels: &[ChannelSettings], mut bytes: &[u8]) -> Vec<usize> {
        let limits_of = |channel: &ChannelSettings| {
            let mut limits = Vec::new();
            protocol.write_limits(&Channel::new(channel), &mut limits);
            limits
        };
        let limits: Vec<_> = channels.iter().map(limits_of).collect();
        let mut limited = Vec::new();
        while !bytes.is_empty() {
            limited.push(limits.iter().position(|limits| bytes.starts_with(limits)).unwrap());
            bytes = &bytes[limits[limited[limited.len() - 1]].len()..];
        }
        limited
    }

    #[test]
    fn a_maestro_that_restarts_unnoticed_has_its_limits_again_before_the_next_targets_or_as_soon_as_the_line_carries_them()
     {
        let compact = Protocol { device_number: None, crc: false };
        let longest = Protocol { device_number: Some(12), crc: true };
        for (protocol, count, baud, period_ms, most_messages) in [
            (compact, 6, 115_200, 20, 1),
            (compact, 17, 115_200, 20, 1),
            (compact, 24, 115_200, 20, 2),
            (longest, 9, 115_200, 20, 1),
            (longest, 24, 115_200, 20, 9),
            (compact, 24, 115_200, 100, 1),
            (longest, 24, 200_000, 20, 2),
            (compact, 2, 9600, 20, 2),
            // By USB, the line has no rate.
            (longest, 24, u32::MAX, 4, 1),
        ] {
            let channels = channels(count);
            let message_bytes = count as usize * command(protocol, Code::SetTarget, &[0; 3]).len();
            let mut reminder = Reminder::new(protocol, &channels, baud);
            let mut next = || {
                let mut out = Vec::new();
                reminder.write(message_bytes, Duration::from_millis(period_ms), &mut out);
                (limited(protocol, &channels, &out), out.len() + message_bytes)
            };
            let first = next().0;
            assert_eq!(first, (0..count as usize).collect::<Vec<_>>(), "all, before the first targets of an open port");
            let (mut written_bytes, mut without) = (0, vec![0; count as usize]);
            for _ in 0..1000 {
                let (limited, bytes) = next();
                without.iter_mut().for_each(|messages| *messages += 1);
                limited.into_iter().for_each(|channel| without[channel] = 0);
                let longest = without.iter().max().unwrap();
                assert!(*longest < most_messages, "{count} channels at {baud} baud: {longest} messages without limits");
                written_bytes += bytes;
            }
            let carried_bytes = f64::from(baud) / 10.0 * period_ms as f64;
            assert!(written_bytes as f64 <= 0.91 * carried_bytes, "{count} channels at {baud} baud: {written_bytes}");
        }
    }

    #[test]
    fn all_limits_come_before_the_first_targets_after_a_doubt_or_a_pause_even_if_a_steady_line_has_no_room() {
        let protocol = Protocol { device_number: Some(12), crc: true };
        let channels = channels(24);
        let mut reminder = Reminder::new(protocol, &channels, 19_200);
        let next = |reminder: &mut Reminder, since_ms| {
            let mut out = Vec::new();
            reminder.write(168, Duration::from_millis(since_ms), &mut out);
            limited(protocol, &channels, &out).len()
        };
        assert_eq!([20; 5].map(|since_ms| next(&mut reminder, since_ms)), [24, 0, 0, 0, 0]);
        reminder.doubt();
        assert_eq!([20; 2].map(|since_ms| next(&mut reminder, since_ms)), [24, 0]);
        assert_eq!([1000, 20].map(|since_ms| next(&mut reminder, since_ms)), [24, 0]);
        let mut out = Vec::new();
        Reminder::new(protocol, &[ChannelSettings::default()], 9600).write(7, Duration::from_secs(1), &mut out);
        assert!(out.is_empty(), "a channel without limits needs none");
    }

    #[test]
    fn limits_are_rounded_down_but_never_to_0_and_targets_neither_switch_a_servo_off_nor_set_a_high_bit() {
        assert_eq!([124.9, 125.0, 1.0, 1e9, f32::INFINITY].map(speed), [4, 5, 1, 16_383, 0]);
        assert_eq!([1250.0, 1249.0, 1.0, 1e9, f32::INFINITY].map(acceleration), [4, 3, 1, 255, 0]);
        let targets = [f32::NEG_INFINITY, -1.0, 0.0, 4080.0, 1e30].map(|pulse_us| target(Some(pulse_us)));
        assert_eq!((targets, data(16_383)), ([1, 1, 1, 16_320, 16_383], [0x7F; 2]));
    }
}
