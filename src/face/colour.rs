//! The conversion from luma and chroma to red, green and blue.
//!
//! It is BT.601 in the 13-bit fixed point of libswscale, which rounds each product down by itself. Half a level of
//! brightness visibly moves the landmarks, so agreement with MediaPipe needs the same rounding.

use facewire_engine::kernels::convert::Factors;

static FULL_RANGE: Factors = Factors { luma: 8192, black: 0, red: 11485, green: [-2819, -5850], blue: 14516 };
static VIDEO_RANGE: Factors = Factors { luma: 9539, black: 16, red: 13075, green: [-3209, -6660], blue: 16525 };

/// The conversion for pictures whose luma runs from 0 to 255 (`full_range`) or from 16 to 235.
pub(super) fn factors(full_range: bool) -> &'static Factors {
    if full_range { &FULL_RANGE } else { &VIDEO_RANGE }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// BT.601 in floating point, full range.
    fn exact([luma, cb, cr]: [u8; 3]) -> [f32; 3] {
        let [luma, cb, cr] = [f32::from(luma), f32::from(cb) - 128.0, f32::from(cr) - 128.0];
        [luma + 1.402 * cr, luma - 0.344_136 * cb - 0.714_136 * cr, luma + 1.772 * cb]
    }

    #[test]
    fn every_colour_is_within_two_levels_of_bt601() {
        let steps = || (0..=255).step_by(5);
        for (luma, cb) in steps().flat_map(|luma| steps().map(move |cb| (luma, cb))) {
            for cr in steps() {
                let ours = FULL_RANGE.pixel([luma, cb, cr]);
                for (ours, exact) in ours.into_iter().zip(exact([luma, cb, cr])) {
                    assert!((f32::from(ours) - exact).abs() <= 2.01, "{luma} {cb} {cr}: {ours} {exact}");
                }
            }
        }
    }

    #[test]
    fn luma_16_and_235_of_a_video_are_black_and_white() {
        assert_eq!(VIDEO_RANGE.pixel([16, 128, 128]), [0, 0, 0, 0]);
        assert_eq!(VIDEO_RANGE.pixel([235, 128, 128]), [255, 255, 255, 0]);
    }

    #[test]
    fn every_channel_lies_within_the_range_of_a_pixel() {
        let ends = [0, 16, 128, 240, 255];
        for factors in [&FULL_RANGE, &VIDEO_RANGE] {
            for (cb, cr) in ends.iter().flat_map(|cb| ends.map(|cr| (*cb, cr))) {
                for luma in ends {
                    let pixel = factors.pixel([luma, cb, cr]);
                    assert!(pixel.iter().all(|channel| (-511..=1023).contains(channel)), "{pixel:?}");
                }
            }
        }
    }
}
