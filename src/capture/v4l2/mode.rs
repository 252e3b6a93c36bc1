//! Chooses among the modes that a camera offers.

use std::fmt;

use super::super::FrameRate;

/// Share of the wanted rate that is fast enough, so that 29.97 counts as 30.
const RATE_TOLERANCE: f64 = 0.98;

/// The pixel formats that are supported.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelFormat {
    /// Packed 4:2:2.
    Yuyv,
    /// A luma plane and a plane of interleaved chroma, 4:2:0.
    Nv12,
    /// Motion-JPEG.
    Mjpeg,
    /// Separate JPEG images, which are decoded like Motion-JPEG.
    Jpeg,
    /// Luma only.
    Grey,
}

impl PixelFormat {
    /// All formats in order of preference. Raw formats come first because they need no decoding, and grey comes last
    /// because the networks were trained on colour.
    pub const ALL: [Self; 5] = [Self::Yuyv, Self::Nv12, Self::Mjpeg, Self::Jpeg, Self::Grey];

    /// The four characters by which the kernel names the format.
    #[must_use]
    pub const fn fourcc(self) -> [u8; 4] {
        match self {
            Self::Yuyv => *b"YUYV",
            Self::Nv12 => *b"NV12",
            Self::Mjpeg => *b"MJPG",
            Self::Jpeg => *b"JPEG",
            Self::Grey => *b"GREY",
        }
    }

    /// The format that the kernel names by these four characters.
    #[must_use]
    pub fn of(fourcc: [u8; 4]) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.fourcc() == fourcc)
    }

    /// The name of the format in settings.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Yuyv => "YUYV",
            Self::Nv12 => "NV12",
            Self::Mjpeg => "MJPEG",
            Self::Jpeg => "JPEG",
            Self::Grey => "GREY",
        }
    }

    /// The format with this name, in upper or lower case.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name().eq_ignore_ascii_case(name))
    }
}

/// Values from `min` to `max` in steps of `step`. A single value has `min == max`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Steps {
    /// Smallest value.
    pub min: u32,
    /// Largest value.
    pub max: u32,
    /// Difference between neighbouring values; 0 for a single value.
    pub step: u32,
}

impl Steps {
    /// A single value.
    #[must_use]
    pub const fn one(value: u32) -> Self {
        Self { min: value, max: value, step: 0 }
    }

    /// The smallest value that is at least `wish`, or else the largest value.
    #[must_use]
    pub fn at_least(self, wish: u32) -> u32 {
        let step = self.step.max(1);
        let steps = wish.saturating_sub(self.min).div_ceil(step);
        let last = self.max.saturating_sub(self.min) / step;
        self.min.saturating_add(steps.min(last).saturating_mul(step))
    }
}

/// Frame rates from `slowest` to `fastest`. A single rate has `slowest == fastest`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rates {
    /// Slowest rate.
    pub slowest: FrameRate,
    /// Fastest rate.
    pub fastest: FrameRate,
}

impl Rates {
    /// The rate nearest to `wish`.
    fn nearest(self, wish: FrameRate) -> FrameRate {
        if wish.fps() <= self.slowest.fps() {
            self.slowest
        } else if wish.fps() >= self.fastest.fps() {
            self.fastest
        } else {
            wish
        }
    }
}

/// A pixel format with its sizes, and the rates at its largest size.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mode {
    /// Pixel format.
    pub format: PixelFormat,
    /// Pixels per row.
    pub width: Steps,
    /// Rows.
    pub height: Steps,
    /// Frame rates. Empty if the driver does not list them.
    pub rates: Vec<Rates>,
}

/// The mode that the settings ask for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wish {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frame rate.
    pub rate: FrameRate,
    /// The only acceptable format; `None` accepts all.
    pub format: Option<PixelFormat>,
}

impl Wish {
    /// The same wish with half the width and height.
    #[must_use]
    pub fn halved(&self) -> Self {
        Self { width: self.width / 2, height: self.height / 2, ..*self }
    }
}

/// The mode to set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Choice {
    /// Pixel format.
    pub format: PixelFormat,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frame rate, if the driver lists its rates.
    pub rate: Option<FrameRate>,
}

/// Returns the best mode for `wish`, or `None` if no mode has the wanted format. The criteria are, in this order: the mode
/// is fast enough; it is at least as large as wanted; its number of pixels is nearest to the wanted one; its format comes
/// first in [`PixelFormat::ALL`]; its rate is nearest to the wanted one.
#[must_use]
pub fn choose(modes: &[Mode], wish: &Wish) -> Option<Choice> {
    let candidates = modes.iter().filter(|mode| wish.format.is_none_or(|format| format == mode.format));
    candidates.flat_map(|mode| mode.choices(wish)).min_by_key(|choice| choice.cost(wish))
}

/// Whether the best mode for half the width and height of `wish` has at most half the pixels of `chosen`, and is as fast.
#[must_use]
pub fn has_smaller(modes: &[Mode], wish: &Wish, chosen: &Choice) -> bool {
    choose(modes, &wish.halved()).is_some_and(|small| {
        let is_as_fast = chosen.rate.zip(small.rate).is_none_or(|(now, then)| then.fps() >= RATE_TOLERANCE * now.fps());
        is_as_fast && 2 * small.pixels() <= chosen.pixels()
    })
}

impl Mode {
    /// The mode at its best size for the wish, once for each range of rates.
    fn choices(&self, wish: &Wish) -> impl Iterator<Item = Choice> {
        let (width, height) = (self.width.at_least(wish.width), self.height.at_least(wish.height));
        let at = move |format, rate| Choice { format, width, height, rate };
        let unknown = self.rates.is_empty().then(|| at(self.format, None));
        let known = self.rates.iter().map(move |rates| at(self.format, Some(rates.nearest(wish.rate))));
        known.chain(unknown)
    }
}

impl Choice {
    /// The criteria of [`choose`] from left to right, of which smaller values are better. A rate that the driver does not
    /// list counts as the wanted one.
    fn cost(&self, wish: &Wish) -> [u64; 5] {
        let (fps, wanted) = (self.rate.unwrap_or(wish.rate).fps(), wish.rate.fps());
        let short = if fps >= RATE_TOLERANCE * wanted { 0 } else { millihertz(wanted - fps) };
        let smaller = self.width < wish.width || self.height < wish.height;
        let distance = self.pixels().abs_diff(u64::from(wish.width) * u64::from(wish.height));
        let preference = PixelFormat::ALL.iter().position(|&format| format == self.format);
        [short, smaller.into(), distance, preference.map_or(u64::MAX, |at| at as u64), millihertz((fps - wanted).abs())]
    }
}

impl Choice {
    fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

/// Converts a rate between 0.1 and 1000 Hz into a number that can be ordered.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn millihertz(hertz: f64) -> u64 {
    (hertz * 1000.0).round() as u64
}

impl fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for Steps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.min == self.max { write!(f, "{}", self.min) } else { write!(f, "{}..{}", self.min, self.max) }
    }
}

impl fmt::Display for Rates {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.slowest == self.fastest {
            write!(f, "{}", self.fastest)
        } else {
            write!(f, "{} to {}", self.slowest, self.fastest)
        }
    }
}

/// Printed as `YUYV 640x480 at 30 fps, 15 fps`.
impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}x{}", self.format, self.width, self.height)?;
        for (at, rates) in self.rates.iter().enumerate() {
            write!(f, "{}{rates}", if at == 0 { " at " } else { ", " })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
