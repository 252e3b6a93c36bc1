//! Checks the reader of y4m streams.

use facewire::capture::Y4mSource;

use super::film::film;

/// Size of the smallest frame: the word `FRAME`, its line end and one sample.
const LEAST_FRAME_BYTES: usize = 7;

/// Checks the promises of [`film`] for y4m streams.
pub fn y4m(data: &[u8]) {
    film(data, LEAST_FRAME_BYTES, |pieces| Ok(Box::new(Y4mSource::open(pieces, "film")?)));
}
