//! Four samples at a time with NEON.

use std::arch::aarch64::{
    float32x4_t, int32x4_t, vaddq_s32, vandq_s16, vandq_s32, vcvtq_f32_s32, vdupq_n_s16, vdupq_n_s32, vget_low_f32,
    vget_low_s16, vgetq_lane_u32, vld1q_s16, vld1q_s32, vmaxq_s32, vminq_s32, vmlal_laneq_s16, vmlaq_laneq_s16,
    vmlaq_n_s32, vmlaq_s32, vmull_high_laneq_s16, vmulq_laneq_s16, vmulq_n_f32, vreinterpretq_u32_s32,
    vshrn_high_n_s32, vshrn_n_s32, vshrq_n_s32, vst1_f32, vst1q_f32, vst1q_lane_f32, vsubq_s16,
};

use super::{Line, Pixel, WHITE, plain};

/// Samples of a group.
const GROUP: usize = 4;

/// See [`super::Sampler`].
///
/// # Safety
/// The processor must have NEON, and the line must be inside its pixels.
#[target_feature(enable = "neon")]
pub(super) unsafe fn sample(line: &Line, output: &mut [f32]) {
    let groups = output.len() / 3 / GROUP;
    let (grouped, rest) = output.split_at_mut(groups * 3 * GROUP);
    let mut to = grouped.as_mut_ptr();
    // SAFETY: the array has four numbers.
    let numbers = unsafe { vld1q_s32([0, 1, 2, 3].as_ptr()) };
    let [mut x, mut y] = [0, 1].map(|axis| vmlaq_n_s32(vdupq_n_s32(line.start[axis]), numbers, line.step[axis]));
    let [step_x, step_y] = line.step.map(|step| vdupq_n_s32(step.wrapping_mul(GROUP as i32)));
    for group in 0..groups {
        let is_last = group + 1 == groups;
        // SAFETY: the samples are inside the pixels. A store also writes one value after its sample, which the store of the
        // next sample overwrites. No value follows the last sample, which is why it is stored in parts.
        unsafe {
            let [first, second, third, fourth] = group_of(line, x, y);
            vst1q_f32(to, first);
            vst1q_f32(to.add(3), second);
            vst1q_f32(to.add(6), third);
            if is_last {
                vst1_f32(to.add(9), vget_low_f32(fourth));
                vst1q_lane_f32::<2>(to.add(11), fourth);
                break;
            }
            vst1q_f32(to.add(9), fourth);
            to = to.add(3 * GROUP);
        }
        x = vaddq_s32(x, step_x);
        y = vaddq_s32(y, step_y);
    }
    if !rest.is_empty() {
        plain(line, groups * GROUP, rest);
    }
}

/// Four samples.
///
/// # Safety
/// The processor must have NEON, and the samples must be inside the pixels.
#[inline]
#[target_feature(enable = "neon")]
unsafe fn group_of(line: &Line, x: int32x4_t, y: int32x4_t) -> [float32x4_t; 4] {
    let pixel_bytes = size_of::<Pixel>() as i32;
    let (row_bytes, whole) = (vdupq_n_s32(line.stride as i32 * pixel_bytes), vdupq_n_s32(-pixel_bytes));
    // A position is in 1/65536 pixel, and a pixel takes 8 bytes.
    let along = vandq_s32(vshrq_n_s32::<13>(x), whole);
    let offsets = vreinterpretq_u32_s32(vmlaq_s32(along, vshrq_n_s32::<16>(y), row_bytes));
    // The weights of the right pixels in the lower half, and those of the lower pixels in the upper half.
    let weights = vandq_s16(vshrn_high_n_s32::<11>(vshrn_n_s32::<11>(x), y), vdupq_n_s16(31));
    let other_weights = vsubq_s16(vdupq_n_s16(32), weights);
    let top_row = line.pixels.as_ptr();
    let bottom_row = top_row.wrapping_add(line.stride);
    macro_rules! sample {
        ($number:literal, $row:literal) => {{
            let offset = vgetq_lane_u32::<$number>(offsets) as usize;
            // SAFETY: the pixels at the offset, to the right of it and below it are inside.
            let [top, bottom] = unsafe { [top_row, bottom_row].map(|row| vld1q_s16(row.byte_add(offset).cast())) };
            let columns = vmulq_laneq_s16::<$row>(top, other_weights);
            let columns = vmlaq_laneq_s16::<$row>(columns, bottom, weights);
            let levels = vmull_high_laneq_s16::<$number>(columns, weights);
            let levels = vmlal_laneq_s16::<$number>(levels, vget_low_s16(columns), other_weights);
            let levels = vminq_s32(vmaxq_s32(levels, vdupq_n_s32(0)), vdupq_n_s32(WHITE));
            vmulq_n_f32(vcvtq_f32_s32(levels), line.scale)
        }};
    }
    [sample!(0, 4), sample!(1, 5), sample!(2, 6), sample!(3, 7)]
}
