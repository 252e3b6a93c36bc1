//! Bus servos for tests, which hold to the makers' manuals and know nothing of the parent module's tables.
#![allow(clippy::missing_panics_doc, clippy::must_use_candidate, clippy::indexing_slicing, clippy::unwrap_used)]

use std::time::{Duration, Instant};

/// How a servo answers, or what happens to its answers on the line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Answers {
    Well,
    Never,
    Damaged,
    Late(Duration),
}

/// Where a family has what moves a servo: addresses and widths.
#[derive(Debug, Clone, Copy)]
struct Manual {
    is_two: bool,
    is_big: bool,
    torque: usize,
    goal: (usize, usize),
    speed: (usize, usize),
    position: (usize, usize),
    limits: [(usize, usize); 2],
    /// The first register that is forgotten without power.
    ram: usize,
    steps_per_s: f64,
}

const X: Manual = Manual {
    is_two: true,
    is_big: false,
    torque: 64,
    goal: (116, 4),
    speed: (112, 4),
    position: (132, 4),
    limits: [(52, 4), (48, 4)],
    ram: 64,
    steps_per_s: 0.229 * 4096.0 / 60.0,
};
const AX: Manual = Manual {
    is_two: false,
    torque: 24,
    goal: (30, 2),
    speed: (32, 2),
    position: (36, 2),
    limits: [(6, 2), (8, 2)],
    ram: 24,
    steps_per_s: 0.111 / 60.0 * 360.0 / 0.293,
    ..X
};
const MX: Manual = Manual { steps_per_s: 0.114 * 4096.0 / 60.0, ..AX };
const STS: Manual = Manual {
    torque: 40,
    goal: (42, 2),
    speed: (46, 2),
    position: (56, 2),
    limits: [(9, 2), (11, 2)],
    ram: 40,
    steps_per_s: 50.0,
    ..AX
};
const SCS: Manual = Manual { is_big: true, steps_per_s: 1.0, ..STS };

/// What a servo has in its registers when it comes from the maker: addresses and bytes.
type Contents = &'static [(usize, &'static [u8])];

/// The name of a family in settings, and a servo of it: an XL330, an AX-12, an MX-28, an STS3215 and an SCS0009.
const FAMILIES: [(&str, Manual, Contents); 5] = [
    (
        "dynamixel-x",
        X,
        &[
            (0, &[0xB0, 4]),
            (11, &[3]),
            (31, &[70, 70, 0, 35, 0]),
            (44, &[0xBD, 1, 0, 0, 0xFF, 0x0F]),
            (144, &[50, 0, 30]),
        ],
    ),
    ("dynamixel-ax", AX, &[(0, &[12]), (8, &[0xFF, 3, 0, 70, 60, 140]), (42, &[111, 35])]),
    ("dynamixel-mx", MX, &[(0, &[29]), (8, &[0xFF, 0x0F, 0, 80, 60, 160]), (42, &[120, 35])]),
    ("feetech-sts", STS, &[(3, &[9, 3]), (11, &[0xFF, 0x0F, 70, 80, 40]), (18, &[0b1100]), (62, &[74, 30])]),
    ("feetech-scs", SCS, &[(2, &[1, 5, 4]), (9, &[0, 20, 3, 0xEB, 70, 80, 45]), (62, &[60, 30])]),
];

pub struct Servo {
    manual: Manual,
    pub id: u8,
    pub registers: [u8; 256],
    /// The alarms in the error byte of an answer, or of register 70.
    pub alarms: u8,
    pub answers: Answers,
    /// Where it is, and the fastest that it was, in steps and a second.
    pub position: f64,
    pub fastest: f64,
    /// What its motor reaches, steps a second.
    pub motor: f64,
    moved_at: Instant,
    heard_at: Instant,
    /// Until when it has no power, or starts.
    away_until: Instant,
}

impl Servo {
    fn new(manual: Manual, contents: Contents, id: u8, now: Instant) -> Self {
        let mut registers = [0; 256];
        contents.iter().for_each(|(first, bytes)| registers[*first..first + bytes.len()].copy_from_slice(bytes));
        let place = if manual.is_two {
            7
        } else if manual.ram == AX.ram {
            3
        } else {
            5
        };
        registers[place] = id;
        let (alarms, answers, position, fastest, motor) = (0, Answers::Well, 500.0, 0.0, 5000.0);
        let (moved_at, heard_at, away_until) = (now, now, now);
        Self { manual, id, registers, alarms, answers, position, fastest, motor, moved_at, heard_at, away_until }
    }

    pub fn get(&self, (first, width): (usize, usize)) -> u32 {
        let bytes = self.registers[first..first + width].iter();
        let number = |number, byte: &u8| number << 8 | u32::from(*byte);
        if self.manual.is_big { bytes.fold(0, number) } else { bytes.rev().fold(0, number) }
    }

    fn set(&mut self, (first, width): (usize, usize), number: u32) {
        let mut bytes = number.to_le_bytes()[..width].to_vec();
        if self.manual.is_big {
            bytes.reverse();
        }
        self.registers[first..first + width].copy_from_slice(&bytes);
    }

    pub fn has_torque(&self) -> bool {
        self.registers[self.manual.torque] > 0
    }

    pub fn goal(&self) -> u32 {
        self.get(self.manual.goal)
    }

    /// Its power is cut, and it has started again at this time.
    pub fn restart(&mut self, at: Instant) {
        let sensors = [42, 43, 62, 63, 144, 146].map(|sensor| (sensor, self.registers[sensor]));
        self.registers[self.manual.ram..].fill(0);
        let is_sensor = |at: usize| if self.manual.ram == AX.ram { at < 44 } else { at >= 62 };
        sensors.iter().filter(|(at, _)| is_sensor(*at)).for_each(|(at, byte)| self.registers[*at] = *byte);
        (self.alarms, self.away_until) = (0, at);
    }

    /// Moves on to this time.
    pub fn advance(&mut self, now: Instant) {
        let Manual { is_two, torque, speed, position, .. } = self.manual;
        let step_s = now.saturating_duration_since(self.moved_at).as_secs_f64();
        let silent_ms = now.saturating_duration_since(self.heard_at).as_millis();
        let watchdog = u128::from(self.registers[98]);
        let trips = is_two && self.has_torque() && (1..=127).contains(&watchdog) && silent_ms > watchdog * 20;
        if trips {
            self.registers[98] = 0xFF;
        }
        let is_stopped = is_two && self.registers[98] == 0xFF;
        if self.registers[torque] == 1 && !is_stopped && step_s > 0.0 {
            let is_fine = self.manual.ram == STS.ram && self.registers[18] & 4 > 0 && !self.manual.is_big;
            let unit = if is_fine { self.manual.steps_per_s / 50.0 } else { self.manual.steps_per_s };
            let speed = f64::from(self.get(speed)) * unit;
            let most = if speed > 0.0 { speed.min(self.motor) } else { self.motor } * step_s;
            let way = (f64::from(self.goal()) - self.position).clamp(-most, most);
            self.position += way;
            self.fastest = self.fastest.max(way.abs() / step_s);
        }
        self.moved_at = now;
        self.set(position, self.position.round() as u32);
        if is_two {
            self.registers[70] = self.alarms;
        }
    }

    fn write(&mut self, first: usize, data: &[u8]) {
        let Manual { is_two, torque, goal, limits, .. } = self.manual;
        let before = self.registers;
        let is_locked = is_two && self.has_torque() && first < 64;
        if is_locked || is_two && before[98] == 0xFF && (100..120).contains(&first) {
            return;
        }
        self.registers[first..first + data.len()].copy_from_slice(data);
        let [least, most] = limits.map(|limit| self.get(limit));
        let sets_goal = (first..first + data.len()).contains(&goal.0);
        if sets_goal && is_two && !(least..=most).contains(&self.goal()) {
            self.registers = before;
        } else if sets_goal && !is_two {
            // A goal turns the torque on.
            self.registers[torque] = self.registers[torque].max(1);
        }
        // An X servo begins where it stands.
        if is_two && before[torque] == 0 && self.has_torque() {
            self.set(goal, self.position.round() as u32);
        }
    }
}

/// What was written: when, in which servo, from which register on, and what.
pub type Written = (Instant, u8, usize, Vec<u8>);

/// Servos on one line.
pub struct Simulator {
    manual: Manual,
    contents: Contents,
    pub servos: Vec<Servo>,
    /// The line has one wire, so that all comes back.
    pub echoes: bool,
    pub written: Vec<Written>,
    /// Instructions other than reading and writing together, and frames that are no frames.
    pub strange: Vec<Vec<u8>>,
    input: Vec<u8>,
    answers: Vec<(Instant, Vec<u8>)>,
}

impl Simulator {
    /// Servos as the maker sells them, of a family by its name in the settings.
    pub fn new(family: &str, ids: &[u8], now: Instant) -> Self {
        let (_, manual, contents) = FAMILIES.into_iter().find(|(name, ..)| *name == family).unwrap();
        let servos = ids.iter().map(|id| Servo::new(manual, contents, *id, now)).collect();
        let (written, strange, input, answers) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { manual, contents, servos, echoes: false, written, strange, input, answers }
    }

    pub fn plug_in(&mut self, id: u8, now: Instant) {
        self.servos.push(Servo::new(self.manual, self.contents, id, now));
    }

    /// Takes what comes by the line, and returns what goes back at this time.
    pub fn take(&mut self, bytes: &[u8], now: Instant) -> Vec<u8> {
        if self.echoes && !bytes.is_empty() {
            self.answers.push((now, bytes.to_vec()));
        }
        self.input.extend_from_slice(bytes);
        while let Some(frame) = self.next_frame() {
            self.servos.iter_mut().for_each(|servo| {
                servo.advance(now);
                servo.heard_at = now;
            });
            self.obey(&frame, now);
        }
        self.servos.iter_mut().for_each(|servo| servo.advance(now));
        let due = |(at, _): &(Instant, Vec<u8>)| *at <= now;
        let mut out = Vec::new();
        self.answers.iter().filter(|answer| due(answer)).for_each(|(_, bytes)| out.extend_from_slice(bytes));
        self.answers.retain(|answer| !due(answer));
        out
    }

    /// Takes the next whole frame from the input, from the ID on and without its checksum.
    fn next_frame(&mut self) -> Option<Vec<u8>> {
        let is_two = self.manual.is_two;
        // What begins no frame is skipped.
        let header: &[u8] = if is_two { &[0xFF, 0xFF, 0xFD, 0] } else { &[0xFF, 0xFF] };
        while self.input.iter().zip(header).any(|(byte, header)| byte != header) {
            self.input.remove(0);
        }
        let whole = match *self.input.as_slice() {
            [0xFF, 0xFF, 0xFD, 0, _, low, high, ..] if is_two => 7 + usize::from(u16::from_le_bytes([low, high])),
            [0xFF, 0xFF, _, length, ..] if !is_two => 4 + usize::from(length),
            _ => return None,
        };
        let frame: Vec<u8> = (self.input.len() >= whole).then(|| self.input.drain(..whole).collect())?;
        let (is_good, body) = if is_two {
            let (body, sum) = frame.split_at(whole - 2);
            (sum == crc_16(body).to_le_bytes(), body[4..].to_vec())
        } else {
            (frame[2..].iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte)) == 0xFF, frame[2..whole - 1].to_vec())
        };
        if is_good && body.len() > 2 {
            return Some(body);
        }
        self.strange.push(frame);
        self.next_frame()
    }

    fn obey(&mut self, frame: &[u8], now: Instant) {
        let words = |bytes: &[u8]| bytes.chunks(2).map(|word| usize::from(word[0])).collect::<Vec<_>>();
        let (id, instruction) = (frame[0], frame[if self.manual.is_two { 3 } else { 2 }]);
        let parameters = if self.manual.is_two { unstuffed(&frame[4..]) } else { frame[3..].to_vec() };
        match instruction {
            0x02 => {
                let block = if self.manual.is_two {
                    words(&parameters)
                } else {
                    vec![parameters[0].into(), parameters[1].into()]
                };
                self.answer(id, block[0], block[1], now);
            }
            0x83 => {
                let (start, data) = parameters.split_at(if self.manual.is_two { 4 } else { 2 });
                let start = if self.manual.is_two { words(start) } else { vec![start[0].into(), start[1].into()] };
                for servo in data.chunks(1 + start[1]) {
                    self.written.push((now, servo[0], start[0], servo[1..].to_vec()));
                    let told = self.servos.iter_mut().filter(|it| it.id == servo[0] && it.away_until <= now);
                    told.for_each(|it| it.write(start[0], &servo[1..]));
                }
            }
            _ => self.strange.push(frame.to_vec()),
        }
    }

    fn answer(&mut self, id: u8, first: usize, length: usize, now: Instant) {
        let is_asked = |it: &&Servo| it.id == id && it.answers != Answers::Never && it.away_until <= now;
        for servo in self.servos.iter().filter(is_asked) {
            let error = if self.manual.is_two { if servo.alarms > 0 { 0x80 } else { 0 } } else { servo.alarms };
            let mut frame = status(self.manual.is_two, id, error, &servo.registers[first..first + length]);
            let at = if let Answers::Late(by) = servo.answers { now + by } else { now };
            if servo.answers == Answers::Damaged {
                let middle = frame.len() / 2;
                frame[middle] ^= 0x10;
            }
            self.answers.push((at, frame));
        }
    }
}

/// A servo's answer.
pub fn status(is_two: bool, id: u8, error: u8, data: &[u8]) -> Vec<u8> {
    let mut contents = vec![error];
    contents.extend_from_slice(data);
    if is_two {
        let mut stuffed = vec![0x55];
        for byte in contents {
            stuffed.push(byte);
            if stuffed.ends_with(&[0xFF, 0xFF, 0xFD]) {
                stuffed.push(0xFD);
            }
        }
        let [low, high] = (stuffed.len() as u16 + 2).to_le_bytes();
        let frame = [&[0xFF, 0xFF, 0xFD, 0, id, low, high][..], &stuffed].concat();
        [&frame[..], &crc_16(&frame).to_le_bytes()].concat()
    } else {
        let frame = [&[id, contents.len() as u8 + 1][..], &contents].concat();
        let sum = frame.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte));
        [&[0xFF, 0xFF][..], &frame, &[!sum]].concat()
    }
}

fn unstuffed(bytes: &[u8]) -> Vec<u8> {
    let mut out: Vec<u8> = Vec::new();
    for (place, byte) in bytes.iter().enumerate() {
        let is_stuffing = *byte == 0xFD && place >= 3 && bytes[place - 3..place] == [0xFF, 0xFF, 0xFD];
        if !is_stuffing {
            out.push(*byte);
        }
    }
    out
}

/// CRC-16/UMTS by long division of the message's bits.
fn crc_16(bytes: &[u8]) -> u16 {
    let mut remainder: u32 = 0;
    for bit in bytes.iter().flat_map(|byte| (0..8).rev().map(move |bit| byte >> bit & 1)).chain([0; 16]) {
        remainder = remainder << 1 | u32::from(bit);
        if remainder & 0x1_0000 > 0 {
            remainder ^= 0x1_8005;
        }
    }
    remainder as u16
}
