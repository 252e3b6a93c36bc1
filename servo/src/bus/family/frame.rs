//! Frames of bus servos: Dynamixel's protocols 1.0 and 2.0 (<https://emanual.robotis.com/docs/en/dxl/protocol2/>). Feetech's
//! servos have those of 1.0.

const BROADCAST: u8 = 0xFE;
/// Begins a frame of protocol 2.0, and those of 1.0 with its first two bytes.
const HEADER: [u8; 4] = [0xFF, 0xFF, 0xFD, 0];
/// In the contents of a frame of protocol 2.0, these bytes are followed by another 0xFD, so that they begin no frame.
const STUFFED: [u8; 3] = [0xFF, 0xFF, 0xFD];
const STATUS: u8 = 0x55;
const CRC_POLYNOMIAL: u16 = 0x8005;
/// A servo of protocol 1.0 has a buffer of 143 bytes.
const FRAME_BYTES: [usize; 2] = [143, 1024];
const ANSWER_BYTES: usize = 256;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Protocol {
    One,
    Two,
}

/// The only instructions that servos get.
#[derive(Debug, Clone, Copy)]
enum Instruction {
    Read = 0x02,
    SyncWrite = 0x83,
}

/// Neighbouring registers that are read together: the first address, and how many bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block(pub u8, pub u8);

impl Block {
    /// Puts what an answer tells of these registers in its place.
    pub(in crate::bus) fn store(self, answer: &[u8], registers: &mut [u8]) {
        registers.iter_mut().skip(self.0.into()).zip(answer).for_each(|(to, from)| *to = *from);
    }
}

impl Protocol {
    /// Appends a question for registers. Its length differs from that of the answer, so that its echo is never taken for one.
    pub fn write_read(self, id: u8, Block(address, length): Block, out: &mut Vec<u8>) {
        match self {
            Self::One => self.write(id, Instruction::Read, [address, length], out),
            Self::Two => self.write(id, Instruction::Read, [address, 0, length, 0], out),
        }
    }

    /// Appends frames that write this many bytes from this address on, in each of the servos. Nobody answers.
    pub(super) fn write_sync<const N: usize>(
        self,
        address: u8,
        length: usize,
        servos: &[(u8, [u8; N])],
        out: &mut Vec<u8>,
    ) {
        let start: &[u8] = match self {
            Self::One => &[address, length as u8],
            Self::Two => &[address, 0, length as u8, 0],
        };
        let room = FRAME_BYTES.map(|most| (most - 14) / (length + 1));
        for servos in servos.chunks(if self == Self::One { room[0] } else { room[1] }.max(1)) {
            let data = servos.iter().flat_map(|(id, data)| [*id].into_iter().chain(data.iter().copied().take(length)));
            self.write(BROADCAST, Instruction::SyncWrite, start.iter().copied().chain(data), out);
        }
    }

    fn write(self, id: u8, instruction: Instruction, parameters: impl IntoIterator<Item = u8>, out: &mut Vec<u8>) {
        let begin = out.len();
        let contents = [instruction as u8].into_iter().chain(parameters);
        if self == Self::One {
            out.extend([0xFF, 0xFF, id, 0]);
            out.extend(contents);
            let length = out.len() - begin - 3;
            out.iter_mut().skip(begin + 3).take(1).for_each(|byte| *byte = length as u8);
            out.push(checksum(out.get(begin + 2..).unwrap_or_default()));
        } else {
            out.extend(HEADER.into_iter().chain([id, 0, 0]));
            for byte in contents {
                out.push(byte);
                if out.get(begin + 7..).is_some_and(|contents| contents.ends_with(&STUFFED)) {
                    out.push(0xFD);
                }
            }
            let length = (out.len() - begin - 5) as u16;
            out.iter_mut().skip(begin + 5).zip(length.to_le_bytes()).for_each(|(to, from)| *to = from);
            out.extend(crc(out.get(begin..).unwrap_or_default()).to_le_bytes());
        }
    }

    /// How long the frame is that these bytes begin, as soon as they tell. `None` if they begin none.
    fn length(self, bytes: &[u8]) -> Option<usize> {
        let (header, place) = if self == Self::One { (HEADER.get(..2)?, 3) } else { (&HEADER[..], 5) };
        if bytes.iter().zip(header).any(|(byte, header)| byte != header) {
            return None;
        }
        let length = match (self, bytes.get(place), bytes.get(place + 1)) {
            // An ID of 0xFF is the second byte of a header that begins later.
            (Self::One, ..) if bytes.get(2) == Some(&0xFF) => return None,
            (Self::One, Some(length), _) => 4 + usize::from(*length),
            (Self::Two, Some(low), Some(high)) => 7 + usize::from(u16::from_le_bytes([*low, *high])),
            _ => return Some(ANSWER_BYTES),
        };
        let least = if self == Self::One { 6 } else { 11 };
        (least..=ANSWER_BYTES).contains(&length).then_some(length)
    }
}

fn checksum(bytes: &[u8]) -> u8 {
    !bytes.iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte))
}

fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ u16::from(*byte) << 8, |crc: u16, _| (crc << 1) ^ ((crc >> 15) * CRC_POLYNOMIAL))
    })
}

/// What a servo answers.
#[derive(Debug, PartialEq, Eq)]
pub struct Status<'a> {
    pub id: u8,
    pub error: u8,
    pub data: &'a [u8],
}

/// Finds answers among bytes, in memory of its own.
pub struct Reader {
    protocol: Protocol,
    bytes: [u8; ANSWER_BYTES],
    length: usize,
    data: [u8; ANSWER_BYTES],
}

impl Reader {
    pub fn new(protocol: Protocol) -> Self {
        Self { protocol, bytes: [0; ANSWER_BYTES], length: 0, data: [0; ANSWER_BYTES] }
    }

    /// Forgets the beginning of a frame.
    pub fn clear(&mut self) {
        self.length = 0;
    }

    /// Takes a byte. Returns the answer that it completes, or `Err` for a damaged one.
    pub fn push(&mut self, byte: u8) -> Option<Result<Status<'_>, ()>> {
        let slot = self.bytes.get_mut(self.length)?;
        (*slot, self.length) = (byte, self.length + 1);
        let whole = loop {
            match self.protocol.length(self.bytes.get(..self.length)?) {
                Some(whole) => break whole,
                None => self.bytes.copy_within(1..self.length, 0),
            }
            self.length -= 1;
        };
        if self.length < whole {
            return None;
        }
        self.length = 0;
        Some(self.status(whole).ok_or(()))
    }

    fn status(&mut self, whole: usize) -> Option<Status<'_>> {
        let frame = self.bytes.get(..whole)?;
        let (id, contents) = match (self.protocol, frame) {
            (Protocol::One, [_, _, id, _, contents @ .., sum]) => {
                (checksum(frame.get(2..whole - 1)?) == *sum).then_some((*id, contents))?
            }
            (Protocol::Two, [_, _, _, _, id, _, _, STATUS, contents @ .., low, high]) => {
                let is_whole = crc(frame.get(..whole - 2)?) == u16::from_le_bytes([*low, *high]);
                is_whole.then_some((*id, contents))?
            }
            _ => return None,
        };
        let (error, stuffed) = contents.split_first()?;
        let is_two = self.protocol == Protocol::Two;
        let kept = (0..).zip(stuffed).filter(|(place, _): &(usize, _)| {
            !(is_two && *place >= 3 && stuffed.get(place - 3..=*place) == Some(&[0xFF, 0xFF, 0xFD, 0xFD]))
        });
        let length = self.data.iter_mut().zip(kept).map(|(to, (_, from))| *to = *from).count();
        Some(Status { id, error: *error, data: self.data.get(..length)? })
    }
}
