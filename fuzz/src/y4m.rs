//! Checks the reader of y4m streams.

use std::io::BufReader;

use facewire::capture::FrameRate;

use self::source::Y4mSource;
use super::film::film;

// A reader of `facewire track` alone, which the service does not have.
#[path = "../../tools/src/input/y4m.rs"]
mod source;

/// Size of the smallest frame: the word `FRAME`, its line end and one sample.
const LEAST_FRAME_BYTES: usize = 7;

/// Checks the promises of [`film`] for y4m streams.
pub fn y4m(data: &[u8]) {
    film(data, LEAST_FRAME_BYTES, |pieces| {
        Ok(Box::new(Y4mSource::open(BufReader::new(pieces), "film", FrameRate::FPS_30)?))
    });
}
