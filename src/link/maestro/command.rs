//! Commands of Pololu's Maestro, by its user's guide (<https://www.pololu.com/docs/0J40>, section 5).

use crate::config::{MaestroBoard, MaestroProtocol};

/// Begins a command of the Pololu protocol. A Maestro that detects its baud rate does so by this byte.
const POLOLU: u8 = 0xAA;
/// x^7 + x^3 + 1, the least significant bit first.
const CRC_POLYNOMIAL: u8 = 0b1001_0001;
/// Highest limit of a speed: 14 bits.
const MOST_SPEED: f32 = 16_383.0;
/// Highest limit of an acceleration.
const MOST_ACCELERATION: f32 = 255.0;
/// A speed of 1 in units of the Maestro: 0.25 µs per 10 ms.
pub const SPEED_UNIT_US_PER_S: f32 = 25.0;
/// An acceleration of 1 in units of the Maestro: 0.25 µs per 10 ms per 80 ms.
pub const ACCELERATION_UNIT_US_PER_S2: f32 = 312.5;

/// A command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Code {
    /// Sets the pulse of one channel.
    SetTarget = 0x84,
    /// Sets the speed limit of one channel.
    SetSpeed = 0x87,
    /// Sets the acceleration limit of one channel.
    SetAcceleration = 0x89,
    /// Sets the pulses of neighbouring channels. The Micro Maestro does not know it.
    SetMultipleTargets = 0x9F,
    /// Returns the errors since the last time, two bytes, and clears them.
    GetErrors = 0xA1,
}

/// How commands are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Protocol {
    /// The number of the device, for the Pololu protocol; `None` for the compact one.
    pub device_number: Option<u8>,
    /// Whether each command ends with its CRC.
    pub crc: bool,
}

impl Protocol {
    /// The protocol of a link with these settings.
    #[must_use]
    pub fn new(board: &MaestroBoard) -> Self {
        let pololu = Self::pololu(board);
        Self { device_number: pololu.device_number.filter(|_| board.protocol == MaestroProtocol::Pololu), ..pololu }
    }

    /// The Pololu protocol to this device, whatever the protocol of its link is.
    #[must_use]
    pub fn pololu(board: &MaestroBoard) -> Self {
        Self { device_number: u8::try_from(board.device_number).ok(), crc: board.crc }
    }

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
}

/// Returns a number of 14 bits as two data bytes, the low one first.
#[must_use]
pub fn data(number: u16) -> [u8; 2] {
    [(number & 0x7F) as u8, (number >> 7 & 0x7F) as u8]
}

/// Returns the target for a pulse, in quarters of a microsecond. `None` ends the pulses.
#[must_use]
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "limited to 14 bits")]
pub fn target(pulse_us: Option<f32>) -> u16 {
    pulse_us.map_or(0, |pulse_us| (4.0 * pulse_us).round().clamp(1.0, 16_383.0) as u16)
}

/// Returns the greatest limit of the Maestro that is not above this speed; 0 means no limit.
#[must_use]
pub fn speed(us_per_s: f32) -> u16 {
    units(us_per_s / SPEED_UNIT_US_PER_S, MOST_SPEED)
}

/// Returns the greatest limit of the Maestro that is not above this acceleration; 0 means no limit.
#[must_use]
pub fn acceleration(us_per_s2: f32) -> u16 {
    units(us_per_s2 / ACCELERATION_UNIT_US_PER_S2, MOST_ACCELERATION)
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "limited to 14 bits")]
fn units(limit: f32, most: f32) -> u16 {
    if limit.is_infinite() { 0 } else { limit.floor().clamp(1.0, most) as u16 }
}

/// Returns the CRC of a command.
fn crc(command: &[u8]) -> u8 {
    command.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc, _| if crc & 1 == 1 { (crc ^ CRC_POLYNOMIAL) >> 1 } else { crc >> 1 })
    })
}

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

/// Returns a sentence for each error in the answer to [`Code::GetErrors`].
#[must_use]
pub fn errors(answer: &[u8]) -> Vec<&'static str> {
    let register = answer.iter().rev().fold(0_u16, |register, byte| register << 8 | u16::from(*byte));
    ERRORS.into_iter().enumerate().filter(|(bit, _)| register >> bit & 1 == 1).map(|(_, error)| error).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const COMPACT: Protocol = Protocol { device_number: None, crc: false };
    const POLOLU_12: Protocol = Protocol { device_number: Some(12), crc: false };

    fn command(protocol: Protocol, code: Code, data: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        protocol.write(&mut out, code, data.iter().copied());
        out
    }

    fn set_target(protocol: Protocol, channel: u8, pulse_us: f32) -> Vec<u8> {
        let [low, high] = data(target(Some(pulse_us)));
        command(protocol, Code::SetTarget, &[channel, low, high])
    }

    #[test]
    fn commands_are_those_of_the_users_guide() {
        assert_eq!(set_target(COMPACT, 0, 1500.0), [0x84, 0x00, 0x70, 0x2E]);
        assert_eq!(set_target(POLOLU_12, 0, 1500.0), [0xAA, 0x0C, 0x04, 0x00, 0x70, 0x2E]);
        assert_eq!(command(COMPACT, Code::SetSpeed, &[5, 0x0C, 0x01]), [0x87, 0x05, 0x0C, 0x01]);
        assert_eq!(data(speed(3500.0)), [0x0C, 0x01], "3.5 µs/ms are 140 units");
        let [[off_low, off_high], [low, high]] = [target(None), target(Some(1500.0))].map(data);
        let several = command(COMPACT, Code::SetMultipleTargets, &[2, 3, off_low, off_high, low, high]);
        assert_eq!(several, [0x9F, 0x02, 0x03, 0x00, 0x00, 0x70, 0x2E]);
    }

    #[test]
    fn the_crc_is_that_of_the_users_guide() {
        assert_eq!(crc(&[0x83, 0x01]), 0x17);
        let with_crc = Protocol { crc: true, ..COMPACT };
        assert_eq!(command(with_crc, Code::GetErrors, &[]), [0xA1, crc(&[0xA1])]);
    }

    #[test]
    fn limits_are_rounded_down_but_never_to_0_which_would_mean_no_limit() {
        assert_eq!([124.9, 125.0, 1.0, 1e9, f32::INFINITY].map(speed), [4, 5, 1, 16_383, 0]);
        assert_eq!([1250.0, 1249.0, 1.0, 1e9, f32::INFINITY].map(acceleration), [4, 3, 1, 255, 0]);
    }

    #[test]
    fn no_pulse_becomes_a_target_that_switches_the_servo_off_or_sets_a_high_bit() {
        for pulse_us in [f32::NAN, f32::NEG_INFINITY, -1.0, 0.0, 0.1, 4080.0, 1e30] {
            let target = target(Some(pulse_us));
            assert!(pulse_us.is_nan() || (1..=16_383).contains(&target), "{pulse_us} {target}");
            assert!(data(target).iter().all(|byte| *byte < 0x80));
        }
    }

    #[test]
    fn each_error_bit_has_a_sentence() {
        assert!(errors(&[0, 0]).is_empty());
        assert_eq!(errors(&[0xFF, 0x01]).len(), 9);
        assert!(errors(&[0x08, 0x00])[0].contains("link.crc"));
        assert!(errors(&[0x00, 0x01])[0].contains("beyond its end"));
    }
}
