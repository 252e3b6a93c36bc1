//! The families of bus servos: their registers, as data, each with the public manual that it was compared with.
//!
//! Robotis describes each model on a page of its own in <https://emanual.robotis.com/docs/en/dxl/>, and lists the registers of
//! all X models in <https://github.com/ROBOTIS-GIT/dynamixel_hardware_interface> (`param/dxl_model`). Feetech has a table for
//! each series at <http://doc.feetech.cn>.

mod frame;

use std::ops::RangeInclusive;

pub use self::frame::{Frame, Protocol, Reader};
#[cfg(any(test, feature = "simulator"))]
pub use self::frame::{READ, STATUS, SYNC_WRITE};

/// Neighbouring registers, which hold one number or are read together: the first address, and how many there are.
pub type Field = (u8, u8);
/// Stands for registers that a family does not have. They read as 0, and are not written.
const NONE: Field = (0, 0);
/// What is known of a servo's registers.
pub type Registers = Vec<u8>;
/// What a byte must be: its address, the bits that count, the values that they may have, and what to do otherwise.
type Need = (u8, u8, &'static [RangeInclusive<u8>], &'static str);
/// One bit: the address of its byte, and its weight. A weight of 0 stands for a bit that a family does not have.
type Bit = (u8, u32);
/// How much finer the fine unit of speed of a Feetech servo is.
const FINE: u16 = 50;
/// The Bus Watchdog stops a servo that hears nothing for so many times 20 ms.
const WATCHDOG: u8 = 25;
/// What the register of a Bus Watchdog has once the time ran out.
pub const TRIPPED: u32 = 0xFF;

#[derive(Debug, PartialEq)]
pub struct Family {
    pub name: &'static str,
    pub protocol: Protocol,
    is_big_endian: bool,
    models: &'static [RangeInclusive<u32>],
    pub degrees_per_step: f32,
    pub most_steps: u16,
    /// What is read: first what a servo is, then again and again how it is.
    pub reads: &'static [Field],
    pub model: Field,
    pub id: Field,
    /// The lowest and the highest position.
    limits: [Field; 2],
    needs: &'static [Need],
    pub torque: Field,
    /// What a goal writes.
    pub goal: Field,
    /// Place, speed and acceleration of a goal. The rest of it is 0.
    pub goal_parts: [Field; 3],
    pub watchdog: Field,
    /// Units of speed and acceleration in steps/s and steps/s², which are the lowest limits, too. 0 if it keeps no such limit.
    pub units: [f32; 2],
    /// Models that have another unit of speed.
    other_speed_units: &'static [(u32, f32)],
    /// The highest numbers of these units.
    most_units: [u32; 2],
    /// Where the servo's own limits of speed and acceleration are, which no goal may exceed.
    own_limits: [Field; 2],
    /// If it is set, the unit of speed is divided by [`FINE`].
    fine_speed: Bit,
    /// A speed of 0 means no limit if this bit is set, or if the family does not have it. Otherwise 0 stops the servo.
    zero_is_no_limit: Bit,
    /// Whether the servo keeps a limit of acceleration only beside one of speed.
    needs_speed: bool,
    pub place: Field,
    /// The present voltage, the least and the most, in tenths of a volt.
    volts: [Field; 3],
    /// The present temperature and the highest in degrees Celsius, and the load in tenths of a percent.
    celsius_and_load: [Field; 3],
    /// Where its alarms are, if not in the error byte of each answer.
    pub alarms: Field,
    alarm_bits: [&'static str; 6],
}

const VOLTAGE: &str =
    "its supply voltage is beyond its limits: check the supply, and give power at several places of a long line";
const HEAT: &str = "it is too hot: cut its power, let it cool, and check that nothing holds it";
const ENCODER: &str = "its position sensor fails: cut its power for a moment, and replace it if this comes back";
const SHOCK: &str = "its current is too high: cut its power, and check its cable and its motor";
const OVERLOAD: &str = "it is overloaded: cut its power for a moment, and check its ends, and that nothing holds it";

/// The model that turns eight times as fast as the other MX models.
const MX_12W: u32 = 360;

/// The families by their names in settings.
pub const FAMILIES: &[(&str, &Family)] =
    &[(X.name, &X), (AX.name, &AX), (MX.name, &MX), (STS.name, &STS), (SCS.name, &SCS)];

/// <https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/>, and likewise for every other X model and for `mx/mx-28-2`,
/// `mx/mx-64-2` and `mx/mx-106-2`: all have these registers in the same units.
const X: Family = Family {
    name: "dynamixel-x",
    protocol: Protocol::Two,
    is_big_endian: false,
    // All of the X series, and MX servos with firmware for protocol 2.0. An XL-320 has other registers.
    models: &[1000..=1999, 30..=30, 311..=311, 321..=321],
    degrees_per_step: 360.0 / 4096.0,
    most_steps: 4095,
    reads: &[(0, 56), (64, 35), (126, 21)],
    model: (0, 2),
    id: (7, 1),
    limits: [(52, 4), (48, 4)],
    needs: &[
        (11, 0xFF, &[3..=3, 5..=5], "set its operating mode to position control, with the maker's program"),
        (10, 0b1100, &[0..=0], "set its drive mode to profiles of velocity, without torque on by goal update"),
    ],
    torque: (64, 1),
    goal: (108, 12),
    goal_parts: [(116, 4), (112, 4), (108, 4)],
    watchdog: (98, 1),
    // Profile Velocity (112): 0.229 rpm, 0 to 32,767. Profile Acceleration (108): 214.577 rev/min², 0 to 32,767.
    units: [0.229 * 4096.0 / 60.0, 214.577 * 4096.0 / 3600.0],
    other_speed_units: &[],
    most_units: [32_767, 32_767],
    // MX models alone have Acceleration Limit (40). The others have 0 there.
    own_limits: [(44, 4), (40, 4)],
    fine_speed: (0, 0),
    zero_is_no_limit: (0, 0),
    // A Profile Velocity of 0 means that there is no profile, and then Profile Acceleration does nothing.
    needs_speed: true,
    place: (132, 4),
    volts: [(144, 2), (34, 2), (32, 2)],
    celsius_and_load: [(146, 1), (31, 1), NONE],
    alarms: (70, 1),
    alarm_bits: [VOLTAGE, "", HEAT, ENCODER, SHOCK, OVERLOAD],
};

/// <https://emanual.robotis.com/docs/en/dxl/ax/ax-12a/>, and likewise `ax/ax-12w`, `ax/ax-18a`, `rx/rx-24f`, `rx/rx-28` and
/// `rx/rx-64`.
const AX: Family = Family {
    name: "dynamixel-ax",
    protocol: Protocol::One,
    models: &[12..=12, 300..=300, 18..=18, 24..=24, 28..=28, 64..=64],
    degrees_per_step: 300.0 / 1023.0,
    most_steps: 1023,
    reads: &[(0, 14), (24, 20)],
    id: (3, 1),
    limits: [(6, 2), (8, 2)],
    needs: &[],
    torque: (24, 1),
    goal: (30, 4),
    goal_parts: [(30, 2), (32, 2), NONE],
    watchdog: NONE,
    // Moving Speed (32): 0.111 rpm, 0 to 1023.
    units: [0.111 * 6.0 * 1023.0 / 300.0, 0.0],
    most_units: [1023, 0],
    own_limits: [NONE; 2],
    needs_speed: false,
    place: (36, 2),
    volts: [(42, 1), (12, 1), (13, 1)],
    celsius_and_load: [(43, 1), (11, 1), (40, 2)],
    alarms: NONE,
    // The other bits tell of questions, not of the servo.
    alarm_bits: [VOLTAGE, "", HEAT, "", "", OVERLOAD],
    ..X
};

/// <https://emanual.robotis.com/docs/en/dxl/mx/mx-28/>, and likewise `mx/mx-64`, `mx/mx-106` and `mx/mx-12w`.
const MX: Family = Family {
    name: "dynamixel-mx",
    models: &[29..=29, 310..=310, 320..=320, MX_12W..=MX_12W],
    degrees_per_step: 360.0 / 4096.0,
    most_steps: 4095,
    // Moving Speed (32): 0.114 rpm, but 0.916 rpm of an MX-12W, 0 to 1023.
    units: [0.114 * 4096.0 / 60.0, 0.0],
    other_speed_units: &[(MX_12W, 0.916 * 4096.0 / 60.0)],
    ..AX
};

/// <http://doc.feetech.cn/#/prodinfodownload?srcType=FT-SMS-STS-emanual-229f4476422d4059abfb1cb0>
const STS: Family = Family {
    name: "feetech-sts",
    models: &[0..=u32::MAX],
    degrees_per_step: 360.0 / 4096.0,
    most_steps: 4095,
    reads: &[(0, 37), (40, 26)],
    model: (3, 2),
    id: (5, 1),
    limits: [(9, 2), (11, 2)],
    needs: &[
        (2, 0xFF, &[0..=0], "its registers have the high byte first: set family = \"feetech-scs\""),
        (3, 0xFF, &[0..=9, 11..=0xFF], "it is of the series HLS, which has other registers: use one of the series STS"),
        (33, 0xFF, &[0..=0], "set its mode to position, with the maker's program"),
        (18, 0x10, &[0..=0], "clear bit 4 of its phase, so that it counts no turns, with the maker's program"),
        (30, 0xFF, &[0..=1], "set its angle resolution to 1, with the maker's program"),
    ],
    torque: (40, 1),
    goal: (41, 7),
    goal_parts: [(42, 2), (46, 2), (41, 1)],
    // Speed (46): 0.732 rpm, which are 50 steps/s, or 0.0146 rpm with bit 2 of the phase (18). The highest speed of a servo
    // (84) is one byte in the coarse unit. Acceleration (41): 100 steps/s², 0 to 254.
    units: [50.0, 100.0],
    most_units: [0xFF, 254],
    fine_speed: (18, 0b100),
    zero_is_no_limit: (18, 0b1000),
    place: (56, 2),
    volts: [(62, 1), (15, 1), (14, 1)],
    celsius_and_load: [(63, 1), (13, 1), (60, 2)],
    alarm_bits: [VOLTAGE, ENCODER, HEAT, SHOCK, "", OVERLOAD],
    ..AX
};

/// <http://doc.feetech.cn/#/prodinfodownload?srcType=FT-SCSCL-emanual-cbcc8ab2e3384282a01d4bf3>
const SCS: Family = Family {
    name: "feetech-scs",
    is_big_endian: true,
    degrees_per_step: 300.0 / 1023.0,
    most_steps: 1023,
    reads: &[(0, 19), (40, 26)],
    needs: &[(2, 0xFF, &[1..=1], "its registers have the low byte first: set family = \"feetech-sts\"")],
    goal: (42, 6),
    goal_parts: [(42, 2), (46, 2), NONE],
    // Speed (46): steps/s. The highest speed of a servo (82) is one byte in 50 steps/s.
    units: [1.0, 0.0],
    most_units: [50 * 0xFF, 0],
    fine_speed: (0, 0),
    // Bits 1 and 3 of its status (65) mean nothing.
    alarm_bits: [VOLTAGE, "", HEAT, "", "", OVERLOAD],
    ..STS
};

pub fn unknown() -> Registers {
    vec![0; 160]
}

/// Puts what an answer tells of these registers in their place.
pub fn store((address, length): Field, answer: &[u8], registers: &mut Registers) {
    registers.iter_mut().skip(address.into()).take(length.into()).zip(answer).for_each(|(to, from)| *to = *from);
}

/// Returns a limit in units, rounded down so that it is kept, but never to 0, which means no limit.
fn in_units(limit: f32, unit: f32, most: u32) -> u32 {
    if limit > 0.0 && limit.is_finite() && most > 0 { ((limit / unit) as u32).clamp(1, most) } else { 0 }
}

impl Family {
    pub const DYNAMIXEL_X: &Self = &X;

    pub fn get(&self, registers: &Registers, (address, width): Field) -> u32 {
        let bytes = registers.iter().skip(address.into()).take(width.into());
        let number = |number, byte: &u8| number << 8 | u32::from(*byte);
        if self.is_big_endian { bytes.fold(0, number) } else { bytes.rev().fold(0, number) }
    }

    pub fn set(&self, registers: &mut Registers, (address, width): Field, number: u32) {
        let (little, big) = (number.to_le_bytes(), number.to_be_bytes());
        let bytes = if self.is_big_endian { big.get(4 - usize::from(width)..).unwrap_or_default() } else { &little };
        store((address, width), bytes, registers);
    }

    /// Appends what gives servos torque, or takes it.
    pub fn write_torque(&self, ids: &[u8], is_on: bool, out: &mut Vec<u8>) {
        self.write_byte(self.torque, is_on.into(), ids, out);
    }

    /// Appends what sets the Bus Watchdogs of servos, or clears them.
    pub fn write_watchdog(&self, ids: &[u8], is_on: bool, out: &mut Vec<u8>) {
        self.write_byte(self.watchdog, if is_on { WATCHDOG } else { 0 }, ids, out);
    }

    fn write_byte(&self, field: Field, byte: u8, ids: &[u8], out: &mut Vec<u8>) {
        let servos: Vec<_> = ids.iter().map(|id| (*id, vec![byte])).collect();
        self.protocol.write_sync(field, &servos, out);
    }

    /// Appends what moves servos, each as [`Family::goal`] says.
    pub fn write_goals(&self, goals: &[(u8, Vec<u8>)], out: &mut Vec<u8>) {
        self.protocol.write_sync(self.goal, goals, out);
    }

    /// How many bytes the line must carry for a message to so many servos: goals may take half of the time until the next
    /// message, and leave room for a question and its answer.
    #[must_use]
    pub fn line_bytes(&self, servos: usize) -> usize {
        let answer = self.reads.iter().skip(1).map(|(_, length)| usize::from(*length)).max().unwrap_or(0);
        let (start, question) = if self.protocol == Protocol::One { (8, 8 + 6) } else { (14, 14 + 11) };
        let goals = start + servos * (1 + usize::from(self.goal.1));
        (2 * goals).max(goals + question + answer)
    }

    /// Returns what moves a servo with these registers to a place, in steps, with limits of speed and acceleration, in steps/s
    /// and steps/s². A servo that would not move at a speed of 0, or not keep its limit of acceleration, gets the highest speed
    /// in place of no limit.
    pub fn goal(&self, [place, speed, acceleration]: [f32; 3], registers: &Registers) -> Vec<u8> {
        let [least, most] = self.limits(registers);
        let [most_speed, most_acceleration] = self.most_units(registers);
        let place = (place.round().max(0.0) as u32).min(most).max(least);
        let acceleration = in_units(acceleration, self.units[1], most_acceleration);
        let mut speed = in_units(speed, self.speed_unit(registers), most_speed);
        if speed == 0 && (self.stops_at_0(registers) || self.needs_speed && acceleration > 0) {
            speed = most_speed;
        }
        let mut goal = unknown();
        let parts = [place, speed, acceleration];
        self.goal_parts.into_iter().zip(parts).for_each(|(field, part)| self.set(&mut goal, field, part));
        goal.into_iter().skip(self.goal.0.into()).take(self.goal.1.into()).collect()
    }

    /// The unit of speed of this servo, in steps/s.
    pub fn speed_unit(&self, registers: &Registers) -> f32 {
        let model = self.model(registers);
        let other = self.other_speed_units.iter().find(|(other, _)| *other == model);
        let unit = other.map_or(self.units[0], |(_, unit)| *unit);
        if self.has(self.fine_speed, registers) { unit / f32::from(FINE) } else { unit }
    }

    /// The highest numbers of units of speed and acceleration that this servo takes.
    fn most_units(&self, registers: &Registers) -> [u32; 2] {
        let [mut speed, mut acceleration] = self.most_units;
        if self.has(self.fine_speed, registers) {
            speed *= u32::from(FINE);
        }
        let [own_speed, own_acceleration] = self.own_limits.map(|field| self.get(registers, field));
        if own_speed > 0 {
            speed = speed.min(own_speed);
        }
        if own_acceleration > 0 {
            acceleration = acceleration.min(own_acceleration);
        }
        [speed, acceleration]
    }

    fn stops_at_0(&self, registers: &Registers) -> bool {
        self.zero_is_no_limit.1 > 0 && !self.has(self.zero_is_no_limit, registers)
    }

    fn has(&self, (address, weight): Bit, registers: &Registers) -> bool {
        self.get(registers, (address, 1)) & weight > 0
    }

    /// The lowest and the highest place that the servo allows, and that the family has.
    pub fn limits(&self, registers: &Registers) -> [u32; 2] {
        let [least, most] = self.limits.map(|field| self.get(registers, field));
        [least, most.min(self.most_steps.into())]
    }

    /// Where the servo is, or the nearer limit if it is beyond its limits, where no goal may be.
    pub fn place(&self, registers: &Registers) -> f32 {
        let (place, [least, most]) = (self.get(registers, self.place), self.limits(registers));
        // The sign of Feetech is bit 15, and that of four bytes bit 31.
        let is_negative = place >> (8 * u32::from(self.place.1) - 1) > 0;
        (if is_negative { least } else { place.min(most).max(least) }) as f32
    }

    pub fn model(&self, registers: &Registers) -> u32 {
        self.get(registers, self.model)
    }

    fn has_model(&self, registers: &Registers) -> bool {
        self.models.iter().any(|models| models.contains(&self.model(registers)))
    }

    fn meets(&self, (address, bits, values, _): &Need, registers: &Registers) -> bool {
        let byte = registers.get(usize::from(*address)).map_or(0, |byte| byte & bits);
        values.iter().any(|values| values.contains(&byte))
    }

    /// Whether the first registers are those of a servo of this family with this number, of its byte order and its series.
    pub fn is_of_family(&self, registers: &Registers, id: u8) -> bool {
        let is_of_series = self.needs.iter().filter(|need| need.0 < 5).all(|need| self.meets(need, registers));
        is_of_series && self.has_model(registers) && self.get(registers, self.id) == u32::from(id)
    }

    /// Why a servo with these registers is not moved, if there is a reason.
    pub fn refusal(&self, registers: &Registers, ends: [f32; 2]) -> Option<String> {
        let (model, [least, most]) = (self.model(registers), self.limits(registers));
        if !self.has_model(registers) {
            return Some(format!("its model {model} is not one of {}: set another family", self.name));
        }
        if let Some((.., remedy)) = self.needs.iter().find(|need| !self.meets(need, registers)) {
            return Some((*remedy).to_owned());
        }
        if least >= most {
            let remedy = "set it to position control, with the maker's program";
            return Some(format!("its limits are {least} and {most}: {remedy}"));
        }
        let end = ends.into_iter().find(|end| *end < least as f32 || *end > most as f32)?;
        let remedy = "change the end, or its limits";
        Some(format!("an end is at {end:.0} steps, but the servo allows {least} to {most}: {remedy}"))
    }

    /// The first alarm that a servo has, in words; `error` is the error byte of its answer.
    pub fn alarm(&self, registers: &Registers, error: u8) -> Option<&'static str> {
        let alarms = if self.alarms == NONE { error.into() } else { self.get(registers, self.alarms) };
        let mut known = (0..).zip(self.alarm_bits).filter(|(_, name)| !name.is_empty());
        known.find(|(bit, _)| alarms >> bit & 1 > 0).map(|(_, alarm)| alarm)
    }

    /// Volts, degrees Celsius, and load from 0 to 1. NaN stands for what the servo does not tell, or has not told yet.
    pub fn health(&self, registers: &Registers) -> [f32; 3] {
        let told =
            |field, number| if field != NONE && self.get(registers, self.volts[0]) > 0 { number } else { f32::NAN };
        let [celsius, _, load] = self.celsius_and_load;
        let [volts, degrees, share] = [self.volts[0], celsius, load].map(|field| self.get(registers, field));
        [
            told(self.volts[0], volts as f32 / 10.0),
            told(celsius, degrees as f32),
            told(load, ((share & 0x3FF) as f32 / 1000.0).min(1.0)),
        ]
    }

    /// What is wrong with a servo that has no alarm, if anything is.
    pub fn trouble(&self, registers: &Registers) -> Option<String> {
        let [volts, least, most] = self.volts.map(|field| self.get(registers, field));
        let [celsius, hottest, load] = self.celsius_and_load.map(|field| self.get(registers, field));
        if volts < least || volts > most {
            let volts = f64::from(volts) / 10.0;
            return Some(format!("its supply has {volts:.1} V: check the supply, and the cables for thin wires"));
        }
        if hottest > 0 && celsius + 5 >= hottest {
            let remedy = "give it less to hold, or set loss = \"release\"";
            return Some(format!("it is at {celsius} °C, and its limit is {hottest} °C: {remedy}"));
        }
        let is_loaded = load & 0x3FF >= 900;
        is_loaded.then(|| "it pushes with all its force: check its ends, and that nothing holds it".to_owned())
    }
}
