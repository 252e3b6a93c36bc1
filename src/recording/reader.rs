//! Reads a recording.

use std::fs::File;
use std::io::{self, BufReader, ErrorKind, Read};
use std::path::Path;

use flate2::Crc;
use flate2::read::DeflateDecoder;

use super::frame::{Recorded, Steps};
use super::{MAX_CHUNK_BYTES, RecordingError, START};

#[derive(Debug)]
pub struct Reader<R> {
    input: R,
    chunk: Vec<u8>,
    /// Number of bytes of the chunk that were read.
    read: usize,
    before: Box<Steps>,
    frames: u64,
}

impl Reader<BufReader<File>> {
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        Self::new(BufReader::new(File::open(path)?))
    }
}

impl<R: Read> Reader<R> {
    pub fn new(mut input: R) -> Result<Self, RecordingError> {
        let mut start = [0; START.len()];
        if !is_filled(&mut input, &mut start)? {
            return Err(RecordingError::Other);
        }
        let ([name @ .., version], [wanted_name @ .., wanted]) = (&start, &START);
        match (name == wanted_name, version > wanted) {
            (false, _) => return Err(RecordingError::Other),
            (true, true) => return Err(RecordingError::Version),
            (true, false) => {}
        }
        Ok(Self { input, chunk: Vec::new(), read: 0, before: Box::new(std::array::from_fn(|_| 0)), frames: 0 })
    }

    /// Returns the next frame, or `None` at the end. A chunk that was not written to its end is the end, because that is
    /// how a recording ends that was interrupted.
    pub fn next_frame(&mut self) -> Result<Option<Recorded>, RecordingError> {
        if self.read >= self.chunk.len() && !self.read_chunk()? {
            return Ok(None);
        }
        let mut bytes = self.chunk.get(self.read..).unwrap_or_default();
        let Some(frame) = Recorded::read(&mut bytes, &mut self.before) else { return Err(self.damaged()) };
        (self.read, self.frames) = (self.chunk.len() - bytes.len(), self.frames + 1);
        Ok(Some(frame))
    }

    /// Reads a chunk. Returns `false` if there is no complete one.
    fn read_chunk(&mut self) -> Result<bool, RecordingError> {
        let mut head = [[0; 4]; 2];
        if !is_filled(&mut self.input, head.as_flattened_mut())? {
            return Ok(false);
        }
        let [length, checksum] = head.map(u32::from_le_bytes);
        let length = usize::try_from(length).unwrap_or(usize::MAX);
        if length > MAX_CHUNK_BYTES {
            return Err(self.damaged());
        }
        let mut compressed = vec![0; length];
        if !is_filled(&mut self.input, &mut compressed)? {
            return Ok(false);
        }
        let mut crc = Crc::new();
        crc.update(&compressed);
        self.chunk.clear();
        let most = MAX_CHUNK_BYTES as u64 + 1;
        let read = DeflateDecoder::new(compressed.as_slice()).take(most).read_to_end(&mut self.chunk);
        let is_good = crc.sum() == checksum && read.is_ok() && (1..=MAX_CHUNK_BYTES).contains(&self.chunk.len());
        if !is_good {
            return Err(self.damaged());
        }
        self.read = 0;
        self.before.fill(0);
        Ok(true)
    }

    fn damaged(&mut self) -> RecordingError {
        self.chunk.clear();
        self.read = 0;
        RecordingError::Damaged { frames: self.frames }
    }
}

/// Fills the buffer. Returns `false` if the input ends before.
fn is_filled(input: &mut impl Read, buffer: &mut [u8]) -> io::Result<bool> {
    match input.read_exact(buffer) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests;
