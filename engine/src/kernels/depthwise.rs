//! The depthwise 3 x 3 convolutions, written once over [`InstructionSet`].
//!
//! A kernel takes one vector of channels along a whole row, so that the nine weights stay in registers and each input
//! pixel is loaded once for all windows of the row that cover it. The sums go into the operand of the pointwise
//! convolution that follows. There is no bias: it is part of that convolution's.

use super::Depthwise;
use super::vector::InstructionSet;

/// See [`super::Kernels::depthwise`].
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn depthwise<I: InstructionSet>(task: &Depthwise, output: &mut [f32], largest: &mut [f32]) {
    let &Depthwise { channels, columns, stride, output_rows, first_pixel, .. } = task;
    assert!((stride == 1 && (1..=2).contains(&output_rows)) || (stride == 2 && output_rows == 1));
    assert!(channels.is_multiple_of(I::LANES) && columns > 0 && task.weights.len() >= 9 * channels);
    assert!(first_pixel + output_rows * columns <= task.pixels && output.len() >= task.pixels * channels);
    assert!(task.rows.iter().take(output_rows + 2).all(|row| row.len() >= columns * stride * channels));
    assert!(largest.is_empty() || (stride == 2 && largest.len() >= columns * channels));
    for channel in (0..channels).step_by(I::LANES) {
        // SAFETY: all sizes were checked above.
        unsafe {
            let rows = task.rows.map(|row| row.as_ptr().wrapping_add(channel));
            let taps = std::array::from_fn(|tap| I::load(task.weights.as_ptr().add(9 * channel + tap * I::LANES)));
            let strip = Strip::<I::Vector> { rows, taps, channels, columns };
            let output = output.as_mut_ptr().add(channel * task.pixels + first_pixel * I::LANES);
            match (stride, output_rows, largest.is_empty()) {
                (1, 1, _) => strip.every_pixel::<I, 1>(output),
                (1, _, _) => strip.every_pixel::<I, 2>(output),
                (_, _, true) => strip.every_second_pixel::<I, false>(output, std::ptr::null_mut()),
                _ => strip.every_second_pixel::<I, true>(output, largest.as_mut_ptr().add(channel)),
            }
        }
    }
}

/// One vector of channels of a task.
struct Strip<V> {
    /// The input rows, at the first of the channels.
    rows: [*const f32; 4],
    /// The weights, row by row.
    taps: [V; 9],
    /// Values from one pixel to the next.
    channels: usize,
    /// Output pixels of a row.
    columns: usize,
}

impl<V: Copy> Strip<V> {
    /// Computes `R` rows with stride 1.
    ///
    /// # Safety
    /// The processor must have the instruction set; the sizes must be those that [`depthwise`] checks.
    #[inline(always)]
    unsafe fn every_pixel<I: InstructionSet<Vector = V>, const R: usize>(&self, output: *mut f32) {
        // SAFETY: the caller vouches for all sizes.
        unsafe {
            let zero = [I::zero(); 4];
            let (mut left, mut middle) = (zero, self.column::<I>(R + 2, 0));
            let mut x = 0;
            // Four pixels use four columns of registers in turn, so that none is copied.
            while x + 4 <= self.columns {
                let third = self.column::<I>(R + 2, x + 1);
                self.put::<I, R>(output, x, [left, middle, third]);
                let fourth = self.column::<I>(R + 2, x + 2);
                self.put::<I, R>(output, x + 1, [middle, third, fourth]);
                left = self.column::<I>(R + 2, x + 3);
                self.put::<I, R>(output, x + 2, [third, fourth, left]);
                middle = if x + 4 < self.columns { self.column::<I>(R + 2, x + 4) } else { zero };
                self.put::<I, R>(output, x + 3, [fourth, left, middle]);
                x += 4;
            }
            while x < self.columns {
                let right = if x + 1 < self.columns { self.column::<I>(R + 2, x + 1) } else { zero };
                self.put::<I, R>(output, x, [left, middle, right]);
                (left, middle) = (middle, right);
                x += 1;
            }
        }
    }

    /// Computes one row with stride 2, and the largest of every 2 x 2 pixels if `POOL`.
    ///
    /// # Safety
    /// As [`every_pixel`](Self::every_pixel).
    #[inline(always)]
    unsafe fn every_second_pixel<I: InstructionSet<Vector = V>, const POOL: bool>(
        &self,
        output: *mut f32,
        largest: *mut f32,
    ) {
        // SAFETY: the caller vouches for all sizes.
        unsafe {
            let mut left = self.column::<I>(3, 0);
            for x in 0..self.columns {
                let middle = self.column::<I>(3, 2 * x + 1);
                let right = if x + 1 < self.columns { self.column::<I>(3, 2 * x + 2) } else { [I::zero(); 4] };
                self.put::<I, 1>(output, x, [left, middle, right]);
                if POOL {
                    let pairs = I::max(I::max(left[0], left[1]), I::max(middle[0], middle[1]));
                    I::store(largest.add(x * self.channels), pairs);
                }
                left = right;
            }
        }
    }

    /// The pixels of `count` rows in column `x`.
    #[inline(always)]
    unsafe fn column<I: InstructionSet<Vector = V>>(&self, count: usize, x: usize) -> [V; 4] {
        std::array::from_fn(|row| {
            // SAFETY: the caller vouches for the rows and the column.
            unsafe { if row < count { I::load(self.rows[row].wrapping_add(x * self.channels)) } else { I::zero() } }
        })
    }

    /// Stores the sums of the windows over three columns, for `R` rows of output column `x`.
    #[inline(always)]
    unsafe fn put<I: InstructionSet<Vector = V>, const R: usize>(
        &self,
        output: *mut f32,
        x: usize,
        columns: [[V; 4]; 3],
    ) {
        for row in 0..R {
            // SAFETY: the caller vouches for the place.
            unsafe {
                let mut sum = I::mul(columns[0][row], self.taps[0]);
                for tap in 1..9 {
                    sum = I::mul_add(columns[tap % 3][row + tap / 3], self.taps[tap], sum);
                }
                I::store(output.add((row * self.columns + x) * I::LANES), sum);
            }
        }
    }
}
