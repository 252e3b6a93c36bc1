//! Frames of bus servos: Dynamixel's protocols 1.0 and 2.0 (<https://emanual.robotis.com/docs/en/dxl/protocol2/>). Feetech's
//! servos have those of 1.0.

use super::Field;

const BROADCAST: u8 = 0xFE;
/// Begins a frame of protocol 2.0, and those of 1.0 with its first two bytes.
const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0];
/// In the contents of a frame of protocol 2.0, these bytes are followed by another 0xFD, so that they begin no frame.
const STUFFED: &[u8] = &[0xFF, 0xFF, 0xFD];
/// The instructions that servos get, and the one of an answer by protocol 2.0.
pub const READ: u8 = 0x02;
pub const SYNC_WRITE: u8 = 0x83;
pub const STATUS: u8 = 0x55;
const CRC_POLYNOMIAL: u16 = 0x8005;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    One,
    Two,
}

/// What a frame carries. The first of its contents is the instruction, or the error of an answer by protocol 1.0.
#[derive(Debug, PartialEq, Eq)]
pub struct Frame {
    pub id: u8,
    pub contents: Vec<u8>,
}

impl Protocol {
    fn is_two(self) -> bool {
        self == Self::Two
    }

    /// The longest frame. A servo of protocol 1.0 has a buffer of 143 bytes.
    fn most_bytes(self) -> usize {
        if self.is_two() { 1024 } else { 143 }
    }

    /// Appends a question for registers. Its length differs from that of the answer, so that its echo is never taken for one.
    pub fn write_read(self, id: u8, field: Field, out: &mut Vec<u8>) {
        self.write(id, [&[READ][..], &self.parameters(field)].concat(), out);
    }

    /// Appends frames that write these registers in each of the servos, if the family has them. Nobody answers.
    pub(super) fn write_sync(self, field: Field, servos: &[(u8, Vec<u8>)], out: &mut Vec<u8>) {
        let servos = if field.1 > 0 { servos } else { &[] };
        for servos in servos.chunks((self.most_bytes() - 14) / (usize::from(field.1) + 1)) {
            let data = servos.iter().flat_map(|(id, data)| [&[*id][..], data].concat());
            let start = [&[SYNC_WRITE][..], &self.parameters(field)].concat();
            self.write(BROADCAST, start.into_iter().chain(data), out);
        }
    }

    /// The parameters of an instruction that name these registers.
    fn parameters(self, (address, length): Field) -> Vec<u8> {
        if self.is_two() { vec![address, 0, length, 0] } else { vec![address, length] }
    }

    /// The error and the data of an answer. Echoes of messages by protocol 1.0 look like answers, too.
    pub fn answer(self, frame: &Frame) -> Option<(u8, &[u8])> {
        match frame.contents.as_slice() {
            [STATUS, error, data @ ..] if self.is_two() => Some((*error, data)),
            [error, data @ ..] if !self.is_two() => Some((*error, data)),
            _ => None,
        }
    }

    pub fn write(self, id: u8, contents: impl IntoIterator<Item = u8>, out: &mut Vec<u8>) {
        let (mut body, begin) = (Vec::new(), out.len());
        for byte in contents {
            body.push(byte);
            if self.is_two() && body.ends_with(STUFFED) {
                body.push(0xFD);
            }
        }
        let [low, high] = (body.len() as u16 + if self.is_two() { 2 } else { 1 }).to_le_bytes();
        if self.is_two() {
            out.extend(HEADER.into_iter().chain([id, low, high]));
        } else {
            out.extend([0xFF, 0xFF, id, low]);
        }
        out.append(&mut body);
        let check = self.check(out.get(begin..).unwrap_or_default());
        out.extend(check);
    }

    /// The end of a frame: a checksum, or a CRC.
    fn check(self, frame: &[u8]) -> Vec<u8> {
        if self.is_two() {
            let shift = |crc: u16, _| (crc << 1) ^ ((crc >> 15) * CRC_POLYNOMIAL);
            let crc = frame.iter().fold(0, |crc, byte| (0..8).fold(crc ^ u16::from(*byte) << 8, shift));
            crc.to_le_bytes().to_vec()
        } else {
            vec![!frame.iter().skip(2).fold(0, |sum: u8, byte| sum.wrapping_add(*byte))]
        }
    }

    /// How many bytes to wait for: the frame, or first the part that tells its length. `None` if no frame begins here.
    fn length(self, bytes: &[u8]) -> Option<usize> {
        let (header, start) = if self.is_two() { (4, 7) } else { (2, 4) };
        let begins = bytes.iter().zip(HEADER).take(header).all(|(byte, header)| *byte == header);
        // An ID of 0xFF is the second byte of a header that begins later.
        if !begins || !self.is_two() && bytes.get(2) == Some(&0xFF) {
            return None;
        }
        let Some(length) = bytes.get(header + 1..start) else { return Some(start) };
        let rest = length.iter().rev().fold(0, |length, byte| length << 8 | usize::from(*byte));
        (start - header..self.most_bytes()).contains(&rest).then_some(start + rest)
    }

    fn frame(self, bytes: &[u8]) -> Option<Frame> {
        let (id, start, end) = if self.is_two() { (4, 7, 2) } else { (2, 4, 1) };
        let (body, check) = bytes.split_at_checked(bytes.len().checked_sub(end)?)?;
        let contents = body.get(start..).filter(|_| self.check(body) == check)?;
        let is_stuffing = |at: usize| self.is_two() && at >= 3 && contents.get(at - 3..at) == Some(STUFFED);
        let kept = (0..).zip(contents).filter(|(at, byte)| **byte != 0xFD || !is_stuffing(*at));
        Some(Frame { id: *body.get(id)?, contents: kept.map(|(_, byte)| *byte).collect() })
    }
}

/// Finds frames among bytes.
#[derive(Default)]
pub struct Reader(pub Vec<u8>);

impl Reader {
    /// Takes a byte. Returns the frame that it completes, or `Err` for a damaged one.
    pub fn push(&mut self, protocol: Protocol, byte: u8) -> Option<Result<Frame, ()>> {
        self.0.push(byte);
        let whole = loop {
            match protocol.length(&self.0) {
                Some(whole) => break whole,
                None => self.0.remove(0),
            };
        };
        (self.0.len() >= whole).then(|| protocol.frame(&std::mem::take(&mut self.0)).ok_or(()))
    }
}
