//! Sixteen pixels at a time with NEON.

use std::arch::aarch64::{
    int16x8_t, int16x8x4_t, uint8x8_t, uint8x16_t, uint8x16x3_t, uint8x16x4_t, vaddq_s16, vcombine_u8, vdupq_n_s16,
    vdupq_n_s32, vdupq_n_u8, vget_high_u8, vget_low_u8, vld1_u8, vld1q_u8, vld2q_u8, vld3q_u8, vld4q_u8, vmovl_u8,
    vqdmulhq_s16, vreinterpretq_s16_s32, vreinterpretq_s16_u16, vrev32q_s16, vshll_n_u8, vst4q_s16, vsubq_s16,
    vtrn1q_s16, vtrn2q_s16, vzip1_u8, vzip2_u8,
};

use super::{Factors, GROUP, NO_COLOUR, Packing, Pixel, Samples};

/// See [`super::Converter`].
///
/// # Safety
/// The processor must have NEON, and there must be samples for all pixels.
#[target_feature(enable = "neon")]
pub(super) unsafe fn convert(factors: &Factors, samples: &Samples, output: &mut [[Pixel; GROUP]]) {
    let constants = Constants::new(factors);
    // SAFETY: there are samples for all pixels: for 16 of them 32 bytes, or 16 of each plane, or 8 where two pixels
    // share a sample.
    unsafe {
        let sixteen = |plane: &[u8], group: usize| vld1q_u8(plane.as_ptr().add(group * GROUP));
        match samples {
            Samples::Yuyv(samples) => constants.convert(output, |group| {
                let both = vld2q_u8(samples.as_ptr().add(group * 2 * GROUP));
                (both.0, both.1)
            }),
            Samples::SemiPlanar(luma, chroma) => {
                constants.convert(output, |group| (sixteen(luma, group), sixteen(chroma, group)));
            }
            Samples::Planar([luma, cb, cr]) => constants.convert(output, |group| {
                let [cb, cr] = [cb, cr].map(|plane| vld1_u8(plane.as_ptr().add(group * GROUP / 2)));
                (sixteen(luma, group), vcombine_u8(vzip1_u8(cb, cr), vzip2_u8(cb, cr)))
            }),
            Samples::Grey(luma) => {
                constants.convert(output, |group| (sixteen(luma, group), vdupq_n_u8(NO_COLOUR)));
            }
        }
    }
}

/// See [`super::Unpacker`].
///
/// # Safety
/// The processor must have NEON, a pixel must have three or four bytes, and there must be bytes for all pixels.
#[target_feature(enable = "neon")]
pub(super) unsafe fn unpack(row: &[u8], Packing { step, rgb }: Packing, output: &mut [[Pixel; GROUP]]) {
    for (group, pixels) in output.iter_mut().enumerate() {
        // SAFETY: a group has sixteen pixels, and each half of its output takes four vectors.
        unsafe {
            let from = row.as_ptr().add(group * GROUP * step);
            let channels = if step == 3 {
                let uint8x16x3_t(first, second, third) = vld3q_u8(from);
                [first, second, third, third]
            } else {
                let uint8x16x4_t(first, second, third, fourth) = vld4q_u8(from);
                [first, second, third, fourth]
            };
            let [red, green, blue] = rgb.map(|place| channels[place]);
            let eight = |half: fn(uint8x16_t) -> uint8x8_t| {
                let [red, green, blue] =
                    [red, green, blue].map(|channel| vreinterpretq_s16_u16(vmovl_u8(half(channel))));
                int16x8x4_t(red, green, blue, vdupq_n_s16(0))
            };
            let to = pixels.as_mut_ptr();
            vst4q_s16(to.cast(), eight(|channel| vget_low_u8(channel)));
            vst4q_s16(to.add(GROUP / 2).cast(), eight(|channel| vget_high_u8(channel)));
        }
    }
}

/// The vectors that are the same for all groups. Factors of Cb and Cr alternate.
struct Constants {
    luma: int16x8_t,
    black: int16x8_t,
    blue_red: int16x8_t,
    green: int16x8_t,
}

impl Constants {
    #[inline]
    #[target_feature(enable = "neon")]
    fn new(factors: &Factors) -> Self {
        let pair =
            |[cb, cr]: [i16; 2]| vreinterpretq_s16_s32(vdupq_n_s32(i32::from(cr) << 16 | i32::from(cb) & 0xffff));
        Self {
            luma: vdupq_n_s16(factors.luma),
            black: vdupq_n_s16(4 * factors.black),
            blue_red: pair([factors.blue, factors.red]),
            green: pair(factors.green),
        }
    }

    /// Converts groups. `load` returns luma of the sixteen pixels of a group, and Cb and Cr of every two of them.
    #[inline]
    #[target_feature(enable = "neon")]
    fn convert(&self, output: &mut [[Pixel; GROUP]], load: impl Fn(usize) -> (uint8x16_t, uint8x16_t)) {
        for (group, pixels) in output.iter_mut().enumerate() {
            let (luma, chroma) = load(group);
            let first = self.eight_pixels(vget_low_u8(luma), vget_low_u8(chroma));
            let last = self.eight_pixels(vget_high_u8(luma), vget_high_u8(chroma));
            let to = pixels.as_mut_ptr();
            // SAFETY: each half of a group takes four vectors.
            unsafe {
                vst4q_s16(to.cast(), first);
                vst4q_s16(to.add(GROUP / 2).cast(), last);
            }
        }
    }

    /// Red, green, blue, and zeros of eight pixels.
    #[inline]
    #[target_feature(enable = "neon")]
    fn eight_pixels(&self, luma: uint8x8_t, chroma: uint8x8_t) -> int16x8x4_t {
        // The upper 16 bits of a doubled product are the product divided by 4 * 8192.
        let luma = vsubq_s16(vreinterpretq_s16_u16(vshll_n_u8::<2>(luma)), self.black);
        let luma = vqdmulhq_s16(luma, self.luma);
        let no_colour = vdupq_n_s16(4 * i16::from(NO_COLOUR));
        let chroma = vsubq_s16(vreinterpretq_s16_u16(vshll_n_u8::<2>(chroma)), no_colour);
        let (blue_red, green) = (vqdmulhq_s16(chroma, self.blue_red), vqdmulhq_s16(chroma, self.green));
        let green = vaddq_s16(green, vrev32q_s16(green));
        let red = vaddq_s16(luma, vtrn2q_s16(blue_red, blue_red));
        let blue = vaddq_s16(luma, vtrn1q_s16(blue_red, blue_red));
        int16x8x4_t(red, vaddq_s16(luma, green), blue, vdupq_n_s16(0))
    }
}
