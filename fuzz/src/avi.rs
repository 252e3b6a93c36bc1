//! The reader of Motion-JPEG AVI files, with the decoding of their frames.

use facewire::capture::AviSource;

use super::film::film;

/// The header of a chunk, for a frame that the recorder dropped.
const LEAST_FRAME_BYTES: usize = 8;

/// See [`film`].
pub fn avi(data: &[u8]) {
    film(data, LEAST_FRAME_BYTES, |pieces| Ok(Box::new(AviSource::open(pieces, "film")?)));
}
