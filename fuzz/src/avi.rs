//! Checks the reader of Motion-JPEG AVI files, including the decoding of their frames.

use facewire::capture::{AviSource, FrameRate};

use super::film::film;

/// Size of the smallest frame: a chunk without content, which stands for a frame that the recorder dropped.
const LEAST_FRAME_BYTES: usize = 8;

/// Checks the promises of [`film`] for AVI files.
pub fn avi(data: &[u8]) {
    film(data, LEAST_FRAME_BYTES, |pieces| Ok(Box::new(AviSource::open(pieces, "film", FrameRate::FPS_30)?)));
}
