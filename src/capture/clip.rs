//! The clip that is built into the program: 240 frames of a rendered face, 640 x 480 pixels, 30 frames per second.

use super::open::DEMO;
use super::{AviSource, CaptureError, Description, Frame, Source};

static DEMO_AVI: &[u8] = include_bytes!("demo.avi");

/// The built-in clip as a source.
#[derive(Debug)]
pub struct Clip {
    film: AviSource<&'static [u8]>,
    looped: bool,
}

impl Clip {
    /// Opens the clip, to be played once.
    ///
    /// # Errors
    /// [`CaptureError::Decoder`] without memory.
    pub fn once() -> Result<Self, CaptureError> {
        Ok(Self { film: AviSource::open(DEMO_AVI, DEMO)?, looped: false })
    }

    /// Opens the clip, to be repeated for ever. Frame numbers and times continue to grow.
    ///
    /// # Errors
    /// [`CaptureError::Decoder`] without memory.
    pub fn looped() -> Result<Self, CaptureError> {
        Ok(Self { looped: true, ..Self::once()? })
    }

    fn advance(&mut self) -> Result<bool, CaptureError> {
        if self.film.advance()? {
            return Ok(true);
        }
        if self.looped {
            self.film.rewind(DEMO_AVI)?;
        }
        self.film.advance()
    }
}

impl Source for Clip {
    fn next(&mut self) -> Result<Option<Frame<'_>>, CaptureError> {
        if self.advance()? { self.film.decoded().map(Some) } else { Ok(None) }
    }

    fn skip(&mut self) -> Result<bool, CaptureError> {
        self.advance()
    }

    fn frame_period_us(&self) -> Option<u64> {
        self.film.frame_period_us()
    }

    fn describe(&self) -> Description<'_> {
        self.film.describe()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn the_clip_has_240_frames_and_30_of_them_per_second() {
        let mut clip = Clip::once().unwrap();
        assert_eq!(clip.describe().to_string(), "demo: MJPEG 640x480 at 30 fps");
        let mut last = 0;
        for number in 0..240 {
            let frame = clip.next().unwrap().unwrap();
            assert_eq!((frame.number, frame.size_px()), (number, [640.0, 480.0]));
            last = frame.captured_us;
        }
        assert_eq!(last, 7_966_666);
        assert!(clip.next().unwrap().is_none());
        assert!(clip.next().unwrap().is_none());
    }

    #[test]
    fn the_looped_clip_repeats_its_pictures_while_numbers_and_times_grow() {
        let mut clip = Clip::looped().unwrap();
        let first = luma_sum(&clip.next().unwrap().unwrap());
        for _ in 1..240 {
            assert!(clip.skip().unwrap());
        }
        let again = clip.next().unwrap().unwrap();
        assert_eq!((again.number, again.captured_us), (240, 8_000_000));
        assert_eq!(luma_sum(&again), first);
    }

    fn luma_sum(frame: &Frame<'_>) -> u64 {
        let super::super::Pixels::Planar { planes: [luma, ..], .. } = frame.picture().unwrap().pixels else {
            return 0;
        };
        luma.iter().copied().map(u64::from).sum()
    }
}
