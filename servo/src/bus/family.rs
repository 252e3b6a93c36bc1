//! The families of bus servos: their registers, as data. Sources: Robotis's e-manual, Feetech's FTServo_Python, and the tables
//! of `LeRobot`.

mod frame;

use std::ops::RangeInclusive;

pub use self::frame::{Block, Protocol, Reader, Status};

/// Registers that hold one number: the first address, and how many bytes.
type Field = (u8, u8);
/// What is known of a servo's registers.
pub type Registers = [u8; 160];

/// What an address of the goal stands for.
#[derive(Debug, Clone, Copy)]
enum Part {
    Position,
    Speed,
    Acceleration,
    /// Always 0.
    Time,
}

/// The names of families in settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    DynamixelX,
    DynamixelAx,
    DynamixelMx,
    FeetechSts,
    FeetechScs,
}

/// Where a servo is to go. A speed or an acceleration of 0 has no limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Goal {
    pub steps: f32,
    pub steps_per_s: f32,
    pub steps_per_s2: f32,
}

/// The registers that are ever written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Target {
    Torque,
    Watchdog,
    Goal,
}

/// What a servo is told. It is made by the functions here alone, so that no other register can be written, and none with a
/// value that does harm.
#[derive(Debug, Clone, Copy)]
pub struct Order {
    target: Target,
    data: [u8; GOAL_BYTES],
}

const GOAL_BYTES: usize = 12;
/// The Bus Watchdog stops a servo that hears nothing for so many times 20 ms.
const WATCHDOG: u8 = 25;
/// What the register of a Bus Watchdog has once the time ran out.
pub const TRIPPED: u32 = 0xFF;

#[derive(Debug)]
pub struct Family {
    pub name: &'static str,
    pub protocol: Protocol,
    is_big_endian: bool,
    models: &'static [RangeInclusive<u32>],
    pub degrees_per_step: f32,
    pub most_steps: u16,
    /// What is read: first what a servo is, then again and again how it is.
    pub blocks: &'static [Block],
    model: Field,
    id: u8,
    /// The lowest and the highest position.
    limits: [Field; 2],
    /// What a byte must be: its address, the bits that count, the values that they may have, and what to do otherwise.
    needs: &'static [(u8, u8, &'static [u8], &'static str)],
    pub torque: u8,
    goal: u8,
    parts: &'static [(Part, u8)],
    pub watchdog: Option<u8>,
    steps_per_s: f32,
    most_speed: u32,
    /// The byte and the bit that, when set, make the unit of speed one fiftieth.
    fine_speed: Option<(u8, u8)>,
    speed_limit: Option<Field>,
    /// 0 if the servo has no limit of acceleration beside its goal.
    pub steps_per_s2: f32,
    pub position: Field,
    /// In tenths of a percent.
    load: Option<Field>,
    /// In tenths of a volt: the present voltage, the least and the most.
    volts: [Field; 3],
    /// In degrees Celsius: the present temperature, and the highest.
    celsius: [Field; 2],
    /// Where its alarms are, if not in the error byte of each answer.
    alarms: Option<u8>,
    alarm_bits: [Option<&'static str>; 6],
}

const VOLTAGE: Option<&str> =
    Some("its supply voltage is beyond its limits: check the supply, and give power at several places of a long line");
const HEAT: Option<&str> = Some("it is too hot: cut its power, let it cool, and check that nothing holds it");
const ENCODER: Option<&str> =
    Some("its position sensor fails: cut its power for a moment, and replace it if this comes back");
const SHOCK: Option<&str> = Some("its current is too high: cut its power, and check its cable and its motor");
const OVERLOAD: Option<&str> =
    Some("it is overloaded: cut its power for a moment, and check its ends, and that nothing holds it");

const X: Family = Family {
    name: "dynamixel-x",
    protocol: Protocol::Two,
    is_big_endian: false,
    // All of the X series, and MX servos with firmware for protocol 2.0. An XL-320 has other registers.
    models: &[1000..=1999, 30..=30, 311..=311, 321..=321],
    degrees_per_step: 360.0 / 4096.0,
    most_steps: 4095,
    blocks: &[Block(0, 56), Block(64, 35), Block(126, 21)],
    model: (0, 2),
    id: 7,
    limits: [(52, 4), (48, 4)],
    needs: &[
        (11, 0xFF, &[3, 5], "set its operating mode to position control, with the maker's program"),
        (
            10,
            0b1100,
            &[0],
            "set its drive mode to profiles of velocity, without torque on by goal update, with the maker's program",
        ),
    ],
    torque: 64,
    goal: 108,
    parts: &[(Part::Acceleration, 4), (Part::Speed, 4), (Part::Position, 4)],
    watchdog: Some(98),
    // 0.229 rpm, and 214.577 rev/min².
    steps_per_s: 0.229 * 4096.0 / 60.0,
    most_speed: 32_767,
    fine_speed: None,
    speed_limit: Some((44, 4)),
    steps_per_s2: 214.577 * 4096.0 / 3600.0,
    position: (132, 4),
    load: None,
    volts: [(144, 2), (34, 2), (32, 2)],
    celsius: [(146, 1), (31, 1)],
    alarms: Some(70),
    alarm_bits: [VOLTAGE, None, HEAT, ENCODER, SHOCK, OVERLOAD],
};

const AX: Family = Family {
    name: "dynamixel-ax",
    protocol: Protocol::One,
    models: &[12..=18, 300..=300, 24..=24, 28..=28, 64..=64],
    degrees_per_step: 300.0 / 1023.0,
    most_steps: 1023,
    blocks: &[Block(0, 14), Block(24, 20)],
    id: 3,
    limits: [(6, 2), (8, 2)],
    needs: &[],
    torque: 24,
    goal: 30,
    parts: &[(Part::Position, 2), (Part::Speed, 2)],
    watchdog: None,
    // 0.111 rpm.
    steps_per_s: 0.111 * 6.0 * 1023.0 / 300.0,
    most_speed: 1023,
    speed_limit: None,
    steps_per_s2: 0.0,
    position: (36, 2),
    load: Some((40, 2)),
    volts: [(42, 1), (12, 1), (13, 1)],
    celsius: [(43, 1), (11, 1)],
    alarms: None,
    // The other bits tell of questions, not of the servo.
    alarm_bits: [VOLTAGE, None, HEAT, None, None, OVERLOAD],
    ..X
};

const MX: Family = Family {
    name: "dynamixel-mx",
    models: &[29..=29, 310..=310, 320..=320, 360..=360],
    degrees_per_step: 360.0 / 4096.0,
    most_steps: 4095,
    // 0.114 rpm.
    steps_per_s: 0.114 * 4096.0 / 60.0,
    ..AX
};

const STS: Family = Family {
    name: "feetech-sts",
    protocol: Protocol::One,
    models: &[0..=u32::MAX],
    blocks: &[Block(0, 37), Block(40, 26)],
    model: (3, 2),
    id: 5,
    limits: [(9, 2), (11, 2)],
    needs: &[
        (2, 0xFF, &[0], "its registers have the high byte first: set family = \"feetech-scs\""),
        (33, 0xFF, &[0], "set its mode to position, with the maker's program"),
        (18, 0x10, &[0], "clear bit 4 of its phase, so that it counts no turns, with the maker's program"),
    ],
    torque: 40,
    goal: 41,
    parts: &[(Part::Acceleration, 1), (Part::Position, 2), (Part::Time, 2), (Part::Speed, 2)],
    watchdog: None,
    steps_per_s: 50.0,
    most_speed: 32_767,
    fine_speed: Some((18, 0b100)),
    speed_limit: None,
    steps_per_s2: 100.0,
    position: (56, 2),
    load: Some((60, 2)),
    volts: [(62, 1), (15, 1), (14, 1)],
    celsius: [(63, 1), (13, 1)],
    alarms: None,
    alarm_bits: [VOLTAGE, ENCODER, HEAT, SHOCK, None, OVERLOAD],
    ..X
};

const SCS: Family = Family {
    name: "feetech-scs",
    is_big_endian: true,
    degrees_per_step: 300.0 / 1023.0,
    most_steps: 1023,
    blocks: &[Block(0, 16), Block(40, 26)],
    needs: &[(2, 0xFF, &[1], "its registers have the low byte first: set family = \"feetech-sts\"")],
    goal: 42,
    parts: &[(Part::Position, 2), (Part::Time, 2), (Part::Speed, 2)],
    steps_per_s: 1.0,
    fine_speed: None,
    steps_per_s2: 0.0,
    ..STS
};

impl Order {
    pub fn torque(is_on: bool) -> Self {
        Self::of(Target::Torque, is_on.into())
    }

    /// Sets the Bus Watchdog, or clears it. Other servos have none, and are not told.
    pub fn watchdog(is_on: bool) -> Self {
        Self::of(Target::Watchdog, if is_on { WATCHDOG } else { 0 })
    }

    fn of(target: Target, byte: u8) -> Self {
        let mut data = [0; GOAL_BYTES];
        data[0] = byte;
        Self { target, data }
    }
}

impl Kind {
    #[must_use]
    pub fn family(self) -> &'static Family {
        match self {
            Self::DynamixelX => &X,
            Self::DynamixelAx => &AX,
            Self::DynamixelMx => &MX,
            Self::FeetechSts => &STS,
            Self::FeetechScs => &SCS,
        }
    }
}

impl Family {
    pub fn get(&self, registers: &Registers, (address, width): Field) -> u32 {
        let bytes = registers.iter().skip(address.into()).take(width.into());
        let number = |number, byte: &u8| number << 8 | u32::from(*byte);
        if self.is_big_endian { bytes.fold(0, number) } else { bytes.rev().fold(0, number) }
    }

    /// Appends a frame for each run of orders of one kind. Orders for registers that the family does not have are left out.
    pub fn write(&self, orders: &[(u8, Order)], out: &mut Vec<u8>) {
        for orders in orders.chunk_by(|(one_id, one), (id, other)| one.target == other.target && one_id < id) {
            let (address, length) = match orders.first().map(|(_, order)| order.target) {
                Some(Target::Torque) => (Some(self.torque), 1),
                Some(Target::Goal) => (Some(self.goal), self.goal_bytes()),
                _ => (self.watchdog, 1),
            };
            let servos: Vec<_> = orders.iter().map(|(id, order)| (*id, order.data)).collect();
            address.iter().for_each(|address| self.protocol.write_sync(*address, length, &servos, out));
        }
    }

    fn goal_bytes(&self) -> usize {
        self.parts.iter().map(|(_, width)| usize::from(*width)).sum()
    }

    /// How many bytes the line must carry for a message to so many servos: goals may take half of the time until the next
    /// message, and leave room for a question and its answer.
    #[must_use]
    pub fn line_bytes(&self, servos: usize) -> usize {
        let answer = self.blocks.iter().skip(1).map(|Block(_, length)| usize::from(*length)).max().unwrap_or(0);
        let (goals, question) = if self.protocol == Protocol::One { (8, 8 + 6) } else { (14, 14 + 11) };
        let goals = goals + servos * (1 + self.goal_bytes());
        (2 * goals).max(goals + question + answer)
    }

    /// Moves a servo with these registers.
    pub fn goal(&self, goal: Goal, registers: &Registers) -> Order {
        let mut data = [0; GOAL_BYTES];
        let mut free = data.iter_mut();
        for (part, width) in self.parts {
            let (number, width) = (self.number(*part, goal, registers), usize::from(*width));
            let [little, big] = [number.to_le_bytes(), number.to_be_bytes()];
            let bytes = if self.is_big_endian { big.get(4 - width..) } else { little.get(..width) };
            free.by_ref().take(width).zip(bytes.unwrap_or_default()).for_each(|(to, from)| *to = *from);
        }
        Order { target: Target::Goal, data }
    }

    /// A limit is rounded down, so that it is kept, but never to 0, which stands for none.
    fn number(&self, part: Part, goal: Goal, registers: &Registers) -> u32 {
        let limit = |limit: f32, unit: f32, most: u32| match limit {
            limit if limit > 0.0 && limit.is_finite() => ((limit / unit) as u32).clamp(1, most),
            _ => 0,
        };
        match part {
            Part::Time => 0,
            Part::Position => {
                let [least, most] = self.limits(registers);
                (goal.steps.round().max(0.0) as u32).min(most).max(least)
            }
            Part::Speed => {
                let most = self.speed_limit.map_or(self.most_speed, |field| self.get(registers, field));
                limit(goal.steps_per_s, self.speed_unit(registers), most.clamp(1, self.most_speed))
            }
            Part::Acceleration => limit(goal.steps_per_s2, self.steps_per_s2, 254),
        }
    }

    fn speed_unit(&self, registers: &Registers) -> f32 {
        let is_fine = |(address, bit)| self.get(registers, (address, 1)) & u32::from(bit) > 0;
        if self.fine_speed.is_some_and(is_fine) { self.steps_per_s / 50.0 } else { self.steps_per_s }
    }

    /// The least limits of speed and acceleration that a servo keeps, steps a second and a second².
    #[must_use]
    pub fn least_limits(&self) -> [f32; 2] {
        [self.steps_per_s, self.steps_per_s2]
    }

    /// The lowest and the highest position that the servo allows, and that the family has.
    pub fn limits(&self, registers: &Registers) -> [u32; 2] {
        let [least, most] = self.limits.map(|field| self.get(registers, field));
        [least, most.min(self.most_steps.into())]
    }

    /// Where the servo is. Beyond the limits, where it gets no goal, it is at the nearer one.
    pub fn position(&self, registers: &Registers) -> f32 {
        let (position, [least, most]) = (self.get(registers, self.position), self.limits(registers));
        // The sign of Feetech is bit 15, and that of four bytes bit 31.
        let is_negative = position >> (8 * u32::from(self.position.1) - 1) > 0;
        (if is_negative { least } else { position.min(most).max(least) }) as f32
    }

    pub fn model(&self, registers: &Registers) -> u32 {
        self.get(registers, self.model)
    }

    /// Whether the first registers are those of a servo of this family with this number. Feetech tells its byte order.
    pub fn has_start(&self, registers: &Registers, id: u8) -> bool {
        let model = self.model(registers);
        let has_order = self.needs.iter().filter(|(address, ..)| *address == 2);
        let mut has_order =
            has_order.map(|(_, _, orders, _)| orders.iter().any(|order| registers.get(2) == Some(order)));
        self.models.iter().any(|models| models.contains(&model))
            && registers.get(usize::from(self.id)) == Some(&id)
            && has_order.all(|is_met| is_met)
    }

    /// Why a servo with these registers is not moved, if there is a reason.
    pub fn refusal(&self, registers: &Registers, ends: [f32; 2]) -> Option<String> {
        let (model, [least, most]) = (self.model(registers), self.limits(registers));
        if !self.models.iter().any(|models| models.contains(&model)) {
            return Some(format!("its model {model} is not one of {}: set another family", self.name));
        }
        let is_met = |(address, bits, values, _): &&(u8, u8, &[u8], &str)| {
            values.iter().any(|value| self.get(registers, (*address, 1)) & u32::from(*bits) == u32::from(*value))
        };
        if let Some((.., remedy)) = self.needs.iter().find(|need| !is_met(need)) {
            return Some((*remedy).to_owned());
        }
        if least >= most {
            return Some(format!(
                "its limits are {least} and {most}: set it to position control, with the maker's program"
            ));
        }
        let is_beyond = |end: &&f32| **end < least as f32 || **end > most as f32;
        let end = ends.iter().find(is_beyond)?;
        Some(format!(
            "an end is at {end:.0} steps, but the servo allows {least} to {most}: change the end, or its limits"
        ))
    }

    /// The bits of its alarms.
    pub fn alarms(&self, registers: &Registers, error: u8) -> u8 {
        let alarms = self.alarms.map_or(u32::from(error), |address| self.get(registers, (address, 1)));
        let known = (0..).zip(self.alarm_bits).filter(|(bit, name)| name.is_some() && alarms >> bit & 1 > 0);
        known.fold(0, |alarms, (bit, _)| alarms | 1 << bit)
    }

    /// What is wrong with a servo that answers, if anything is.
    pub fn trouble(&self, registers: &Registers, alarms: u8) -> Option<String> {
        let mut bits = (0..).zip(self.alarm_bits);
        if let Some((_, Some(alarm))) = bits.find(|(bit, _)| alarms >> bit & 1 > 0) {
            return Some(alarm.to_owned());
        }
        let [volts, least, most] = self.volts.map(|field| self.get(registers, field));
        let [celsius, hottest] = self.celsius.map(|field| self.get(registers, field));
        let load = self.load.map_or(0, |field| self.get(registers, field) & 0x3FF);
        if volts < least || volts > most {
            let volts = f64::from(volts) / 10.0;
            return Some(format!("its supply has {volts:.1} V: check the supply, and the cables for thin wires"));
        }
        if hottest > 0 && celsius + 5 >= hottest {
            return Some(format!(
                "it is at {celsius} °C, and its limit is {hottest} °C: give it less to hold, or set loss = \"release\""
            ));
        }
        (load >= 900).then(|| "it pushes with all its force: check its ends, and that nothing holds it".to_owned())
    }
}
