//! A single servo, for programs that wait for its answers: they search a line, or find the ends of a servo.

use std::io::{self, ErrorKind, Read, Write};

use super::family::{FAMILIES, Family, Field, Reader, Registers, store, unknown};
use super::{Protocol, SILENT, START_DEGREES_PER_S};

/// What any servo has at the beginning of its registers: model and number.
const START: Field = (0, 8);
const MOST_BYTES: usize = 512;

/// Asks a servo, and waits for the port's timeout. Returns the error byte of its answer, or `None` without an answer.
fn ask(
    port: &mut (impl Read + Write),
    protocol: Protocol,
    id: u8,
    field: Field,
    registers: &mut Registers,
) -> io::Result<Option<u8>> {
    let (mut question, mut reader, mut byte) = (Vec::new(), Reader::default(), [0]);
    protocol.write_read(id, field, &mut question);
    port.write_all(&question)?;
    for _ in 0..MOST_BYTES {
        match port.read_exact(&mut byte) {
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => return Ok(None),
            read => read?,
        }
        if let Some(Ok(frame)) = reader.push(protocol, byte[0])
            && let Some((error, data)) = protocol.answer(&frame)
            && (frame.id, data.len()) == (id, usize::from(field.1))
        {
            store(field, data, registers);
            return Ok(Some(error));
        }
    }
    Ok(None)
}

/// Asks who has this number. Returns the model and the family, as far as they are known.
///
/// # Errors
/// If the port fails. A servo that does not answer is not an error.
pub fn find(
    port: &mut (impl Read + Write),
    protocol: Protocol,
    id: u8,
) -> io::Result<Option<(u32, Option<&'static Family>)>> {
    let mut registers = unknown();
    let is_there = ask(port, protocol, id, START, &mut registers)?.is_some();
    let is_of = |family: &&Family| family.protocol == protocol && family.is_of_family(&registers, id);
    let family = FAMILIES.iter().map(|(_, family)| *family).find(is_of);
    let model = family.unwrap_or(Family::DYNAMIXEL_X).model(&registers);
    Ok(is_there.then_some((model, family)))
}

/// A servo that a person moves slowly with keys.
pub struct Single<P> {
    port: P,
    family: &'static Family,
    id: u8,
    registers: Registers,
    is_on: bool,
}

impl<P: Read + Write> Single<P> {
    /// Reads what the servo is and where it stands. `Err` says why it is not moved.
    ///
    /// # Errors
    /// If the servo does not answer, has an alarm, or is not set to positions.
    pub fn open(mut port: P, family: &'static Family, id: u8) -> Result<Self, String> {
        let (mut registers, mut alarm, told) = (unknown(), None, |trouble: &str| format!("servo {id}: {trouble}"));
        for field in family.reads {
            let error = ask(&mut port, family.protocol, id, *field, &mut registers);
            let error = error.map_err(|error| error.to_string())?.ok_or_else(|| told(SILENT))?;
            alarm = family.alarm(&registers, error);
        }
        let servo = Self { port, family, id, registers, is_on: false };
        let refusal = family.refusal(&servo.registers, servo.reach());
        refusal.or(alarm.map(str::to_owned)).map_or(Ok(servo), |trouble| Err(told(&trouble)))
    }

    /// Where the servo stood, in steps.
    pub fn place(&self) -> f32 {
        self.family.place(&self.registers)
    }

    /// The lowest and the highest place that the servo allows.
    pub fn reach(&self) -> [f32; 2] {
        self.family.limits(&self.registers).map(|limit| limit as f32)
    }

    /// Moves the servo, or takes its torque.
    ///
    /// # Errors
    /// If the port fails, or the servo does not answer.
    pub fn set(&mut self, place: Option<f32>) -> io::Result<()> {
        let (family, mut message) = (self.family, Vec::new());
        let begins = place.is_some() && !self.is_on;
        if let ([.., field], true) = (family.reads, begins) {
            // It may have been turned by hand, and begins where it stands.
            if ask(&mut self.port, family.protocol, self.id, *field, &mut self.registers)?.is_none() {
                return Err(io::Error::new(io::ErrorKind::TimedOut, SILENT));
            }
            family.write_watchdog(&[self.id], false, &mut message);
        }
        if let Some(place) = place.map(|place| if begins { self.place() } else { place }) {
            let goal = family.goal([place, START_DEGREES_PER_S / family.degrees_per_step, 0.0], &self.registers);
            family.write_goals(&[(self.id, goal)], &mut message);
        }
        if begins || place.is_none() {
            family.write_torque(&[self.id], begins, &mut message);
        }
        self.is_on = place.is_some();
        self.port.write_all(&message)
    }
}
