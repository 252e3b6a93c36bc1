//! Sixteen pixels at a time with NEON, for [`convert`](crate::kernels::convert).

use std::ptr::null;

use crate::kernels::convert::{Factors, GROUP, Samples};
use crate::kernels::sample::Pixel;

unsafe extern "C" {
    #[link_name = "facewire_engine_neon_convert_yuyv"]
    unsafe fn convert_yuyv(conversion: &Conversion);
    #[link_name = "facewire_engine_neon_convert_semi_planar"]
    unsafe fn convert_semi_planar(conversion: &Conversion);
    #[link_name = "facewire_engine_neon_convert_planar"]
    unsafe fn convert_planar(conversion: &Conversion);
    #[link_name = "facewire_engine_neon_convert_grey"]
    unsafe fn convert_grey(conversion: &Conversion);
}

/// The conversion of groups of pixels, as the assembly reads it.
#[repr(C)]
struct Conversion {
    luma: *const u8,
    /// Planes of chroma. Both are null if luma and chroma share one plane or there is no chroma. The second is null if Cb
    /// and Cr share one plane.
    chroma: [*const u8; 2],
    output: *mut [Pixel; GROUP],
    groups: usize,
    luma_factor: i16,
    /// Four times the luma of black.
    black: i16,
    /// Factors of Cb in blue and Cr in red.
    blue_red: [i16; 2],
    /// Factors of Cb and Cr in green.
    green: [i16; 2],
}

/// # Safety
/// The processor must have NEON, and there must be samples for all pixels.
pub(in crate::kernels) unsafe fn convert(factors: &Factors, samples: &Samples, output: &mut [[Pixel; GROUP]]) {
    let mut conversion = |luma: &[u8], chroma| Conversion {
        luma: luma.as_ptr(),
        chroma,
        output: output.as_mut_ptr(),
        groups: output.len(),
        luma_factor: factors.luma,
        black: 4 * factors.black,
        blue_red: [factors.blue, factors.red],
        green: factors.green,
    };
    // SAFETY: the caller vouches for NEON and for the number of samples.
    unsafe {
        match samples {
            Samples::Yuyv(samples) => convert_yuyv(&conversion(samples, [null(); 2])),
            Samples::SemiPlanar(luma, chroma) => convert_semi_planar(&conversion(luma, [chroma.as_ptr(), null()])),
            Samples::Planar([luma, cb, cr]) => convert_planar(&conversion(luma, [cb.as_ptr(), cr.as_ptr()])),
            Samples::Grey(luma) => convert_grey(&conversion(luma, [null(); 2])),
        }
    }
}
