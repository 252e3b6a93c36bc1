//! A simulated Maestro at the end of a pseudo-terminal, after its user's guide (<https://www.pololu.com/docs/0J40>).

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};

use super::answers::AnsweringDevice;

/// Bits of the error register.
pub const CRC_ERROR: u16 = 1 << 3;
pub const PROTOCOL_ERROR: u16 = 1 << 4;

#[derive(Debug, Clone, Copy)]
pub struct Model {
    pub channels: usize,
    pub crc: bool,
    pub device_number: u8,
    /// Whether bytes on its port are commands: "USB Dual Port", and not the mode it has when it is new.
    pub takes_commands: bool,
    /// Whether it learns its baud rate from the first 0xAA, and ignores everything before.
    pub detects_baud: bool,
}

impl Model {
    pub const MINI_24: Self =
        Self { channels: 24, crc: false, device_number: 12, takes_commands: true, detects_baud: false };
    pub const MICRO_6: Self = Self { channels: 6, ..Self::MINI_24 };
}

#[derive(Debug, Default)]
pub struct State {
    /// Targets in quarters of a microsecond; 0 means no pulses.
    pub targets: [u16; 24],
    pub speeds: [u16; 24],
    pub accelerations: [u16; 24],
    pub errors: u16,
    pub ever: u16,
    pub commands: Vec<u8>,
    answers: Vec<u8>,
    knows_baud: bool,
    command: Vec<u8>,
}

impl State {
    pub fn take(&mut self, byte: u8, model: &Model) {
        self.knows_baud |= byte == 0xAA;
        if !model.takes_commands || (model.detects_baud && !self.knows_baud) {
            return;
        }
        if byte >= 0x80 {
            let unfinished = std::mem::take(&mut self.command);
            // What another device on the line is told may have any length.
            if !unfinished.is_empty() && !is_for_another(&unfinished, model) {
                self.fail(PROTOCOL_ERROR);
            }
        } else if self.command.is_empty() {
            return self.fail(PROTOCOL_ERROR);
        }
        self.command.push(byte);
        self.finish(model);
    }

    fn finish(&mut self, model: &Model) {
        let (code, data) = match self.command.as_slice() {
            [0xAA, _, code, data @ ..] if !is_for_another(&self.command, model) => (code | 0x80, data),
            [] | [0xAA, ..] => return,
            [code, data @ ..] => (*code, data),
        };
        let needed = match (code, data) {
            (0x84 | 0x87 | 0x89, _) => 3,
            (0xA1, _) => 0,
            (0x9F, []) if model.channels > 6 => 1,
            (0x9F, [count, ..]) if model.channels > 6 => 2 + 2 * usize::from(*count),
            _ => {
                self.command.clear();
                return self.fail(PROTOCOL_ERROR);
            }
        };
        if data.len() < needed + usize::from(model.crc) || (code == 0x9F && data.len() < 2) {
            return;
        }
        let command = std::mem::take(&mut self.command);
        let (told, crc) = command.split_at(command.len() - usize::from(model.crc));
        if model.crc && crc != [remainder(told)] {
            return self.fail(CRC_ERROR);
        }
        self.commands.push(code);
        match (code, &told[told.len() - needed..]) {
            (0xA1, _) => self.answers.extend(std::mem::take(&mut self.errors).to_le_bytes()),
            (0x9F, [_, first, targets @ ..]) => {
                for (channel, target) in (usize::from(*first)..).zip(targets.chunks(2)) {
                    self.targets[channel] = number(target);
                }
            }
            (code, [channel, value @ ..]) if usize::from(*channel) < model.channels => {
                let values = match code {
                    0x84 => &mut self.targets,
                    0x87 => &mut self.speeds,
                    _ => &mut self.accelerations,
                };
                values[usize::from(*channel)] = number(value);
            }
            _ => self.fail(PROTOCOL_ERROR),
        }
    }

    pub fn fail(&mut self, error: u16) {
        self.errors |= error;
        self.ever |= error;
    }

    /// Where a servo at `from` is after a move of this time, quarters of a microsecond: a speed of 1 is one quarter in
    /// 10 ms.
    pub fn reached(&self, channel: usize, from: u16, ms: u16) -> u16 {
        let (target, most) = (self.targets[channel], self.speeds[channel] * (ms / 10));
        if self.speeds[channel] == 0 { target } else { target.clamp(from.saturating_sub(most), from + most) }
    }
}

fn is_for_another(command: &[u8], model: &Model) -> bool {
    matches!(command, [0xAA, number, ..] if *number != model.device_number)
}

/// A number of 14 bits, the low 7 first.
fn number(bytes: &[u8]) -> u16 {
    u16::from(bytes[0]) | u16::from(bytes[1]) << 7
}

/// The CRC of a command by long division, as the guide shows it: the bits of the message, the least significant of each byte
/// first, and seven zeros, divided by 10001001.
pub fn remainder(message: &[u8]) -> u8 {
    let mut bits: Vec<bool> = message.iter().flat_map(|byte| (0..8).map(move |bit| byte >> bit & 1 == 1)).collect();
    bits.extend([false; 7]);
    let divisor = [true, false, false, false, true, false, false, true];
    for place in 0..bits.len() - 7 {
        if bits[place] {
            bits[place..place + 8].iter_mut().zip(divisor).for_each(|(bit, divisor)| *bit ^= divisor);
        }
    }
    let remainder = &bits[bits.len() - 7..];
    (0..7).map(|bit| u8::from(remainder[bit]) << bit).sum()
}

/// A Maestro that runs on a thread of its own until it is unplugged.
pub struct Maestro {
    pub device: PathBuf,
    state: Arc<Mutex<State>>,
    _thread: AnsweringDevice,
}

impl Maestro {
    pub fn plugged_in(model: Model) -> Self {
        let state = Arc::<Mutex<State>>::default();
        let shared = Arc::clone(&state);
        let thread = AnsweringDevice::plugged_in(move |bytes| {
            let mut state = shared.lock().unwrap();
            bytes.iter().for_each(|byte| state.take(*byte, &model));
            std::mem::take(&mut state.answers)
        });
        Self { device: thread.path.clone(), state, _thread: thread }
    }

    pub fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap()
    }

    /// The pulse of a channel, microseconds; `None` if there is none.
    pub fn pulse_us(&self, channel: usize) -> Option<f32> {
        let target = self.state().targets[channel];
        (target > 0).then(|| f32::from(target) / 4.0)
    }
}
