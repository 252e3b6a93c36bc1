//! The chunks of a RIFF stream, one after the other, without seeking.
//!
//! `RIFF` and `LIST` are reported and entered, whatever size they state: their content is chunks again. Only the end
//! of the outermost one is kept, to tell a complete file from one that is cut between two chunks.

use std::io::{self, Read};

use super::CaptureError;
use super::read::fill;

/// Bytes that [`Riff::read_start`] returns.
pub const START_BYTES: usize = 64;

/// What stands next in the stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Item {
    /// A `RIFF` or `LIST` of this kind begins.
    List {
        /// Its four characters.
        kind: [u8; 4],
    },
    /// A chunk; its content is to be read or skipped before the next item.
    Chunk {
        /// Its four characters.
        id: [u8; 4],
        /// Length of its content.
        bytes: u32,
    },
}

/// Why the stream stopped.
#[derive(Debug)]
pub enum Stop {
    /// It ends before it should.
    Cut {
        /// Bytes there are.
        offset: u64,
    },
    /// Reading failed.
    Read(io::Error),
}

impl Stop {
    /// As the error of a file that was at frame `frame`.
    pub fn in_frame(self, frame: u64) -> CaptureError {
        match self {
            Self::Cut { offset } => CaptureError::CutShort { frame, offset },
            Self::Read(error) => CaptureError::Read(error),
        }
    }
}

/// A RIFF stream being read.
#[derive(Debug)]
pub struct Riff<R> {
    reader: R,
    offset: u64,
    /// Where the present `RIFF` says it ends, if it does.
    end: Option<u64>,
    /// An odd chunk is followed by one byte of padding.
    padding: bool,
}

impl<R> Riff<R> {
    /// At the start of `reader`.
    pub fn new(reader: R) -> Self {
        Self { reader, offset: 0, end: None, padding: false }
    }

    /// The stream ends here, too soon.
    pub fn cut(&self) -> Stop {
        Stop::Cut { offset: self.offset }
    }
}

impl<R: Read> Riff<R> {
    /// The next list or chunk; `None` where the stream properly ends.
    pub fn next_item(&mut self) -> Result<Option<Item>, Stop> {
        if std::mem::take(&mut self.padding) {
            self.skip(1)?;
        }
        let complete = self.end.is_none_or(|end| self.offset >= end);
        let mut header = [0; 8];
        let got = self.fill(&mut header)?;
        if got < header.len() {
            return if complete && (got == 0 || self.end.is_some()) { Ok(None) } else { Err(self.cut()) };
        }
        let [a, b, c, d, size @ ..] = header;
        let (id, bytes) = ([a, b, c, d], u32::from_le_bytes(size));
        match &id {
            b"RIFF" => self.enter(Some(bytes)).map(Some),
            // What follows the last RIFF is no part of it.
            _ if complete && self.end.is_some() => Ok(None),
            b"LIST" => self.enter(None).map(Some),
            _ => {
                self.padding = bytes % 2 == 1;
                Ok(Some(Item::Chunk { id, bytes }))
            }
        }
    }

    /// Reads the kind of a list. A `RIFF` of 0 or the largest size was never finished: its end is not known.
    fn enter(&mut self, riff_bytes: Option<u32>) -> Result<Item, Stop> {
        if let Some(bytes) = riff_bytes {
            let stated = bytes != 0 && bytes != u32::MAX;
            self.end = stated.then_some(self.offset + u64::from(bytes));
        }
        let mut kind = [0; 4];
        let got = self.fill(&mut kind)?;
        if got < kind.len() { Err(self.cut()) } else { Ok(Item::List { kind }) }
    }

    /// The first bytes of a chunk, filled up with 0; the rest is skipped.
    pub fn read_start(&mut self, bytes: u32) -> Result<[u8; START_BYTES], Stop> {
        let mut start = [0; START_BYTES];
        let length = usize::try_from(bytes).map_or(START_BYTES, |bytes| bytes.min(START_BYTES));
        self.read(start.get_mut(..length).unwrap_or_default())?;
        if self.skip(u64::from(bytes) - length as u64)? { Ok(start) } else { Err(self.cut()) }
    }

    /// Reads as much of a chunk's content as `buffer` holds.
    pub fn read(&mut self, buffer: &mut [u8]) -> Result<(), Stop> {
        if self.fill(buffer)? == buffer.len() { Ok(()) } else { Err(self.cut()) }
    }

    /// Passes over a chunk's content; `false` if it is cut off.
    pub fn skip(&mut self, bytes: u64) -> Result<bool, Stop> {
        let passed = io::copy(&mut self.reader.by_ref().take(bytes), &mut io::sink()).map_err(Stop::Read)?;
        self.offset += passed;
        Ok(passed == bytes)
    }

    /// Fills `buffer` as far as the stream goes.
    fn fill(&mut self, buffer: &mut [u8]) -> Result<usize, Stop> {
        let filled = fill(&mut self.reader, buffer).map_err(Stop::Read)?;
        self.offset += filled as u64;
        Ok(filled)
    }
}
