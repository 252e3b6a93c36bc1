//! Bus servos: servos with a number, a position sensor and registers of their own, up to 30 on one serial line.
//!
//! Role: a [`Line`] makes the bytes for the line from each packet, and reads those that came back. The caller carries both.
//! Contract: a message has the goals of all servos that move, and at most one question. The answer comes before the next
//! message, and nothing waits for it. A servo moves only after its model and its position were read. It begins there, and
//! moves slowly until it is where the face wants it. Only goal, torque and Bus Watchdog are ever written, see [`Order`].
//! Limits: servos do not acknowledge goals. A servo that missed one gets the next. One that lost its torque is found when
//! it is read the next time.
//!
//! There are no pings: an answer to a question tells more, and its length keeps it apart from an echo.

mod family;
#[cfg(any(test, feature = "simulator"))]
pub mod simulator;
mod single;

use std::sync::Arc;
use std::time::{Duration, Instant};

use facewire_packet::Packet;

pub use self::family::{Block, Family, Kind, Order, Protocol, Reader, Status};
use self::family::{Goal, Registers, TRIPPED};
pub use self::single::{Single, find};
use crate::{Board, Channel, ChannelSettings, Dials, Limits};

pub const MOST_SERVOS: usize = 30;
/// How long an answer may take. An FTDI adapter holds bytes back for 16 ms.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(50);
/// So many questions without an answer, one after the other, mean that a servo is not there.
const MOST_MISSED: u8 = 3;
/// After a silence of the line itself for this long, a Bus Watchdog may have stopped servos.
const SILENCE: Duration = Duration::from_millis(400);
/// The speed at which a servo goes to where the face wants it.
const START_DEGREES_PER_S: f32 = 60.0;
/// How long a servo that is to be released may take to reach its rest. Then it loses its torque wherever it is.
const REST_TIMEOUT: Duration = Duration::from_secs(1);
/// A servo this close to a place is there, as a part of its range.
const CLOSE: f32 = 0.02;

const SILENT: &str = "it does not answer: check its power and cable, its number and baud rate, and that its status return \
    level is not 0";
const DAMAGED: &str = "its answers are damaged: check that no other servo has its number, the cable, and the baud rate";
const TRIPPED_BY_ITSELF: &str = "its Bus Watchdog has stopped it although the line was not silent: check its cable, and cut \
    its power for a moment";

/// The unit of the ends in settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    Steps,
    Degrees,
}

impl Unit {
    /// The ends of a channel in steps.
    #[must_use]
    pub fn ends(self, family: &Family, channel: &ChannelSettings) -> [f32; 2] {
        let steps = if self == Self::Degrees { 1.0 / family.degrees_per_step } else { 1.0 };
        [channel.position_at_0, channel.position_at_1].map(|end| end * steps)
    }
}

/// A servo of the line. It is unknown until its first block has been read and suits the settings. Then it is known. It is
/// on once its other blocks have been read and it has been told to hold where it stands. It is unknown again when it stops
/// answering or its power is cut. A released servo is known.
struct Servo {
    id: u8,
    registers: Registers,
    /// Which block is read next: the first one tells what the servo is.
    next: usize,
    /// It has torque and gets goals.
    is_on: bool,
    /// It is on its way from where it stood to where it is wanted.
    is_slow: bool,
    /// Since when it is to be released. `None` while it is to have torque.
    releasing_since: Option<Instant>,
    /// Why it is left without torque until its power is cut or an operator releases it.
    halted: Option<String>,
    /// Questions without an answer, one after the other, and how many answers may still come late.
    missed: u8,
    overdue: u8,
    is_damaged: bool,
    trouble: Option<String>,
    /// Those of its channel, which is slower until the servo has started.
    limits: Limits,
}

impl Servo {
    fn new(channel: &Channel) -> Self {
        let (id, registers, limits) = (channel.number as u8, [0; 160], channel.limits);
        let (is_on, is_slow, is_damaged, releasing_since, halted, trouble) = (false, false, false, None, None, None);
        let (next, missed, overdue) = (0, 0, 0);
        Self {
            id,
            registers,
            next,
            is_on,
            is_slow,
            releasing_since,
            halted,
            missed,
            overdue,
            is_damaged,
            trouble,
            limits,
        }
    }

    /// Whether the servo was, when it was read last, where its channel should be by now.
    fn has_come(&self, family: &Family, channel: &Channel) -> bool {
        let way = family.position(&self.registers) - channel.place(channel.motion.position);
        way.abs() <= CLOSE * channel.span()
    }
}

/// A question, and which servo was asked when.
#[derive(Clone, Copy)]
struct Question(usize, Block, Instant);

pub struct Line {
    family: &'static Family,
    baud: u32,
    board: Board,
    /// In the order of the channels of the board.
    servos: Vec<Servo>,
    turn: usize,
    asked: Option<Question>,
    /// The servo that answered last, until another one is asked.
    answered: Option<usize>,
    reader: Reader,
    /// What was sent last, and how much of it has come back.
    sent: Vec<u8>,
    echoed: usize,
    sent_at: Option<Instant>,
    orders: Vec<(u8, Order)>,
}

impl Line {
    #[must_use]
    pub fn new(kind: Kind, unit: Unit, baud: u32, channels: &[ChannelSettings], dials: &Arc<Dials>) -> Self {
        let (family, mut board) = (kind.family(), Board::new(channels, dials));
        board.channels.iter_mut().for_each(|channel| channel.ends = unit.ends(family, &channel.settings));
        let servos = board.channels.iter().map(Servo::new).collect();
        let (reader, orders, sent) = (Reader::new(family.protocol), Vec::new(), Vec::new());
        let (turn, asked, answered, echoed, sent_at) = (0, None, None, 0, None);
        Self { family, baud, board, servos, turn, asked, answered, reader, sent, echoed, sent_at, orders }
    }

    /// Takes what came from the line, and moves the servos with the face. Appends what the line is to carry, or nothing
    /// while it still carries the last message. Returns whether the message was made.
    pub fn step(&mut self, packet: &Packet, input: &[u8], now: Instant, out: &mut Vec<u8>) -> bool {
        input.iter().for_each(|byte| self.take(*byte));
        if let Some(Question(index, _, at)) = self.asked
            && now.duration_since(at) >= ANSWER_TIMEOUT
        {
            self.servos.get_mut(index).into_iter().for_each(|servo| servo.overdue = servo.overdue.saturating_add(1));
            self.miss(index);
        }
        let silence = self.sent_at.map_or(Duration::MAX, |at| now.duration_since(at));
        let carried = Duration::from_secs_f64(self.sent.len() as f64 * 10.0 / f64::from(self.baud.max(1)));
        if silence < carried {
            return false;
        }
        if silence >= SILENCE {
            // They begin again where they stand.
            self.servos.iter_mut().for_each(|servo| (servo.is_on, servo.next) = (false, servo.next.min(1)));
        }
        self.board.follow(packet, now);
        let begin = out.len();
        self.write_orders(now, out);
        self.ask(now, out);
        self.sent.clear();
        self.sent.extend(out.get(begin..).unwrap_or_default());
        (self.sent_at, self.echoed) = (Some(now), 0);
        true
    }

    /// Whether all servos that move are where they are wanted.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        let mut servos = self.servos.iter().zip(&self.board.channels);
        servos.all(|(servo, channel)| {
            let has_arrived = channel.motion.position.to_bits() == channel.target.to_bits();
            !servo.is_on || has_arrived && servo.has_come(self.family, channel)
        })
    }

    /// What is wrong with servos, and what to do: a line for each.
    #[must_use]
    pub fn troubles(&self) -> String {
        let told = |servo: &Servo| servo.trouble.as_ref().map(|trouble| format!("servo {}: {trouble}", servo.id));
        self.servos.iter().filter_map(told).collect::<Vec<_>>().join("\n")
    }

    /// Appends what takes the torque from all servos.
    pub fn release(&self, out: &mut Vec<u8>) {
        release(self.family, self.servos.iter().map(|servo| servo.id), out);
    }

    /// Drops the echo of the last message, which comes first if the line has one wire. Other bytes are read.
    fn take(&mut self, byte: u8) {
        if self.sent.get(self.echoed) == Some(&byte) {
            self.echoed += 1;
            return;
        }
        let begun = std::mem::replace(&mut self.echoed, usize::MAX);
        // The message and an answer begin alike.
        for place in 0..if begun < self.sent.len() { begun } else { 0 } {
            self.sent.get(place).copied().into_iter().for_each(|byte| self.read(byte));
        }
        self.read(byte);
    }

    fn read(&mut self, byte: u8) {
        let Some(received) = self.reader.push(byte) else { return };
        let Ok(Status { id, error, data }) = received else {
            if let Some(Question(index, ..)) = self.asked {
                self.servos.get_mut(index).into_iter().for_each(|servo| servo.is_damaged = true);
                self.miss(index);
            }
            return;
        };
        let is_of = |index: usize| self.servos.get(index).is_some_and(|servo| servo.id == id);
        match self.asked {
            Some(Question(index, block, _)) if is_of(index) && data.len() == usize::from(block.1) => {
                if let Some(servo) = self.servos.get_mut(index) {
                    block.store(data, &mut servo.registers);
                }
                (self.asked, self.answered) = (None, Some(index));
                self.answer(index, error);
            }
            None => self.answered.filter(|index| is_of(*index)).into_iter().for_each(|index| self.answer_again(index)),
            _ => {}
        }
    }

    /// Judges a servo by its answer.
    fn answer(&mut self, index: usize, error: u8) {
        let Some((servo, channel)) = self.servos.get_mut(index).zip(self.board.channels.get_mut(index)) else { return };
        let (family, registers) = (self.family, &servo.registers);
        (servo.missed, servo.is_damaged) = (0, false);
        let refusal = if servo.next == 0 { family.refusal(registers, channel.ends) } else { None };
        if let Some(refusal) = refusal {
            return self.lose(index, &refusal);
        }
        servo.next += 1;
        if servo.next < family.blocks.len() {
            return;
        }
        servo.next = 1;
        let (alarms, steps) = (family.alarms(registers, error), family.position(registers));
        let has_torque = family.get(registers, (family.torque, 1)) > 0;
        let watchdog = family.watchdog.map(|address| family.get(registers, (address, 1)));
        let trouble = family.trouble(registers, alarms);
        if servo.is_on && (!has_torque && alarms > 0 || watchdog == Some(TRIPPED)) {
            servo.halted = Some(trouble.clone().unwrap_or_else(|| TRIPPED_BY_ITSELF.to_owned()));
        } else if watchdog == Some(0) {
            servo.halted = None;
        }
        let (lost_power, is_wanted) = (!has_torque || watchdog == Some(0), channel.place_now().is_some());
        servo.trouble = servo.halted.clone().or(trouble);
        let has_come = servo.has_come(family, channel);
        if !is_wanted || servo.halted.is_some() {
            let is_on_its_way = servo.is_on && servo.halted.is_none() && !has_come && !lost_power;
            if is_on_its_way {
                return;
            }
            if std::mem::take(&mut servo.is_on) || has_torque {
                self.orders.push((servo.id, Order::torque(false)));
            }
        } else if servo.is_on && lost_power {
            (servo.is_on, servo.next) = (false, 0);
        } else if servo.is_on {
            if servo.is_slow && has_come && (channel.motion.position - channel.target).abs() <= CLOSE {
                (servo.is_slow, channel.limits) = (false, servo.limits);
            }
        } else if alarms == 0 {
            (servo.is_on, servo.is_slow) = (true, true);
            let slow = START_DEGREES_PER_S / family.degrees_per_step / channel.span();
            channel.limits = Limits { speed_per_s: servo.limits.speed_per_s.min(slow), ..servo.limits };
            channel.rest_at(steps);
            let goal = family.goal(goal(channel, steps), registers);
            let orders = [Order::watchdog(false), Order::watchdog(true), goal, Order::torque(true)];
            self.orders.extend(orders.map(|order| (servo.id, order)));
        }
    }

    /// Takes an answer that nobody waits for: it is late, or of another servo.
    fn answer_again(&mut self, index: usize) {
        match self.servos.get_mut(index) {
            Some(servo) if servo.overdue > 0 => servo.overdue -= 1,
            _ => self.lose(index, "two servos have this number: unplug one, and give the other a number of its own"),
        }
    }

    fn miss(&mut self, index: usize) {
        self.asked = None;
        let Some(servo) = self.servos.get_mut(index) else { return };
        servo.missed = servo.missed.saturating_add(1);
        if servo.missed >= MOST_MISSED {
            let trouble = if servo.is_damaged { DAMAGED } else { SILENT };
            self.lose(index, trouble);
        } else {
            // A servo that is away must get no goals when it comes back, so it is asked again at once.
            self.turn = index;
        }
    }

    /// Releases a servo, and asks again what it is.
    fn lose(&mut self, index: usize, trouble: &str) {
        let Some(servo) = self.servos.get_mut(index) else { return };
        (servo.is_on, servo.next, servo.halted) = (false, 0, None);
        servo.trouble = Some(trouble.to_owned());
        self.orders.push((servo.id, Order::torque(false)));
    }

    fn write_orders(&mut self, now: Instant, out: &mut Vec<u8>) {
        let (family, mut goals) = (self.family, Vec::with_capacity(self.servos.len()));
        for (servo, channel) in self.servos.iter_mut().zip(&self.board.channels) {
            if channel.is_off {
                servo.halted = None;
            }
            // A servo that keeps a limit of acceleration goes to its target by itself.
            let place = if family.steps_per_s2 > 0.0 { channel.target_place() } else { channel.place_now() };
            servo.releasing_since = if place.is_none() { servo.releasing_since.or(Some(now)) } else { None };
            let is_over = servo.releasing_since.is_some_and(|at| now.duration_since(at) >= REST_TIMEOUT);
            if servo.is_on && (channel.is_off || is_over) {
                servo.is_on = false;
                self.orders.push((servo.id, Order::torque(false)));
            } else if servo.is_on {
                let steps = place.unwrap_or_else(|| channel.place(channel.motion.position));
                goals.push((servo.id, family.goal(goal(channel, steps), &servo.registers)));
            }
        }
        family.write(&self.orders, out);
        family.write(&goals, out);
        self.orders.clear();
    }

    /// Asks the next servo, if no answer is awaited.
    fn ask(&mut self, now: Instant, out: &mut Vec<u8>) {
        let Some(servo) = self.servos.get(self.turn).filter(|_| self.asked.is_none()) else { return };
        let Some(block) = self.family.blocks.get(servo.next) else { return };
        self.reader.clear();
        self.family.protocol.write_read(servo.id, *block, out);
        (self.asked, self.answered) = (Some(Question(self.turn, *block, now)), None);
        self.turn = (self.turn + 1) % self.servos.len();
    }
}

fn goal(channel: &Channel, steps: f32) -> Goal {
    let [steps_per_s, steps_per_s2] =
        [channel.limits.speed_per_s, channel.limits.acceleration_per_s2].map(|limit| limit * channel.span());
    Goal { steps, steps_per_s, steps_per_s2 }
}

/// Appends what takes the torque from servos.
pub fn release(family: &Family, ids: impl IntoIterator<Item = u8>, out: &mut Vec<u8>) {
    let orders: Vec<_> = ids.into_iter().map(|id| (id, Order::torque(false))).collect();
    family.write(&orders, out);
}

#[cfg(test)]
mod tests;
