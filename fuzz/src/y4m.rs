//! The reader of y4m streams.

use facewire::capture::Y4mSource;

use super::film::film;

/// The word `FRAME`, its line end and one sample.
const LEAST_FRAME_BYTES: usize = 7;

/// See [`film`].
pub fn y4m(data: &[u8]) {
    film(data, LEAST_FRAME_BYTES, |pieces| Ok(Box::new(Y4mSource::open(pieces, "film")?)));
}
