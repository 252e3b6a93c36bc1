//! Choosing from the modes a camera offers.

use std::fmt;

use super::super::FrameRate;

/// Share of the wished rate that counts as reaching it: 29.97 passes for 30.
const RATE_TOLERANCE: f64 = 0.98;

/// The pixel formats that are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PixelFormat {
    /// Packed 4:2:2.
    Yuyv,
    /// Luma plane and interleaved chroma plane, 4:2:0.
    Nv12,
    /// Motion-JPEG.
    Mjpeg,
    /// Separate JPEG images; the same to us.
    Jpeg,
    /// Luma only.
    Grey,
}

impl PixelFormat {
    /// In order of preference. Raw formats need no decoding; grey comes last, because the networks learnt in colour.
    pub const ALL: [Self; 5] = [Self::Yuyv, Self::Nv12, Self::Mjpeg, Self::Jpeg, Self::Grey];

    /// The kernel's four characters.
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

    /// The format of these four characters.
    #[must_use]
    pub fn of(fourcc: [u8; 4]) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.fourcc() == fourcc)
    }

    /// The name used in settings.
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

    /// The format of this name, in capitals or not.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name().eq_ignore_ascii_case(name))
    }
}

/// Values from `min` to `max`, `step` apart; a single one has `min == max`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Steps {
    /// Smallest.
    pub min: u32,
    /// Largest.
    pub max: u32,
    /// Distance, 0 if there is one value.
    pub step: u32,
}

impl Steps {
    /// One value.
    #[must_use]
    pub const fn one(value: u32) -> Self {
        Self { min: value, max: value, step: 0 }
    }

    /// The smallest value that is at least `wish`, else the largest there is.
    #[must_use]
    pub fn at_least(self, wish: u32) -> u32 {
        let step = self.step.max(1);
        let steps = wish.saturating_sub(self.min).div_ceil(step);
        let last = self.max.saturating_sub(self.min) / step;
        self.min.saturating_add(steps.min(last).saturating_mul(step))
    }
}

/// Frame rates from `slowest` to `fastest`; a single one has both alike.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rates {
    /// Fewest frames a second.
    pub slowest: FrameRate,
    /// Most frames a second.
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

/// A format with its sizes, and the rates it has at its largest size.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mode {
    /// Pixel format.
    pub format: PixelFormat,
    /// Pixels per row.
    pub width: Steps,
    /// Rows.
    pub height: Steps,
    /// Frames a second; empty if the driver does not say.
    pub rates: Vec<Rates>,
}

/// What is wanted of a camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wish {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frames a second.
    pub rate: FrameRate,
    /// Only this format, if given.
    pub format: Option<PixelFormat>,
}

/// One mode to set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Choice {
    /// Pixel format.
    pub format: PixelFormat,
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Frames a second, if the driver says which there are.
    pub rate: Option<FrameRate>,
}

/// The mode that serves `wish` best: first one that is fast enough, then one at least as large with the fewest pixels
/// beyond (else the largest), then the cheapest format, then the rate nearest above. `None` if no mode has the format.
#[must_use]
pub fn choose(modes: &[Mode], wish: &Wish) -> Option<Choice> {
    let candidates = modes.iter().filter(|mode| wish.format.is_none_or(|format| format == mode.format));
    candidates.flat_map(|mode| mode.choices(wish)).min_by_key(|choice| choice.cost(wish))
}

impl Mode {
    /// This mode at the size nearest to the wish, once for each of its rates.
    fn choices(&self, wish: &Wish) -> impl Iterator<Item = Choice> {
        let (width, height) = (self.width.at_least(wish.width), self.height.at_least(wish.height));
        let at = move |format, rate| Choice { format, width, height, rate };
        let unknown = self.rates.is_empty().then(|| at(self.format, None));
        let known = self.rates.iter().map(move |rates| at(self.format, Some(rates.nearest(wish.rate))));
        known.chain(unknown)
    }
}

impl Choice {
    /// Smaller is better, compared from left to right. A rate that the driver does not tell is taken for the wish.
    fn cost(&self, wish: &Wish) -> [u64; 5] {
        let (fps, wanted) = (self.rate.unwrap_or(wish.rate).fps(), wish.rate.fps());
        let short = if fps >= RATE_TOLERANCE * wanted { 0 } else { millihertz(wanted - fps) };
        let smaller = self.width < wish.width || self.height < wish.height;
        let pixels = u64::from(self.width) * u64::from(self.height);
        let distance = pixels.abs_diff(u64::from(wish.width) * u64::from(wish.height));
        let preference = PixelFormat::ALL.iter().position(|&format| format == self.format);
        [short, smaller.into(), distance, preference.map_or(u64::MAX, |at| at as u64), millihertz((fps - wanted).abs())]
    }
}

/// For comparing only. Rates lie between 0.1 and 1000.
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

/// `YUYV 640x480 at 30 fps, 15 fps`.
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
