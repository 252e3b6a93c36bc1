//! Four samples at a time with NEON, for [`sample`](crate::kernels::sample).

use crate::kernels::sample::{Line, Pixel, WHITE, plain};

unsafe extern "C" {
    #[link_name = "facewire_engine_neon_sample"]
    unsafe fn sample_groups(sampling: &Sampling);
}

/// Samples of a group.
const GROUP: usize = 4;

/// The samples of a line, as the assembly reads them.
#[repr(C)]
struct Sampling {
    /// Columns and rows of the first group.
    positions: [[i32; GROUP]; 2],
    /// Columns and rows from one group to the next.
    step: [i32; 2],
    row_bytes: usize,
    pixels: *const Pixel,
    scale: f32,
    white: i32,
    output: *mut f32,
    groups: usize,
}

/// # Safety
/// The processor must have NEON, and the line must be inside its pixels.
pub(in crate::kernels) unsafe fn sample(line: &Line, output: &mut [f32]) {
    let groups = output.len() / 3 / GROUP;
    let (grouped, rest) = output.split_at_mut(groups * 3 * GROUP);
    let positions = [0, 1, 2, 3].map(|number| line.position(number));
    let sampling = Sampling {
        positions: [0, 1].map(|axis| positions.map(|position| position[axis])),
        step: line.step.map(|step| step.wrapping_mul(GROUP as i32)),
        row_bytes: line.stride * size_of::<Pixel>(),
        pixels: line.pixels.as_ptr(),
        scale: line.scale,
        white: WHITE,
        output: grouped.as_mut_ptr(),
        groups,
    };
    // SAFETY: the caller vouches for NEON and for the line.
    unsafe { sample_groups(&sampling) }
    plain(line, groups * GROUP, rest);
}
