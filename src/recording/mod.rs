//! Recordings: what `facewire record` keeps of each frame, and `facewire replay` and `facewire track` read. No picture is
//! kept.
//!
//! A recording begins with the eight bytes of [`START`]. Chunks of about a second follow, each with its length and its
//! CRC-32 (both u32, little-endian), compressed by DEFLATE. A program or a board that stops at any moment loses the chunk
//! that was not complete, and nothing else. A chunk holds frames one after the other:
//!
//! | size | field |
//! |---|---|
//! | 8 | u64 time since the first frame, microseconds |
//! | 132 | what receivers were to show, as a facewire packet: live, or neutral with the reason why there is no pose |
//! | 4 | u16 width and u16 height of the picture in pixels, both 0 if there are no landmarks |
//! | 1434 to 7170 | 478 x 3 landmarks: the difference to the frame before in the chunk, or to 0, in 1/32 pixel, zigzag, LEB128 |

mod frame;

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufReader, ErrorKind, Read, Seek as _, Write as _};
use std::mem::take;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use flate2::{Compression, Crc};

pub use self::frame::Recorded;
use self::frame::{MAX_FRAME_BYTES, Steps};

/// The first bytes of a recording; the last one is the version.
const START: [u8; 8] = *b"FWREC\0\0\x01";
const MAX_CHUNK_BYTES: usize = 1 << 20;
/// Time after which a chunk is written, microseconds.
const CHUNK_US: u64 = 1_000_000;
/// Number of chunks after which the file is synced to the disk. To sync more often would wear out memory cards.
const SYNC_CHUNKS: u32 = 10;

#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    #[error("it is no recording of facewire; give a file that `facewire record` has made")]
    Other,
    #[error("it was made by a later version of facewire; use that version, or a later one")]
    Version,
    /// A chunk is too long, does not match its checksum, or does not hold whole frames.
    #[error("it is damaged after frame {frames}; the frames before that were used")]
    Damaged { frames: u64 },
    #[error("it cannot be read: {0}; check the path, its permissions and the disk")]
    Read(#[from] io::Error),
}

#[derive(Debug)]
pub struct Writer {
    file: File,
    left_bytes: u64,
    chunk: Vec<u8>,
    before: Box<Steps>,
    /// Times of capture of the first frame and of the first one of the chunk, microseconds.
    begun_us: Option<(u64, u64)>,
    chunks: u32,
    /// Frames in the file, and those in the chunk.
    frames: u64,
    chunk_frames: u64,
}

impl Writer {
    /// Creates the file, which must not exist and which only its owner may read. No chunk is written that would make it
    /// larger than `limit_bytes`.
    pub fn create(path: &Path, limit_bytes: u64) -> io::Result<Self> {
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?;
        if let Err(error) = file.write_all(&START) {
            // An empty file would be in the way of the next attempt.
            let _ = fs::remove_file(path);
            return Err(error);
        }
        Ok(Self {
            file,
            left_bytes: limit_bytes.saturating_sub(START.len() as u64),
            chunk: Vec::with_capacity(MAX_CHUNK_BYTES),
            before: Box::new(std::array::from_fn(|_| 0)),
            begun_us: None,
            chunks: 0,
            frames: 0,
            chunk_frames: 0,
        })
    }

    /// Adds a frame. Returns `false` if there is no room for it.
    pub fn push(&mut self, frame: &Recorded) -> io::Result<bool> {
        let (begun_us, chunk_us) = *self.begun_us.get_or_insert((frame.time_us, frame.time_us));
        let is_due = frame.time_us.saturating_sub(chunk_us) >= CHUNK_US;
        if is_due || self.chunk.len() + MAX_FRAME_BYTES > MAX_CHUNK_BYTES {
            if !self.write_chunk()? {
                return Ok(false);
            }
            self.begun_us = Some((begun_us, frame.time_us));
        }
        let time_us = frame.time_us.saturating_sub(begun_us);
        Recorded { time_us, ..frame.clone() }.write(&mut self.chunk, &mut self.before);
        self.chunk_frames += 1;
        Ok(true)
    }

    /// Number of the frames that were added and not discarded.
    pub fn frames(&self) -> u64 {
        self.frames + self.chunk_frames
    }

    /// Writes what is left, and asks the disk to keep all of it. Returns the size of the file in bytes.
    pub fn finish(&mut self) -> io::Result<u64> {
        self.write_chunk()?;
        self.file.sync_data()?;
        self.file.stream_position()
    }

    /// Writes the chunk, and begins another one. Returns `false` if there is no room for it; it is then discarded.
    fn write_chunk(&mut self) -> io::Result<bool> {
        if self.chunk.is_empty() {
            return Ok(true);
        }
        let mut encoder = DeflateEncoder::new(Vec::new(), Compression::fast());
        encoder.write_all(&self.chunk)?;
        let bytes = encoder.finish()?;
        self.chunk.clear();
        self.before.fill(0);
        let frames = take(&mut self.chunk_frames);
        let mut crc = Crc::new();
        crc.update(&bytes);
        let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        let bytes = [&length.to_le_bytes()[..], &crc.sum().to_le_bytes(), &bytes].concat();
        let Some(left_bytes) = self.left_bytes.checked_sub(bytes.len() as u64) else { return Ok(false) };
        self.file.write_all(&bytes)?;
        self.left_bytes = left_bytes;
        self.frames += frames;
        self.chunks += 1;
        if self.chunks.is_multiple_of(SYNC_CHUNKS) {
            self.file.sync_data()?;
        }
        Ok(true)
    }
}

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
        let is_whole = is_filled(&mut input, &mut start)?;
        let [name @ .., version] = &start;
        let [wanted_name @ .., wanted] = &START;
        if !is_whole || name != wanted_name {
            return Err(RecordingError::Other);
        }
        if version > wanted {
            return Err(RecordingError::Version);
        }
        Ok(Self { input, chunk: Vec::new(), read: 0, before: Box::new(std::array::from_fn(|_| 0)), frames: 0 })
    }

    /// Returns the next frame, or `None` at the end. An incomplete chunk counts as the end, because a recording that was
    /// interrupted ends with one.
    pub fn next_frame(&mut self) -> Result<Option<Recorded>, RecordingError> {
        if self.read >= self.chunk.len() && !self.read_chunk()? {
            return Ok(None);
        }
        let mut bytes = self.chunk.get(self.read..).unwrap_or_default();
        let Some(frame) = Recorded::read(&mut bytes, &mut self.before) else { return Err(self.damaged()) };
        self.read = self.chunk.len() - bytes.len();
        self.frames += 1;
        Ok(Some(frame))
    }

    /// Reads a chunk. Returns `false` if there is no complete one.
    fn read_chunk(&mut self) -> Result<bool, RecordingError> {
        let mut head = [[0; 4]; 2];
        if !is_filled(&mut self.input, head.as_flattened_mut())? {
            return Ok(false);
        }
        let [length, checksum] = head.map(u32::from_le_bytes);
        if length as usize > MAX_CHUNK_BYTES {
            return Err(self.damaged());
        }
        let mut compressed = vec![0; length as usize];
        if !is_filled(&mut self.input, &mut compressed)? {
            return Ok(false);
        }
        let mut crc = Crc::new();
        crc.update(&compressed);
        self.chunk.clear();
        let most = MAX_CHUNK_BYTES as u64 + 1;
        let read = DeflateDecoder::new(compressed.as_slice()).take(most).read_to_end(&mut self.chunk);
        if crc.sum() != checksum || read.is_err() || !(1..=MAX_CHUNK_BYTES).contains(&self.chunk.len()) {
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

/// Fills the buffer. Returns `false` if the input ends before it is full.
fn is_filled(input: &mut impl Read, buffer: &mut [u8]) -> io::Result<bool> {
    match input.read_exact(buffer) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(error),
    }
}

#[cfg(test)]
mod tests;
