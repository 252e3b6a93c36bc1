//! Reads the chunks of a RIFF stream one after the other, without seeking.
//!
//! A `RIFF` or a `LIST` holds chunks in turn. The reader reports it and continues with its content, whatever its size. It
//! only remembers where a `RIFF` ends, to tell a complete file from one that is cut off between two chunks.

use std::io::{self, Read};

use super::CaptureError;
use super::read::fill;

/// Number of bytes that [`Riff::read_start`] returns.
pub const START_BYTES: usize = 64;

/// The next part of the stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Item {
    /// The beginning of a `RIFF` or `LIST`.
    List {
        /// Four characters that name its kind.
        kind: [u8; 4],
    },
    /// A chunk, whose content the caller reads or skips before the next item.
    Chunk {
        /// Four characters that name its kind.
        id: [u8; 4],
        /// Length of its content.
        bytes: u32,
    },
}

/// Why the stream stopped.
#[derive(Debug)]
pub enum Stop {
    /// The stream is cut off.
    Cut {
        /// Length of the stream in bytes.
        offset: u64,
    },
    /// Reading failed.
    Read(io::Error),
}

impl Stop {
    /// Converts this into the error of a file that was cut off in frame `frame`.
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
    /// Offset at which the current `RIFF` ends, if it states a size.
    end: Option<u64>,
    /// Whether a byte of padding comes next, as after a chunk of odd length.
    padding: bool,
}

impl<R> Riff<R> {
    /// Starts at the current position of `reader`.
    pub fn new(reader: R) -> Self {
        Self { reader, offset: 0, end: None, padding: false }
    }

    /// The error of a stream that is cut off here.
    pub fn cut(&self) -> Stop {
        Stop::Cut { offset: self.offset }
    }
}

impl<R: Read> Riff<R> {
    /// Reads the beginning of the next list or chunk. Returns `None` at the proper end of the stream.
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
            // Data behind the last RIFF is not part of the film.
            _ if complete && self.end.is_some() => Ok(None),
            b"LIST" => self.enter(None).map(Some),
            _ => {
                self.padding = bytes % 2 == 1;
                Ok(Some(Item::Chunk { id, bytes }))
            }
        }
    }

    /// Reads the kind of a list. A `RIFF` of size 0 or of the largest size was not finished, so its end is not known.
    fn enter(&mut self, riff_bytes: Option<u32>) -> Result<Item, Stop> {
        if let Some(bytes) = riff_bytes {
            let stated = bytes != 0 && bytes != u32::MAX;
            self.end = stated.then_some(self.offset + u64::from(bytes));
        }
        let mut kind = [0; 4];
        let got = self.fill(&mut kind)?;
        if got < kind.len() { Err(self.cut()) } else { Ok(Item::List { kind }) }
    }

    /// Returns the first bytes of a chunk, with zeros behind a shorter one, and skips the rest.
    pub fn read_start(&mut self, bytes: u32) -> Result<[u8; START_BYTES], Stop> {
        let mut start = [0; START_BYTES];
        let length = usize::try_from(bytes).map_or(START_BYTES, |bytes| bytes.min(START_BYTES));
        self.read(start.get_mut(..length).unwrap_or_default())?;
        if self.skip(u64::from(bytes) - length as u64)? { Ok(start) } else { Err(self.cut()) }
    }

    /// Fills `buffer` with the content of a chunk.
    pub fn read(&mut self, buffer: &mut [u8]) -> Result<(), Stop> {
        if self.fill(buffer)? == buffer.len() { Ok(()) } else { Err(self.cut()) }
    }

    /// Skips the content of a chunk. Returns `false` if it is cut off.
    pub fn skip(&mut self, bytes: u64) -> Result<bool, Stop> {
        let passed = io::copy(&mut self.reader.by_ref().take(bytes), &mut io::sink()).map_err(Stop::Read)?;
        self.offset += passed;
        Ok(passed == bytes)
    }

    /// Fills `buffer`, or its first part if the stream ends before. Returns the number of bytes.
    fn fill(&mut self, buffer: &mut [u8]) -> Result<usize, Stop> {
        let filled = fill(&mut self.reader, buffer).map_err(Stop::Read)?;
        self.offset += filled as u64;
        Ok(filled)
    }
}
