//! Writes a recording.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write as _};
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;

use flate2::write::DeflateEncoder;
use flate2::{Compression, Crc};

use super::frame::{Recorded, Steps};
use super::{MAX_CHUNK_BYTES, START};

/// Time after which a chunk is written, microseconds.
const CHUNK_US: u64 = 1_000_000;
const MAX_FRAME_BYTES: usize = 8192;
/// Number of chunks after which the disk is asked to keep what it was given. More often would wear out memory cards.
const SYNC_CHUNKS: u32 = 10;

#[derive(Debug)]
pub struct Writer {
    file: File,
    limit_bytes: u64,
    written_bytes: u64,
    chunk: Vec<u8>,
    before: Box<Steps>,
    /// When the first frame was captured, and the first one of the chunk.
    begun_us: Option<(u64, u64)>,
    chunks: u32,
    /// Frames in the file, and those in the chunk.
    frames: u64,
    chunk_frames: u64,
}

impl Writer {
    /// Creates the file, which must not exist and which only its owner may read. No chunk is written that would make it larger than `limit_bytes`.
    pub fn create(path: &Path, limit_bytes: u64) -> io::Result<Self> {
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?;
        if let Err(error) = file.write_all(&START) {
            // An empty file would be in the way of the next attempt.
            let _ = fs::remove_file(path);
            return Err(error);
        }
        let (chunk, before) = (Vec::with_capacity(MAX_CHUNK_BYTES), Box::new(std::array::from_fn(|_| 0)));
        let (written_bytes, begun_us, chunks, frames, chunk_frames) = (START.len() as u64, None, 0, 0, 0);
        Ok(Self { file, limit_bytes, written_bytes, chunk, before, begun_us, chunks, frames, chunk_frames })
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

    /// Number of the frames that were given and not discarded.
    pub fn frames(&self) -> u64 {
        self.frames + self.chunk_frames
    }

    /// Writes what is left, and asks the disk to keep all of it. Returns the size of the file in bytes.
    pub fn finish(&mut self) -> io::Result<u64> {
        self.write_chunk()?;
        self.file.sync_data()?;
        Ok(self.written_bytes)
    }

    /// Writes the chunk, and begins another one. Returns `false` if there is no room for it; it is then discarded.
    fn write_chunk(&mut self) -> io::Result<bool> {
        if self.chunk.is_empty() {
            return Ok(true);
        }
        let mut encoder = DeflateEncoder::new(vec![0; 8], Compression::fast());
        encoder.write_all(&self.chunk)?;
        let mut bytes = encoder.finish()?;
        self.chunk.clear();
        let frames = std::mem::take(&mut self.chunk_frames);
        self.before.fill(0);
        let mut crc = Crc::new();
        crc.update(bytes.get(8..).unwrap_or_default());
        let length = u32::try_from(bytes.len() - 8).unwrap_or(u32::MAX);
        let head = [length.to_le_bytes(), crc.sum().to_le_bytes()];
        bytes.iter_mut().zip(head.as_flattened()).for_each(|(byte, head)| *byte = *head);
        if self.written_bytes + bytes.len() as u64 > self.limit_bytes {
            return Ok(false);
        }
        self.file.write_all(&bytes)?;
        self.written_bytes += bytes.len() as u64;
        self.frames += frames;
        self.chunks += 1;
        if self.chunks.is_multiple_of(SYNC_CHUNKS) {
            self.file.sync_data()?;
        }
        Ok(true)
    }
}
