//! One servo, by a program that waits for its answers: to find it, and to find its ends.

use std::io::{self, ErrorKind, Read, Write};

use super::family::{Block, Family, Goal, Kind, Order, Reader, Registers, Status};
use super::{Protocol, SILENT, START_DEGREES_PER_S, release};

/// What any servo has at the beginning of its registers: model and number.
const START: Block = Block(0, 8);
const MOST_BYTES: usize = 512;
const KINDS: [Kind; 5] = [Kind::DynamixelX, Kind::DynamixelAx, Kind::DynamixelMx, Kind::FeetechSts, Kind::FeetechScs];

/// Asks a servo, and waits until the port's own time is out. Returns nothing if it does not answer.
fn ask(port: &mut (impl Read + Write), protocol: Protocol, id: u8, block: Block) -> io::Result<Option<(u8, Vec<u8>)>> {
    let (mut question, mut reader, mut bytes) = (Vec::new(), Reader::new(protocol), [0; 64]);
    protocol.write_read(id, block, &mut question);
    port.write_all(&question)?;
    for _ in 0..MOST_BYTES {
        let length = match port.read(&mut bytes) {
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => return Ok(None),
            read => read?,
        };
        for byte in bytes.iter().take(length) {
            if let Some(Ok(Status { id: from, error, data })) = reader.push(*byte)
                && from == id
                && data.len() == usize::from(block.1)
            {
                return Ok(Some((error, data.to_vec())));
            }
        }
    }
    Ok(None)
}

/// Asks who has this number. Returns the model and the family, as far as they are known.
///
/// # Errors
/// If the port fails. A servo that does not answer is none.
pub fn find(port: &mut (impl Read + Write), protocol: Protocol, id: u8) -> io::Result<Option<(u32, Option<Kind>)>> {
    let Some((_, data)) = ask(port, protocol, id, START)? else { return Ok(None) };
    let mut registers: Registers = [0; 160];
    START.store(&data, &mut registers);
    let is_of = |kind: &Kind| kind.family().protocol == protocol && kind.family().has_start(&registers, id);
    let kind = KINDS.into_iter().find(is_of);
    Ok(Some((kind.unwrap_or(Kind::DynamixelX).family().model(&registers), kind)))
}

/// A servo that keys move, slowly.
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
    pub fn open(port: P, kind: Kind, id: u8) -> Result<Self, String> {
        let mut servo = Self { port, family: kind.family(), id, registers: [0; 160], is_on: false };
        let mut alarms = 0;
        for block in servo.family.blocks {
            let (error, data) = ask(&mut servo.port, servo.family.protocol, id, *block)
                .map_err(|error| error.to_string())?
                .ok_or_else(|| format!("servo {id}: {SILENT}"))?;
            block.store(&data, &mut servo.registers);
            alarms = servo.family.alarms(&servo.registers, error);
        }
        let refusal = servo.family.refusal(&servo.registers, servo.reach());
        let alarm = if alarms > 0 { servo.family.trouble(&servo.registers, alarms) } else { None };
        refusal.or(alarm).map_or(Ok(servo), |trouble| Err(format!("servo {id}: {trouble}")))
    }

    /// Where the servo stood, in steps.
    pub fn place(&self) -> f32 {
        self.family.position(&self.registers)
    }

    /// The lowest and the highest place that the servo allows.
    pub fn reach(&self) -> [f32; 2] {
        self.family.limits(&self.registers).map(|limit| limit as f32)
    }

    /// Moves the servo, or takes its torque.
    ///
    /// # Errors
    /// If the port fails.
    pub fn set(&mut self, place: Option<f32>) -> io::Result<()> {
        let (family, id, mut message) = (self.family, self.id, Vec::new());
        let goal = |servo: &Self, steps| {
            let goal = Goal { steps, steps_per_s: START_DEGREES_PER_S / family.degrees_per_step, steps_per_s2: 0.0 };
            (id, family.goal(goal, &servo.registers))
        };
        match place {
            None => release(family, [id], &mut message),
            Some(_) if !std::mem::replace(&mut self.is_on, true) => {
                // It may have been turned by hand, and begins where it stands.
                if let [.., block] = family.blocks
                    && let Some((_, data)) = ask(&mut self.port, family.protocol, id, *block)?
                {
                    block.store(&data, &mut self.registers);
                }
                let start = goal(self, self.place());
                family.write(&[(id, Order::watchdog(false)), start, (id, Order::torque(true))], &mut message);
            }
            Some(steps) => family.write(&[goal(self, steps)], &mut message),
        }
        self.is_on &= place.is_some();
        self.port.write_all(&message)
    }
}
