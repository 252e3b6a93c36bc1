//! Converts luma and chroma to red, green and blue, which are packed into one word.
//!
//! The conversion is BT.601 in the 13-bit fixed point of libswscale, which rounds each product down by itself. Half a
//! level of brightness visibly moves the landmarks, so agreement with MediaPipe needs the same rounding.
//!
//! A pixel is a `u64` of three 21-bit channels. A bias keeps each channel between 0 and 1023, so that a multiplication
//! by a weight of at most 1024 scales all three at once, and sums whose weights add up to 1024 do not overflow a channel.

/// Bits of one channel.
const CHANNEL_BITS: u32 = 21;
/// The weights of a weighted sum add up to `1 << WEIGHT_BITS`.
const WEIGHT_BITS: u32 = 10;
/// Added to every channel so that none is negative. The darkest channel without it is -277.
const BIAS: i32 = 288;
/// Fractional bits of a product: 13 of the factor, and 3 because samples are multiplied by 8.
const PRODUCT_BITS: u32 = 16;

/// A conversion: what each value of luma, Cb and Cr adds to a pixel.
pub(super) struct Colour {
    luma: [u64; 256],
    cb: [u64; 256],
    cr: [u64; 256],
}

/// The factors of a conversion, in units of 1/8192.
struct Factors {
    /// Of luma, in all channels.
    luma: i32,
    /// The luma of black.
    black: i32,
    /// Of Cr in red.
    red: i32,
    /// Of Cb and Cr in green.
    green: [i32; 2],
    /// Of Cb in blue.
    blue: i32,
}

static FULL_RANGE: Colour =
    Colour::new(&Factors { luma: 8192, black: 0, red: 11485, green: [-2819, -5850], blue: 14516 });
static VIDEO_RANGE: Colour =
    Colour::new(&Factors { luma: 9539, black: 16, red: 13075, green: [-3209, -6660], blue: 16525 });

impl Colour {
    /// The conversion for pictures whose luma runs from 0 to 255 (`full_range`) or from 16 to 235.
    pub(super) fn for_range(full_range: bool) -> &'static Self {
        if full_range { &FULL_RANGE } else { &VIDEO_RANGE }
    }

    /// The pixel of one luma and two chroma samples.
    pub(super) fn pixel(&self, luma: u8, cb: u8, cr: u8) -> u64 {
        // A table has an entry for each value of a byte.
        let entry = |table: &[u64; 256], value: u8| table.get(usize::from(value)).copied().unwrap_or(0);
        entry(&self.luma, luma).wrapping_add(entry(&self.cb, cb)).wrapping_add(entry(&self.cr, cr))
    }

    #[expect(clippy::indexing_slicing, clippy::cast_possible_wrap, reason = "runs at compile time, over 256 values")]
    #[expect(clippy::cast_possible_truncation, reason = "256 fits")]
    const fn new(factors: &Factors) -> Self {
        let mut colour = Self { luma: [0; 256], cb: [0; 256], cr: [0; 256] };
        let mut value = 0;
        while value < 256 {
            let luma = product(value as i32 - factors.black, factors.luma) + BIAS;
            let chroma = value as i32 - 128;
            colour.luma[value] = pack([luma; 3]);
            colour.cb[value] = pack([0, product(chroma, factors.green[0]), product(chroma, factors.blue)]);
            colour.cr[value] = pack([product(chroma, factors.red), product(chroma, factors.green[1]), 0]);
            value += 1;
        }
        colour
    }
}

const fn product(sample: i32, factor: i32) -> i32 {
    (sample * 8 * factor) >> PRODUCT_BITS
}

/// Packs channels that may be negative. A negative channel borrows from its neighbour; adding luma with its bias returns
/// the loan, modulo 2^64.
#[expect(clippy::cast_sign_loss, reason = "two's complement is intended")]
const fn pack([red, green, blue]: [i32; 3]) -> u64 {
    let blue = (blue as i64 as u64) << (2 * CHANNEL_BITS);
    let green = (green as i64 as u64) << CHANNEL_BITS;
    (red as i64 as u64).wrapping_add(green).wrapping_add(blue)
}

/// Full brightness of a channel in a weighted sum.
pub(super) const WHITE: i32 = 255 << WEIGHT_BITS;

/// Unpacks red, green and blue from a sum of pixels whose weights add up to 1024. Black is 0 and full brightness is
/// [`WHITE`]; colours that a screen cannot show lie outside.
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
    fn exact(luma: u8, cb: u8, cr: u8) -> [f32; 3] {
        let [luma, cb, cr] = [f32::from(luma), f32::from(cb) - 128.0, f32::from(cr) - 128.0];
        [luma + 1.402 * cr, luma - 0.344_136 * cb - 0.714_136 * cr, luma + 1.772 * cb]
            .map(|value| value.clamp(0.0, 255.0))
    }

    /// Red, green and blue of one pixel, 0 to 255.
    fn rgb(pixel: u64) -> [f32; 3] {
        channels(pixel << WEIGHT_BITS).map(|level| level.clamp(0, WHITE) as f32 / 1024.0)
    }

    #[test]
    fn every_colour_is_within_two_levels_of_bt601() {
        let steps = || (0..=255).step_by(5);
        for (luma, cb) in steps().flat_map(|luma| steps().map(move |cb| (luma, cb))) {
            for cr in steps() {
                let ours = rgb(FULL_RANGE.pixel(luma, cb, cr));
                for (ours, exact) in ours.into_iter().zip(exact(luma, cb, cr)) {
                    assert!((ours - exact).abs() <= 2.01, "{luma} {cb} {cr}: {ours} {exact}");
                }
            }
        }
    }

    #[test]
    fn luma_16_and_235_of_a_video_are_black_and_white() {
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
