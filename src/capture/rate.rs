//! Frame rates as the exact fractions that files and drivers state.

use std::fmt;
use std::ops::RangeInclusive;

/// Frames per second that are believed. Files with a slower or faster rate hold arbitrary numbers.
const BELIEVED_FPS: RangeInclusive<f64> = 0.1..=1000.0;
/// Denominator of the rates that [`FrameRate::from_fps`] returns.
const PRECISION: u32 = 1_000_000;

/// A rate of `frames` in `seconds`, between 0.1 and 1000 frames per second.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameRate {
    frames: u32,
    seconds: u32,
}

impl FrameRate {
    pub const FPS_30: Self = Self { frames: 30, seconds: 1 };

    /// Returns `None` if the rate is not between 0.1 and 1000 frames per second.
    pub fn new(frames: u32, seconds: u32) -> Option<Self> {
        let rate = Self { frames, seconds };
        (frames > 0 && seconds > 0 && BELIEVED_FPS.contains(&rate.fps())).then_some(rate)
    }

    /// Returns the rate nearest to `fps`, or `None` as [`FrameRate::new`].
    pub fn from_fps(fps: f64) -> Option<Self> {
        BELIEVED_FPS.contains(&fps).then_some(())?;
        Self::new((fps * f64::from(PRECISION)).round() as u32, PRECISION)
    }

    pub fn fps(self) -> f64 {
        f64::from(self.frames) / f64::from(self.seconds)
    }

    /// Number of frames, and the seconds that they take.
    pub fn fraction(self) -> [u32; 2] {
        [self.frames, self.seconds]
    }

    /// Time from one frame to the next in microseconds, rounded down.
    pub fn period_us(self) -> u64 {
        self.stamp_us(1)
    }

    /// Time of frame `number` in microseconds after frame 0, exact to 1 microsecond for streams of any length.
    pub fn stamp_us(self, number: u64) -> u64 {
        let us = u128::from(number) * 1_000_000 * u128::from(self.seconds) / u128::from(self.frames);
        u64::try_from(us).unwrap_or(u64::MAX)
    }
}

impl fmt::Display for FrameRate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} fps", (self.fps() * 100.0).round() / 100.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_do_not_drift_over_a_day_of_ntsc() {
        let ntsc = FrameRate::new(30_000, 1001).unwrap();
        assert_eq!(ntsc.stamp_us(30_000 * 86), 1_001_000_000 * 86);
        assert_eq!((ntsc.period_us(), ntsc.to_string().as_str()), (33_366, "29.97 fps"));
    }

    #[test]
    fn absurd_rates_are_refused() {
        for (frames, seconds) in [(0, 1), (1, 0), (1, 11), (u32::MAX, 1), (0, 0)] {
            assert_eq!(FrameRate::new(frames, seconds), None, "{frames}/{seconds}");
        }
        assert_eq!(FrameRate::new(1, 10).unwrap().period_us(), 10_000_000);
    }
}
