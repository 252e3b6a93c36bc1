//! Pololu's Maestro: servos by serial commands.
//!
//! Role: each output becomes one message that sets the targets of all channels. The Maestro itself keeps the limits of speed
//! and acceleration.
//! Contract: the limits are sent whenever the port is opened, and again once a second together with the question for its
//! errors, because a Maestro that restarts after a drop of its supply voltage has forgotten them.
//! Limits: a Maestro does not limit the speed of the first pulse after none, because it does not know where the servo is.
//! Its units of speed hold for its default period of 20 ms.

mod command;

pub use command::{ACCELERATION_UNIT_US_PER_S2, Code, Protocol, SPEED_UNIT_US_PER_S, data, errors, speed, target};

use std::ops::Range;

use super::clock::Clock;
use super::{Format, Inquiry, Output};
use crate::config::MaestroSettings;
use crate::servo::{Channel, values};

/// Longest command for one channel: 0xAA, device, command, channel, two bytes, CRC.
pub const COMMAND_BYTES: usize = 7;
/// Length of the answer to [`Code::GetErrors`].
pub const ANSWER_BYTES: usize = 2;

/// The message about a Maestro that does not answer.
pub const SILENCE: &str = "the Maestro does not answer: set its serial mode to \"USB Dual Port\" in the Maestro Control Center, \
    give its command port, whose stable path ends with -if00, and check that link.crc equals \"Enable CRC\"; set \
    link.read_errors = false if no wire leads back from it";

/// The commands to one Maestro.
#[derive(Debug)]
pub struct Maestro {
    protocol: Protocol,
    /// The Pololu protocol, whatever that of the link is.
    pololu: Protocol,
    read_errors: bool,
    /// In the order of their numbers.
    channels: Vec<Channel>,
    /// The target of each channel.
    targets: Vec<u16>,
    /// The channels that each command sets: neighbours if it may set several, otherwise one.
    blocks: Vec<Range<usize>>,
    clock: Clock,
    message: Vec<u8>,
}

impl Maestro {
    /// The format of a link with these settings.
    #[must_use]
    pub fn new(settings: &MaestroSettings) -> Self {
        let board = &settings.board;
        let mut channels: Vec<Channel> = settings.channels.iter().map(Channel::new).collect();
        channels.sort_by_key(|channel| channel.number);
        Self {
            protocol: Protocol::new(board),
            pololu: Protocol::pololu(board),
            read_errors: board.read_errors,
            targets: vec![0; channels.len()],
            blocks: blocks(&channels, board.multiple_targets),
            clock: Clock::default(),
            message: Vec::with_capacity(channels.len() * COMMAND_BYTES),
            channels,
        }
    }

    /// Sets the limits of all channels.
    fn limits(&self, out: &mut Vec<u8>) {
        for channel in &self.channels {
            let (span_us, limits) = (channel.ends.span_us(), channel.limits);
            let speed = command::speed(limits.speed_per_s * span_us);
            let acceleration = command::acceleration(limits.acceleration_per_s2 * span_us);
            for (code, limit) in [(Code::SetSpeed, speed), (Code::SetAcceleration, acceleration)] {
                let [low, high] = data(limit);
                self.protocol.write(out, code, [channel.number, low, high]);
            }
        }
    }

    /// Writes the targets to the message.
    fn write(&mut self) {
        self.message.clear();
        for block in &self.blocks {
            let (Some(channels), Some(targets)) = (self.channels.get(block.clone()), self.targets.get(block.clone()))
            else {
                continue;
            };
            let Some(first) = channels.first() else { continue };
            let targets = targets.iter().flat_map(|target| data(*target));
            if let [_] = channels {
                self.protocol.write(&mut self.message, Code::SetTarget, [first.number].into_iter().chain(targets));
            } else {
                let head = [number(channels.len()), first.number];
                self.protocol.write(&mut self.message, Code::SetMultipleTargets, head.into_iter().chain(targets));
            }
        }
    }
}

/// Divides channels, which are in the order of their numbers, into those that one command sets.
fn blocks(channels: &[Channel], multiple_targets: bool) -> Vec<Range<usize>> {
    let is_next = |a: &Channel, b: &Channel| multiple_targets && a.number.checked_add(1) == Some(b.number);
    let mut end = 0;
    let block = |channels: &[Channel]| {
        let begin = end;
        end += channels.len();
        begin..end
    };
    channels.chunk_by(is_next).map(block).collect()
}

/// A number that the bounds of its setting keep below 128.
fn number(number: impl TryInto<u8>) -> u8 {
    number.try_into().unwrap_or_default() & 0x7F
}

impl Format for Maestro {
    fn encode(&mut self, output: &Output, _sequence: u32, send: &mut dyn FnMut(&[u8])) {
        let (values, step_s) = (values(&output.pose), self.clock.step_s());
        for (channel, target) in self.channels.iter_mut().zip(&mut self.targets) {
            let step = channel.step(output, &values, step_s);
            *target = command::target((!step.is_released).then(|| channel.ends.pulse_us(step.target)));
        }
        self.write();
        send(&self.message);
    }

    /// Begins with the question for errors in the Pololu protocol, whatever the protocol of the link is. The question
    /// clears old errors, and from its first byte a Maestro detects the baud rate if it is set to do so. The answer is
    /// discarded.
    fn preamble(&self) -> Vec<u8> {
        let mut out = Vec::new();
        self.pololu.write(&mut out, Code::GetErrors, []);
        self.limits(&mut out);
        out
    }

    fn inquiry(&self) -> Option<Inquiry> {
        let mut question = Vec::new();
        self.limits(&mut question);
        if self.read_errors {
            self.protocol.write(&mut question, Code::GetErrors, []);
        }
        let answer_bytes = if self.read_errors { ANSWER_BYTES } else { 0 };
        Some(Inquiry { question, answer_bytes, troubles: errors, silence: SILENCE })
    }
}
