//! Chooses among the modes that a camera offers.

use std::fmt;

use super::super::FrameRate;
use super::layout::PixelFormat;

/// Share of the wanted rate that is fast enough, so that 29.97 counts as 30.
const RATE_TOLERANCE: f64 = 0.98;

/// Values from `min` to `max` in steps of `step`. A single value has `min == max` and `step == 0`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Steps {
    pub min: u32,
    pub max: u32,
    pub step: u32,
}

impl Steps {
    pub const fn one(value: u32) -> Self {
        Self { min: value, max: value, step: 0 }
    }

    /// The smallest value that is at least `wish`, or else the largest value.
    fn at_least(self, wish: u32) -> u32 {
        let step = self.step.max(1);
        let steps = wish.saturating_sub(self.min).div_ceil(step);
        let last = self.max.saturating_sub(self.min) / step;
        self.min.saturating_add(steps.min(last).saturating_mul(step))
    }
}

/// Frame rates from `slowest` to `fastest`. A single rate has `slowest == fastest`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rates {
    pub slowest: FrameRate,
    pub fastest: FrameRate,
}

/// A pixel format with its sizes, and the rates at its largest size. `rates` is empty if the driver does not list them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mode {
    pub format: PixelFormat,
    /// Widths and heights.
    pub size: [Steps; 2],
    pub rates: Vec<Rates>,
}

/// The mode that the settings ask for. Without a `format` all formats are acceptable.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Wish {
    pub width: u32,
    pub height: u32,
    pub rate: FrameRate,
    pub format: Option<PixelFormat>,
}

impl Wish {
    pub fn halved(&self) -> Self {
        Self { width: self.width / 2, height: self.height / 2, ..*self }
    }
}

/// The mode to set. The rate is known if the driver lists its rates.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Choice {
    pub format: PixelFormat,
    pub size: [u32; 2],
    pub rate: Option<FrameRate>,
}

/// Returns the best mode for `wish`, or `None` if no mode has the wanted format. The criteria are, in this order: the mode
/// is fast enough; it is at least as large as wanted; its number of pixels is nearest to the wanted one; its format comes
/// first in [`PixelFormat::ALL`]; its rate is nearest to the wanted one.
pub fn choose(modes: &[Mode], wish: &Wish) -> Option<Choice> {
    let candidates = modes.iter().filter(|mode| wish.format.is_none_or(|format| format == mode.format));
    candidates.flat_map(|mode| mode.choices(wish)).min_by_key(|choice| choice.cost(wish))
}

/// Whether the best mode for half the width and height of `wish` has at most half the pixels of `chosen`, and is as fast.
pub fn has_smaller(modes: &[Mode], wish: &Wish, chosen: &Choice) -> bool {
    choose(modes, &wish.halved()).is_some_and(|small| {
        let is_as_fast = chosen.rate.zip(small.rate).is_none_or(|(now, then)| then.fps() >= RATE_TOLERANCE * now.fps());
        is_as_fast && 2 * small.pixels() <= chosen.pixels()
    })
}

impl Mode {
    /// The mode at its best size for the wish, once for each range of rates.
    fn choices(&self, wish: &Wish) -> impl Iterator<Item = Choice> {
        let [width, height] = self.size;
        let format = self.format;
        let size = [width.at_least(wish.width), height.at_least(wish.height)];
        let unknown = self.rates.is_empty().then_some(Choice { format, size, rate: None });
        let nearest = |&Rates { slowest, fastest }: &Rates| match wish.rate.fps() {
            fps if fps <= slowest.fps() => slowest,
            fps if fps >= fastest.fps() => fastest,
            _ => wish.rate,
        };
        self.rates.iter().map(move |rates| Choice { format, size, rate: Some(nearest(rates)) }).chain(unknown)
    }
}

impl Choice {
    /// Returns a number for each criterion of [`choose`], in the same order; smaller numbers are better. A rate that the
    /// driver does not list counts as the wanted one.
    fn cost(&self, wish: &Wish) -> [u64; 5] {
        let fps = self.rate.unwrap_or(wish.rate).fps();
        let wanted = wish.rate.fps();
        let millihertz = |hertz: f64| (hertz * 1000.0).round() as u64;
        let short = if fps >= RATE_TOLERANCE * wanted { 0 } else { millihertz(wanted - fps) };
        let [width, height] = self.size;
        let smaller = width < wish.width || height < wish.height;
        let distance = self.pixels().abs_diff(u64::from(wish.width) * u64::from(wish.height));
        let preference = PixelFormat::ALL.iter().take_while(|&&format| format != self.format).count();
        [short, smaller.into(), distance, preference as u64, millihertz((fps - wanted).abs())]
    }

    fn pixels(&self) -> u64 {
        self.size.map(u64::from).iter().product()
    }
}

impl fmt::Display for Steps {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.min == self.max { write!(f, "{}", self.min) } else { write!(f, "{}..{}", self.min, self.max) }
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [width, height] = self.size;
        write!(f, "{} {width}x{height}", self.format.name)?;
        for (at, Rates { slowest, fastest }) in self.rates.iter().enumerate() {
            f.write_str(if at == 0 { " at " } else { ", " })?;
            if slowest != fastest {
                write!(f, "{slowest} to ")?;
            }
            write!(f, "{fastest}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GREY: PixelFormat = PixelFormat::GREY;
    const JPEG: PixelFormat = PixelFormat::JPEG;
    const MJPEG: PixelFormat = PixelFormat::MJPEG;
    const NV12: PixelFormat = PixelFormat::NV12;
    const YUYV: PixelFormat = PixelFormat::YUYV;

    fn mode(format: PixelFormat, size: [u32; 2], rates: &[u32]) -> Mode {
        let rate = |fps: &u32| FrameRate::new(*fps, 1).unwrap();
        let rates = rates.iter().map(|fps| Rates { slowest: rate(fps), fastest: rate(fps) }).collect();
        Mode { format, size: size.map(Steps::one), rates }
    }

    fn wish(width: u32, height: u32, fps: u32) -> Wish {
        Wish { width, height, rate: FrameRate::new(fps, 1).unwrap(), format: None }
    }

    fn chosen(modes: &[Mode], wish: &Wish) -> String {
        let Choice { format, size: [width, height], rate } = choose(modes, wish).unwrap();
        let rate = rate.map_or("?".to_owned(), |rate| rate.to_string());
        format!("{} {width}x{height} {rate}", format.name)
    }

    /// The list of a common USB 2 webcam: raw pictures are slow at large sizes.
    fn webcam() -> Vec<Mode> {
        vec![
            mode(MJPEG, [1920, 1080], &[30, 15]),
            mode(MJPEG, [1280, 720], &[60, 30]),
            mode(MJPEG, [640, 480], &[60, 30]),
            mode(YUYV, [1920, 1080], &[5]),
            mode(YUYV, [1280, 720], &[10, 5]),
            mode(YUYV, [640, 480], &[30, 15]),
            mode(YUYV, [320, 240], &[30]),
        ]
    }

    #[test]
    fn raw_formats_are_chosen_where_they_are_fast_enough_and_jpeg_elsewhere() {
        let only = |format| Wish { format: Some(format), ..wish(640, 480, 30) };
        for (wish, expected) in [
            (wish(640, 480, 30), "YUYV 640x480 30 fps"),
            (wish(640, 480, 15), "YUYV 640x480 15 fps"),
            (wish(640, 480, 120), "MJPEG 640x480 60 fps"),
            (wish(1280, 720, 30), "MJPEG 1280x720 30 fps"),
            (wish(1280, 720, 10), "YUYV 1280x720 10 fps"),
            (wish(160, 120, 30), "YUYV 320x240 30 fps"),
            (wish(800, 600, 30), "MJPEG 1280x720 30 fps"),
            (wish(3840, 2160, 30), "MJPEG 1920x1080 30 fps"),
            (only(MJPEG), "MJPEG 640x480 30 fps"),
        ] {
            assert_eq!(chosen(&webcam(), &wish), expected, "{wish:?}");
        }
        assert_eq!((choose(&webcam(), &only(NV12)), choose(&[], &wish(640, 480, 30))), (None, None));
        let mut modes: Vec<_> = [GREY, JPEG, MJPEG, NV12, YUYV].map(|format| mode(format, [640, 480], &[30])).into();
        for expected in ["YUYV", "NV12", "MJPEG", "JPEG", "GREY"] {
            assert!(chosen(&modes, &wish(640, 480, 30)).starts_with(expected));
            modes.pop();
        }
    }

    #[test]
    fn ranges_of_sizes_and_rates_give_the_wanted_mode_and_an_unknown_rate_counts_as_the_wanted_one() {
        let slowest = wish(1, 1, 1).rate;
        let fastest = wish(1, 1, 60).rate;
        let ntsc = FrameRate::new(30_000, 1001).unwrap();
        let size = [2592, 1944].map(|max| Steps { min: 32, max, step: 2 });
        let with = |rates| [Mode { format: YUYV, size, rates }, mode(MJPEG, [640, 480], &[30])];
        let camera = with(vec![Rates { slowest, fastest }]);
        assert_eq!(camera[0].to_string(), "YUYV 32..2592x32..1944 at 1 fps to 60 fps");
        for (camera, wish, expected) in [
            (&camera, wish(640, 480, 30), "YUYV 640x480 30 fps"),
            (&camera, wish(641, 481, 90), "YUYV 642x482 60 fps"),
            (&camera, wish(9999, 16, 30), "YUYV 2592x32 30 fps"),
            (&with(vec![Rates { slowest: ntsc, fastest: ntsc }]), wish(640, 480, 30), "YUYV 640x480 29.97 fps"),
            (&with(vec![]), wish(640, 480, 30), "YUYV 640x480 ?"),
        ] {
            assert_eq!(chosen(camera, &wish), expected);
        }
        let at_least = |min, max, step, wish| Steps { min, max, step }.at_least(wish);
        assert_eq!(at_least(16, 100, 16, 99), 96);
        // No driver should state these.
        assert_eq!([at_least(16, 100, 0, 50), at_least(16, 10, 3, 50)], [50, 16]);
        assert_eq!(at_least(0, u32::MAX, u32::MAX, 1), u32::MAX);
    }

    #[test]
    fn a_smaller_mode_has_half_the_pixels_and_is_as_fast() {
        let is_smaller = |modes: &[Mode], wish: Wish| has_smaller(modes, &wish, &choose(modes, &wish).unwrap());
        assert!(is_smaller(&webcam(), wish(1280, 720, 30)) && is_smaller(&webcam(), wish(640, 480, 30)));
        assert!(!is_smaller(&webcam(), wish(640, 480, 60)), "320x240 has no 60 fps");
        assert!(!is_smaller(&webcam(), wish(320, 240, 30)), "the smallest already");
        assert!(!is_smaller(&[mode(MJPEG, [640, 480], &[30]), mode(MJPEG, [352, 288], &[15])], wish(640, 480, 30)));
    }
}
