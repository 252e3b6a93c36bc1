//! Bus servos for tests. They take addresses and frames from the parent module, which other tests check against the makers'
//! examples and another implementation of protocol 2.0. In all else they follow the makers' manuals.
#![allow(clippy::missing_panics_doc, clippy::must_use_candidate, clippy::indexing_slicing, clippy::unwrap_used)]

use std::time::{Duration, Instant};

use super::Protocol;
use super::family::{FAMILIES, Family, Frame, READ, Reader, Registers, STATUS, SYNC_WRITE, unknown};

/// What new servos have in their registers, addresses and bytes: an XL330, an AX-12, an MX-28, an STS3215 and an SCS0009.
const CONTENTS: [&[(usize, &[u8])]; 5] = [
    &[(0, &[0xB0, 4]), (11, &[3]), (31, &[70, 70, 0, 35, 0]), (44, &[0xBD, 1, 0, 0, 0xFF, 0x0F]), (144, &[50, 0, 30])],
    &[(0, &[12]), (8, &[0xFF, 3, 0, 70, 60, 140]), (42, &[111, 35])],
    &[(0, &[29]), (8, &[0xFF, 0x0F, 0, 80, 60, 160]), (42, &[120, 35])],
    &[(3, &[9, 3]), (11, &[0xFF, 0x0F, 70, 80, 40]), (18, &[0b1100]), (62, &[74, 30])],
    &[(2, &[1, 5, 4]), (9, &[0, 20, 3, 0xEB, 70, 80, 45]), (62, &[60, 30])],
];

pub struct Servo {
    family: &'static Family,
    pub id: u8,
    pub registers: Registers,
    /// The alarms in the error byte of an answer, or in register 70.
    pub alarms: u8,
    /// How late it answers, if it does, and whether what it says is damaged on the line.
    pub answers_after: Option<Duration>,
    pub is_damaged: bool,
    /// Where it is, in steps, and how far its motor turns it in a second.
    pub place: f64,
    pub motor: f64,
    /// When it has power again and has started.
    away_until: Instant,
}

impl Servo {
    fn new(family: &'static Family, id: u8, now: Instant) -> Self {
        let (registers, alarms, answers_after, is_damaged) = (unknown(), 0, Some(Duration::ZERO), false);
        let (place, motor, away_until) = (500.0, 5000.0, now);
        let mut servo = Self { family, id, registers, alarms, answers_after, is_damaged, place, motor, away_until };
        servo.restart(now);
        servo
    }

    /// Cuts its power. At this time it has started again, with the registers of a new servo.
    pub fn restart(&mut self, at: Instant) {
        let index = FAMILIES.iter().position(|(name, _)| *name == self.family.name).unwrap();
        self.registers.fill(0);
        for (first, bytes) in CONTENTS[index] {
            self.registers[*first..first + bytes.len()].copy_from_slice(bytes);
        }
        self.family.set(&mut self.registers, self.family.id, self.id.into());
        (self.alarms, self.away_until) = (0, at);
    }

    pub fn has_torque(&self) -> bool {
        self.family.get(&self.registers, self.family.torque) > 0
    }

    /// The place and the speed of its goal, steps and steps a second.
    fn goal(&self) -> [f64; 2] {
        let [place, speed, _] = self.family.goal_parts.map(|field| f64::from(self.family.get(&self.registers, field)));
        [place, speed * f64::from(self.family.speed_unit(&self.registers))]
    }

    /// How fast it turns to its goal, steps a second. At a speed of 0, a Feetech servo without bit 3 of its phase stands still,
    /// and all others turn as fast as they can.
    fn turn(&self) -> f64 {
        let [_, speed] = self.goal();
        let stands_still = self.family.name.starts_with("feetech") && self.registers[18] & 0b1000 == 0;
        if speed > 0.0 || stands_still { speed.min(self.motor) } else { self.motor }
    }

    fn has_tripped(&self) -> bool {
        self.family.get(&self.registers, self.family.watchdog) == 0xFF
    }

    /// Moves on by a step, after a silence of the line.
    fn advance(&mut self, step_s: f64, silent_ms: u128) {
        let family = self.family;
        let watchdog = u128::from(family.get(&self.registers, family.watchdog));
        if self.has_torque() && (1..=127).contains(&watchdog) && silent_ms > watchdog * 20 {
            family.set(&mut self.registers, family.watchdog, 0xFF);
        }
        if self.has_torque() && !self.has_tripped() {
            let [goal, _] = self.goal();
            let most = self.turn() * step_s;
            self.place += (goal - self.place).clamp(-most, most);
        }
        family.set(&mut self.registers, family.place, self.place.round() as u32);
        family.set(&mut self.registers, family.alarms, self.alarms.into());
    }

    fn write(&mut self, first: usize, data: &[u8], now: Instant) -> Written {
        let (family, before, had_torque) = (self.family, self.registers.clone(), self.has_torque());
        let is_away = self.away_until > now;
        self.registers[first..first + data.len()].copy_from_slice(data);
        let (sets_goal, is_x) = (first == usize::from(family.goal.0), family.protocol == Protocol::Two);
        let ([least, most], [place, speed]) = (family.limits(&self.registers).map(f64::from), self.goal());
        if is_away || sets_goal && is_x && (self.has_tripped() || !(least..=most).contains(&place)) {
            self.registers = before;
        } else if is_x && !had_torque && self.has_torque() {
            // It begins where it stands.
            family.set(&mut self.registers, family.goal_parts[0], self.place.round() as u32);
        } else if sets_goal && !is_x {
            // A goal turns the torque on.
            family.set(&mut self.registers, family.torque, 1);
        }
        Written { id: self.id, first, data: data.to_vec(), stood: self.place, place, speed }
    }
}

/// What was written: in which servo, from which register on, and what; then where the servo stood, and its goal.
#[derive(Debug)]
pub struct Written {
    pub id: u8,
    pub first: usize,
    pub data: Vec<u8>,
    pub stood: f64,
    pub place: f64,
    pub speed: f64,
}

/// Servos on one line.
pub struct Simulator {
    family: &'static Family,
    pub servos: Vec<Servo>,
    /// The line has one wire, so that all comes back.
    pub echoes: bool,
    pub written: Vec<Written>,
    /// How many frames were damaged, had another instruction than READ or SYNC_WRITE, or wrote to servos that are not there.
    pub strange: usize,
    reader: Reader,
    answers: Vec<(Instant, Vec<u8>)>,
    moved_at: Instant,
    heard_at: Instant,
}

impl Simulator {
    /// Servos as the maker sells them.
    pub fn new(family: &'static Family, ids: &[u8], now: Instant) -> Self {
        let servos = ids.iter().map(|id| Servo::new(family, *id, now)).collect();
        let (written, answers, moved_at, heard_at) = (Vec::new(), Vec::new(), now, now);
        let (echoes, strange, reader) = (false, 0, Reader::default());
        Self { family, servos, echoes, written, strange, reader, answers, moved_at, heard_at }
    }

    pub fn plug_in(&mut self, id: u8, now: Instant) {
        self.servos.push(Servo::new(self.family, id, now));
    }

    /// Takes what comes by the line, and returns what goes back at this time.
    pub fn take(&mut self, bytes: &[u8], now: Instant) -> Vec<u8> {
        if self.echoes && !bytes.is_empty() {
            self.answers.push((now, bytes.to_vec()));
        }
        let step_s = now.saturating_duration_since(self.moved_at).as_secs_f64();
        let silent_ms = now.saturating_duration_since(self.heard_at).as_millis();
        self.servos.iter_mut().for_each(|servo| servo.advance(step_s, silent_ms));
        self.moved_at = now;
        for byte in bytes {
            match self.reader.push(self.family.protocol, *byte) {
                Some(Ok(frame)) => self.obey(&frame, now),
                frame => self.strange += usize::from(frame.is_some()),
            }
        }
        let (due, later): (Vec<_>, _) = self.answers.drain(..).partition(|(at, _)| *at <= now);
        self.answers = later;
        due.into_iter().flat_map(|(_, bytes)| bytes).collect()
    }

    fn obey(&mut self, frame: &Frame, now: Instant) {
        self.heard_at = now;
        // By protocol 2.0 addresses and lengths have two bytes.
        let width = if self.family.protocol == Protocol::Two { 2 } else { 1 };
        let (start, data) = frame.contents.split_at(frame.contents.len().min(1 + 2 * width));
        let words: Vec<usize> = start.iter().skip(1).step_by(width).map(|byte| usize::from(*byte)).collect();
        match (start[0], &*words) {
            (READ, [first, length]) => self.answer(frame.id, *first, *length, now),
            (SYNC_WRITE, [first, length]) => {
                for servo in data.chunks(1 + length) {
                    self.strange += usize::from(self.servos.iter().all(|it| it.id != servo[0]));
                    let told = self.servos.iter_mut().filter(|it| it.id == servo[0]);
                    self.written.extend(told.map(|it| it.write(*first, &servo[1..], now)));
                }
            }
            _ => self.strange += 1,
        }
    }

    fn answer(&mut self, id: u8, first: usize, length: usize, now: Instant) {
        for servo in self.servos.iter().filter(|it| it.id == id && it.away_until <= now) {
            let data = &servo.registers[first..first + length];
            let contents = match self.family.protocol {
                Protocol::One => [&[servo.alarms], data].concat(),
                Protocol::Two => [&[STATUS, u8::from(servo.alarms > 0) << 7], data].concat(),
            };
            let mut frame = Vec::new();
            self.family.protocol.write(id, contents, &mut frame);
            let middle = frame.len() / 2;
            frame[middle] ^= if servo.is_damaged { 0x10 } else { 0 };
            self.answers.extend(servo.answers_after.map(|late| (now + late, frame)));
        }
    }
}
