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
mod reader;
mod writer;

use std::io;

pub use frame::Recorded;
pub use reader::Reader;
pub use writer::Writer;

/// The first bytes of a recording; the last one is the version.
pub const START: [u8; 8] = *b"FWREC\0\0\x01";
/// Most bytes of the frames of a chunk. A frame takes 7314 bytes at most.
const MAX_CHUNK_BYTES: usize = 1 << 20;

#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    #[error("it is no recording of facewire")]
    Other,
    #[error("it was made by a later version of facewire; use that version, or a later one")]
    Version,
    /// A chunk does not have its checksum, or holds no frames.
    #[error("it is damaged after frame {frames}; the frames before that were used")]
    Damaged { frames: u64 },
    #[error("it cannot be read: {0}")]
    Read(#[from] io::Error),
}
