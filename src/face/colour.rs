//! From luma and chroma to red, green and blue, all three in one word.
//!
//! BT.601 in the 13-bit fixed point of libswscale: each product is rounded down by itself. The landmark networks answer
//! visibly to half a level of brightness, so the same rounding is part of agreeing with MediaPipe.
//!
//! A pixel is a `u64` of three 21-bit channels, biased so that none is negative. Weights that add up to 1024 multiply
//! all channels at once: `(1023 + 1) * 1024` fits into 21 bits.

/// Bits of one channel.
const CHANNEL_BITS: u32 = 21;
/// Weights of a weighted sum add up to `1 << WEIGHT_BITS`.
const WEIGHT_BITS: u32 = 10;
/// Keeps channels positive: the darkest sum of one luma and two chroma terms is -277.
const BIAS: i32 = 288;
/// Bits behind the point of the factors, after samples are multiplied by 8.
const FACTOR_BITS: u32 = 16;

/// The share of each luma, Cb and Cr value in a pixel.
pub(super) struct Colour {
    luma: [u64; 256],
    blue: [u64; 256],
    red: [u64; 256],
}

/// Factors in 1/8192: of luma in all channels, of Cr in red, of Cb and Cr in green, of Cb in blue.
struct Factors {
    luma: i32,
    black: i32,
    red: i32,
    green: [i32; 2],
    blue: i32,
}

static FULL_RANGE: Colour =
    Colour::new(&Factors { luma: 8192, black: 0, red: 11485, green: [-2819, -5850], blue: 14516 });
static VIDEO_RANGE: Colour =
    Colour::new(&Factors { luma: 9539, black: 16, red: 13075, green: [-3209, -6660], blue: 16525 });

impl Colour {
    /// The conversion for pictures whose luma runs 0 to 255, or else 16 to 235.
    pub(super) fn of(full_range: bool) -> &'static Self {
        if full_range { &FULL_RANGE } else { &VIDEO_RANGE }
    }

    /// The pixel of one luma and two chroma samples.
    pub(super) fn pixel(&self, luma: u8, blue: u8, red: u8) -> u64 {
        // The tables have an entry for each value of a byte.
        let entry = |table: &[u64; 256], value: u8| table.get(usize::from(value)).copied().unwrap_or(0);
        entry(&self.luma, luma).wrapping_add(entry(&self.blue, blue)).wrapping_add(entry(&self.red, red))
    }

    #[expect(clippy::indexing_slicing, clippy::cast_possible_wrap, reason = "runs at compile time, over 256 values")]
    #[expect(clippy::cast_possible_truncation, reason = "256 fits")]
    const fn new(factors: &Factors) -> Self {
        let mut colour = Self { luma: [0; 256], blue: [0; 256], red: [0; 256] };
        let mut value = 0;
        while value < 256 {
            let luma = product(value as i32 - factors.black, factors.luma) + BIAS;
            let chroma = value as i32 - 128;
            colour.luma[value] = pack([luma; 3]);
            colour.blue[value] = pack([0, product(chroma, factors.green[0]), product(chroma, factors.blue)]);
            colour.red[value] = pack([product(chroma, factors.red), product(chroma, factors.green[1]), 0]);
            value += 1;
        }
        colour
    }
}

const fn product(sample: i32, factor: i32) -> i32 {
    (sample * 8 * factor) >> FACTOR_BITS
}

/// Negative channels borrow from their neighbours; the sum with luma pays that back, modulo 2^64.
#[expect(clippy::cast_sign_loss, reason = "two's complement is meant")]
const fn pack([red, green, blue]: [i32; 3]) -> u64 {
    let blue = (blue as i64 as u64) << (2 * CHANNEL_BITS);
    let green = (green as i64 as u64) << CHANNEL_BITS;
    (red as i64 as u64).wrapping_add(green).wrapping_add(blue)
}

/// A channel of full brightness, weighted.
pub(super) const WHITE: i32 = 255 << WEIGHT_BITS;

/// Red, green and blue of a sum of pixels whose weights add up to 1024: 0 is black, [`WHITE`] full brightness. Colours
/// that no screen shows lie beyond.
#[expect(clippy::cast_possible_truncation, reason = "21 bits")]
#[inline]
pub(super) fn channels(weighted: u64) -> [i32; 3] {
    const MASK: i32 = (1 << CHANNEL_BITS) - 1;
    [0, CHANNEL_BITS, 2 * CHANNEL_BITS].map(|shift| ((weighted >> shift) as i32 & MASK) - (BIAS << WEIGHT_BITS))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// BT.601 in floating point, full range.
    fn exact(luma: u8, blue: u8, red: u8) -> [f32; 3] {
        let [luma, blue, red] = [f32::from(luma), f32::from(blue) - 128.0, f32::from(red) - 128.0];
        [luma + 1.402 * red, luma - 0.344_136 * blue - 0.714_136 * red, luma + 1.772 * blue]
            .map(|value| value.clamp(0.0, 255.0))
    }

    /// Red, green and blue of one pixel, 0 to 255.
    fn rgb(pixel: u64) -> [f32; 3] {
        channels(pixel << WEIGHT_BITS).map(|level| level.clamp(0, WHITE) as f32 / 1024.0)
    }

    #[test]
    fn every_colour_is_bt601_to_two_levels() {
        for (luma, blue) in (0..=255).step_by(5).flat_map(|luma| (0..=255).step_by(5).map(move |blue| (luma, blue))) {
            for red in (0..=255).step_by(5) {
                let ours = rgb(FULL_RANGE.pixel(luma, blue, red));
                for (ours, exact) in ours.into_iter().zip(exact(luma, blue, red)) {
                    assert!((ours - exact).abs() <= 2.01, "{luma} {blue} {red}: {ours} {exact}");
                }
            }
        }
    }

    #[test]
    fn video_black_and_white_are_black_and_white() {
        assert!(rgb(VIDEO_RANGE.pixel(16, 128, 128)).iter().all(|level| *level < 0.01));
        assert!(rgb(VIDEO_RANGE.pixel(235, 128, 128)).iter().all(|level| *level > 254.99));
    }

    #[test]
    fn weighted_channels_do_not_leak_into_each_other() {
        let (blue, yellow) = (FULL_RANGE.pixel(29, 255, 107), FULL_RANGE.pixel(226, 0, 149));
        let mixed = rgb(blue.midpoint(yellow));
        for ((mixed, first), second) in mixed.into_iter().zip(rgb(blue)).zip(rgb(yellow)) {
            assert!((mixed - f32::midpoint(first, second)).abs() <= 2.0);
        }
    }
}
