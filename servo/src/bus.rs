//! Bus servos: servos with a number, a position sensor and registers of their own, up to 30 on one serial line.
//!
//! Role: a [`Line`] makes the bytes for the line from each packet, and reads those that came back. The caller carries both.
//! Contract: a message has the goals of all servos with torque, and at most one question. No message waits for an answer, but
//! the next question does. A servo moves only after its model and its position were read. It begins where it stands, and
//! moves slowly until it is where the face wants it. Only goal, torque and Bus Watchdog are ever written.
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

pub use self::family::{FAMILIES, Family, Protocol};
use self::family::{Frame, Reader, Registers, TRIPPED, store, unknown};
pub use self::single::{Single, find};
use crate::{Board, Channel, ChannelSettings, Dials, Limits};

pub const MOST_SERVOS: usize = 30;
/// How long an answer may take. An FTDI adapter holds bytes back for 16 ms.
const ANSWER_TIMEOUT: Duration = Duration::from_millis(50);
/// How long after [`ANSWER_TIMEOUT`] a late answer may still come.
const LATE: Duration = Duration::from_secs(1);
/// A servo that does not answer this many questions in a row counts as missing.
const MOST_MISSED: u8 = 3;
/// After a silence of the line itself for this long, a Bus Watchdog may have stopped servos.
const SILENCE: Duration = Duration::from_millis(400);
/// The speed at which a servo goes to where the face wants it.
const START_DEGREES_PER_S: f32 = 60.0;
/// How long a servo that is to be released may take to reach its rest. Then it loses its torque wherever it is.
const REST_TIMEOUT: Duration = Duration::from_secs(1);
/// How far from a place a servo may be and still count as there, as a part of its range.
const CLOSE: f32 = 0.02;

const SILENT: &str = "it does not answer: check its power and cable, its number and baud rate, and that its status return \
    level is not 0";
const DAMAGED: &str = "its answers are damaged: check that no other servo has its number, the cable, and the baud rate";
const SHARED_ID: &str = "two servos have this number: unplug one, and give the other a number of its own";
const TRIPPED_BY_ITSELF: &str = "its Bus Watchdog has stopped it although the line was not silent: check its cable, and cut \
    its power for a moment";

/// What metrics show of a bus servo: name and help. A servo that does not answer has only the last one.
pub const HEALTH: [(&str, &str); 4] = [
    ("servo_volts", "Supply voltage of a bus servo."),
    ("servo_celsius", "Temperature of a bus servo."),
    ("servo_load_ratio", "Load of a bus servo from 0 to 1, if its family tells it."),
    ("servo_trouble", "1 if something is wrong with a bus servo, else 0."),
];

/// The unit of the ends in settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    Steps,
    Degrees,
}

impl Unit {
    /// How much a step of this family is in this unit.
    #[must_use]
    pub fn step(self, family: &Family) -> f32 {
        if self == Self::Degrees { family.degrees_per_step } else { 1.0 }
    }
}

/// A servo of the line. It is unknown until its first registers have been read and suit the settings. Then it is known. It
/// is on once its other registers have been read and it has been told to hold where it stands. It is unknown again when it
/// stops answering or its power is cut. A released servo is known.
#[derive(Default)]
struct Servo {
    id: u8,
    registers: Registers,
    /// Which of [`Family::reads`] comes next: the first one tells what the servo is.
    next: usize,
    /// It has torque and gets goals.
    is_on: bool,
    /// It was read without torque since it was last told to have none.
    is_limp: bool,
    /// The position of the last message, and whether the servo has been read since its channel came to rest there.
    position: f32,
    is_read: bool,
    /// Whether the next message turns torque on, with a goal where the servo stands, or off. `None` changes nothing.
    torque_order: Option<bool>,
    /// Since when it is to be released. `None` while it is to have torque.
    releasing_since: Option<Instant>,
    /// It is left without torque until its power is cut, an operator releases it, or it stops answering.
    is_halted: bool,
    /// How many questions in a row it has not answered, and when it last let one time out.
    missed: u8,
    missed_at: Option<Instant>,
    is_damaged: bool,
    /// Another servo has fallen silent since this one was read. This one may have lost its power, too, and gets no goals.
    is_doubtful: bool,
    trouble: Option<String>,
}

impl Servo {
    /// Releases the servo, and asks again what it is.
    fn lose(&mut self, trouble: &str) {
        (self.is_on, self.next, self.is_halted, self.torque_order) = (false, 0, false, Some(false));
        self.is_limp = false;
        self.trouble = Some(trouble.to_owned());
        self.registers.fill(0);
    }
}

pub struct Line {
    family: &'static Family,
    baud: u32,
    board: Board,
    /// In the order of the channels of the board.
    servos: Vec<Servo>,
    /// The servo that is asked next.
    turn: usize,
    /// The servo that owes an answer, and when it was asked; otherwise the one that answered last.
    asked: Option<(usize, Instant)>,
    answered: Option<usize>,
    reader: Reader,
    /// When the last message was sent, and its length.
    sent: Option<(Instant, usize)>,
}

impl Line {
    #[must_use]
    pub fn new(
        family: &'static Family,
        unit: Unit,
        baud: u32,
        channels: &[ChannelSettings],
        dials: &Arc<Dials>,
    ) -> Self {
        let mut board = Board::new(channels, dials);
        for channel in &mut board.channels {
            let ChannelSettings { position_at_0, position_at_1, .. } = channel.settings;
            channel.ends = [position_at_0, position_at_1].map(|end| end / unit.step(family));
        }
        let servo = |channel: &Channel| Servo { id: channel.number as u8, registers: unknown(), ..Servo::default() };
        let servos = board.channels.iter().map(servo).collect();
        let (turn, asked, answered, reader, sent) = (0, None, None, Reader::default(), None);
        Self { family, baud, board, servos, turn, asked, answered, reader, sent }
    }

    /// Takes what came from the line, and moves the servos with the face. Appends what the line is to carry, or nothing
    /// while it still carries the last message. Returns whether the message was made.
    pub fn step(&mut self, packet: &Packet, input: &[u8], now: Instant, out: &mut Vec<u8>) -> bool {
        for byte in input {
            match self.reader.push(self.family.protocol, *byte) {
                Some(Ok(frame)) => self.read(&frame, now),
                Some(Err(())) => self.miss(true),
                None => {}
            }
        }
        if let Some((index, at)) = self.asked
            && now.duration_since(at) >= ANSWER_TIMEOUT
        {
            self.servos.get_mut(index).into_iter().for_each(|servo| servo.missed_at = Some(now));
            self.miss(false);
        }
        let (silence, length) = self.sent.map_or((Duration::MAX, 0), |(at, length)| (now.duration_since(at), length));
        if silence < Duration::from_secs_f64(length as f64 * 10.0 / f64::from(self.baud.max(1))) {
            return false;
        }
        if silence >= SILENCE {
            // They begin again where they stand. Those that were to get torque would get it without a goal.
            self.asked = None;
            for servo in &mut self.servos {
                (servo.is_on, servo.next) = (false, servo.next.min(1));
                servo.torque_order.take_if(|gives| *gives);
            }
        }
        self.board.follow(packet, now);
        self.show_health();
        let begin = out.len();
        self.write_orders(now, out);
        self.ask(now, out);
        self.sent = Some((now, out.len() - begin));
        // A servo that does not answer may have torque.
        let is_limp = self.servos.iter().all(|servo| servo.is_limp && !servo.is_on && servo.torque_order.is_none());
        self.board.dials.note_released(self.board.is_off && is_limp);
        true
    }

    /// Whether all servos that are to have torque have it, and are where they are wanted. Those that do not answer, or are
    /// stopped, do not count.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        let mut servos = self.servos.iter().zip(&self.board.channels);
        servos.all(|(servo, channel)| {
            let is_ignored = servo.next == 0 || servo.is_halted || channel.place_now().is_none();
            if servo.is_on { servo.is_read && has_arrived(self.family, servo, channel) } else { is_ignored }
        })
    }

    /// What is wrong with servos, and what to do: a line for each.
    #[must_use]
    pub fn troubles(&self) -> String {
        let told = |(servo, channel): (&Servo, &Channel)| {
            servo.trouble.as_ref().map(|trouble| format!("servo {}: {trouble}", channel.settings.label()))
        };
        self.servos.iter().zip(&self.board.channels).filter_map(told).collect::<Vec<_>>().join("\n")
    }

    /// Appends what takes the torque from all servos.
    pub fn release(&self, out: &mut Vec<u8>) {
        let ids: Vec<u8> = self.servos.iter().map(|servo| servo.id).collect();
        self.family.write_torque(&ids, false, out);
    }

    /// Takes an answer, or the echo of a message.
    fn read(&mut self, frame: &Frame, now: Instant) {
        let Some((error, data)) = self.family.protocol.answer(frame) else { return };
        let Some(index) = self.asked.map(|(index, _)| index).or(self.answered) else { return };
        let Some(servo) = self.servos.get_mut(index).filter(|servo| servo.id == frame.id) else { return };
        if self.asked.is_none() {
            // Nobody waits for it: it is late, or of another servo.
            if servo.missed_at.is_none_or(|at| now.duration_since(at) > LATE) {
                servo.lose(SHARED_ID);
            }
        } else if let Some(field) = self.family.reads.get(servo.next).filter(|field| data.len() == usize::from(field.1))
        {
            store(*field, data, &mut servo.registers);
            (self.asked, self.answered) = (None, Some(index));
            self.judge(index, error);
        }
    }

    /// Judges a servo by its answer.
    fn judge(&mut self, index: usize, error: u8) {
        let Some((servo, channel)) = self.servos.get_mut(index).zip(self.board.channels.get_mut(index)) else { return };
        let family = self.family;
        (servo.missed, servo.is_damaged) = (0, false);
        let refusal = if servo.next == 0 { family.refusal(&servo.registers, channel.ends) } else { None };
        if let Some(refusal) = refusal {
            return servo.lose(&refusal);
        }
        servo.next += 1;
        let has_torque = family.get(&servo.registers, family.torque) > 0;
        let watchdog = family.get(&servo.registers, family.watchdog);
        // After a power cut the Bus Watchdog is not set any more. That ends a halt.
        let is_unset = family.watchdog.1 > 0 && watchdog == 0;
        // Torque and Bus Watchdog are in the answer to the second question.
        servo.is_doubtful &= servo.next == 1 || !has_torque || is_unset || watchdog == TRIPPED;
        if servo.next < family.reads.len() {
            return;
        }
        (servo.next, servo.is_read) = (1, true);
        servo.is_limp = !has_torque;
        let alarm = family.alarm(&servo.registers, error);
        // A doubtful servo whose Bus Watchdog has tripped was cut off together with the servo that fell silent.
        let was_cut_off = std::mem::take(&mut servo.is_doubtful) && watchdog == TRIPPED;
        let has_tripped = watchdog == TRIPPED && !was_cut_off;
        let is_stopped = servo.is_on && (!has_torque && alarm.is_some() || has_tripped);
        servo.is_halted = is_stopped || servo.is_halted && !is_unset;
        if !servo.is_halted || is_stopped {
            let trouble = alarm.map(str::to_owned).or_else(|| family.trouble(&servo.registers));
            servo.trouble = trouble.or_else(|| is_stopped.then(|| TRIPPED_BY_ITSELF.to_owned()));
        }
        let (begins_again, has_arrived) = (!has_torque || is_unset || was_cut_off, has_arrived(family, servo, channel));
        let wants_torque = channel.place_now().is_some() && !servo.is_halted;
        match (servo.is_on, wants_torque) {
            // The servo is still on its way to rest.
            (true, false) if !servo.is_halted && !has_arrived && !begins_again => {}
            (is_on, false) if is_on || has_torque => (servo.is_on, servo.torque_order) = (false, Some(false)),
            // The servo has lost its torque or its Bus Watchdog: ask again what it is.
            (true, true) if begins_again => (servo.is_on, servo.next) = (false, 0),
            // The servo has caught up with the face: lift the limit of its slow start.
            (true, true) if has_arrived && (channel.motion.position - channel.target).abs() <= CLOSE => {
                channel.limits = channel.settings.limits();
            }
            // Turn torque on where the servo stands, and approach the face slowly.
            (false, true) if alarm.is_none() => {
                (servo.is_on, servo.torque_order) = (true, Some(true));
                let slow = START_DEGREES_PER_S / family.degrees_per_step / channel.span();
                channel.limits.speed_per_s = channel.settings.limits().speed_per_s.min(slow);
                channel.rest_at(family.place(&servo.registers));
            }
            _ => {}
        }
    }

    /// Counts a question without an answer, or with a damaged one.
    fn miss(&mut self, is_damaged: bool) {
        let Some((index, _)) = self.asked.take() else { return };
        let Some(servo) = self.servos.get_mut(index) else { return };
        (servo.missed, servo.is_damaged) = (servo.missed.saturating_add(1), servo.is_damaged || is_damaged);
        if servo.missed >= MOST_MISSED {
            let was_on = servo.is_on;
            servo.lose(if servo.is_damaged { DAMAGED } else { SILENT });
            for servo in self.servos.iter_mut().filter(|_| was_on) {
                (servo.is_doubtful, servo.next) = (true, servo.next.min(1));
            }
        } else {
            // A servo that is away must get no goals when it comes back, so it is asked again at once.
            self.turn = index;
        }
    }

    /// Gives the metrics and the control socket what servos report of themselves.
    fn show_health(&self) {
        let servos = self.servos.iter().zip(&self.board.channels);
        for (dial, (servo, channel)) in self.board.dials.channels.iter().zip(servos) {
            let [volts, celsius, load] = self.family.health(&servo.registers);
            let health = [volts, celsius, load, f32::from(u8::from(servo.trouble.is_some()))];
            dial.health.iter().zip(health).for_each(|(shown, number)| shown.set(Some(number)));
            let place = Some(self.family.place(&servo.registers)).filter(|_| !volts.is_nan());
            dial.measured.set(place.map(|place| channel.position_at(place)));
        }
    }

    /// Appends the writes in order: torque off, Bus Watchdog, goals, torque on. A servo gets torque with a goal where it stands.
    fn write_orders(&mut self, now: Instant, out: &mut Vec<u8>) {
        let (family, mut stopped, mut started, mut goals) = (self.family, Vec::new(), Vec::new(), Vec::new());
        for (servo, channel) in self.servos.iter_mut().zip(&self.board.channels) {
            servo.is_halted &= !channel.is_off;
            servo.is_read &= [servo.position, channel.target].iter().all(|it| *it == channel.motion.position);
            servo.position = channel.motion.position;
            // A servo that keeps a limit of acceleration goes to its target by itself.
            let place = if family.units[1] > 0.0 { channel.target_place() } else { channel.place_now() };
            servo.releasing_since = if place.is_none() { servo.releasing_since.or(Some(now)) } else { None };
            let is_over = servo.releasing_since.is_some_and(|at| now.duration_since(at) >= REST_TIMEOUT);
            if servo.is_on && (channel.is_off || is_over) {
                (servo.is_on, servo.torque_order) = (false, Some(false));
            }
            let place = match servo.torque_order.take() {
                Some(true) => {
                    servo.is_limp = false;
                    started.push(servo.id);
                    family.place(&servo.registers)
                }
                told => {
                    servo.is_limp &= told.is_none();
                    stopped.extend(told.map(|_| servo.id));
                    place.unwrap_or_else(|| channel.place(channel.motion.position))
                }
            };
            if servo.is_on && !servo.is_doubtful {
                let Limits { speed_per_s, acceleration_per_s2 } = channel.limits;
                let [speed, acceleration] = [speed_per_s, acceleration_per_s2].map(|limit| limit * channel.span());
                goals.push((servo.id, family.goal([place, speed, acceleration], &servo.registers)));
            }
        }
        family.write_torque(&stopped, false, out);
        family.write_watchdog(&started, false, out);
        family.write_watchdog(&started, true, out);
        family.write_goals(&goals, out);
        family.write_torque(&started, true, out);
    }

    /// Asks the next servo, if no answer is awaited.
    fn ask(&mut self, now: Instant, out: &mut Vec<u8>) {
        let Some(servo) = self.servos.get(self.turn).filter(|_| self.asked.is_none()) else { return };
        let Some(field) = self.family.reads.get(servo.next) else { return };
        self.reader = Reader::default();
        self.family.protocol.write_read(servo.id, *field, out);
        (self.asked, self.answered) = (Some((self.turn, now)), None);
        self.turn = (self.turn + 1) % self.servos.len();
    }
}

impl Drop for Line {
    /// Clears what servos reported of themselves, because nobody reads them any more.
    fn drop(&mut self) {
        for dial in &self.board.dials.channels {
            dial.health.iter().chain([&dial.measured]).for_each(|shown| shown.set(None));
        }
    }
}

/// Whether the last position that was read is close to the present position of the channel.
fn has_arrived(family: &Family, servo: &Servo, channel: &Channel) -> bool {
    let way = family.place(&servo.registers) - channel.place(channel.motion.position);
    way.abs() <= CLOSE * channel.span()
}

#[cfg(test)]
mod tests;
