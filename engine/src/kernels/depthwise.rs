//! The depthwise 3 x 3 convolutions, written once over [`InstructionSet`].
//!
//! A kernel takes one vector of channels along a whole row, so that the nine weights stay in registers and each input
//! pixel is loaded once for all windows of the row that cover it. The sums go into the operand of the pointwise
//! convolution that follows. The kernel adds no bias: the bias of the pointwise convolution includes it.

use super::Depthwise;
use super::vector::{InstructionSet, vectors};

/// Panics if an area of a task is too small, or if the number of channels is no multiple of `lanes`.
pub(super) fn check(task: &Depthwise, lanes: usize, output: &[f32], largest: &[f32]) {
    let &Depthwise { channels, columns, stride, output_rows, first_pixel, .. } = task;
    assert!((stride == 1 && (1..=2).contains(&output_rows)) || (stride == 2 && output_rows == 1));
    assert!(channels.is_multiple_of(lanes) && channels > 0 && columns > 0 && task.weights.len() >= 9 * channels);
    assert!(first_pixel + output_rows * columns <= task.pixels && output.len() >= task.pixels * channels);
    assert!(task.rows.iter().take(output_rows + 2).all(|row| row.len() >= columns * stride * channels));
    assert!(largest.is_empty() || (stride == 2 && largest.len() >= columns * channels));
}

/// See [`super::Kernels::depthwise`].
///
/// # Safety
/// The processor must have the instruction set.
#[inline(always)]
pub(super) unsafe fn depthwise<I: InstructionSet>(task: &Depthwise, output: &mut [f32], largest: &mut [f32]) {
    check(task, I::LANES, output, largest);
    let &Depthwise { channels, columns, stride, output_rows, first_pixel, .. } = task;
    for channel in (0..channels).step_by(I::LANES) {
        // SAFETY: all sizes were checked above.
        unsafe {
            let rows = task.rows.map(|row| row.as_ptr().wrapping_add(channel));
            let taps = vectors::<I, 9>(task.weights, 9 * channel);
            let strip = Strip::<I::Vector> { rows, taps, channels, columns };
            let output = Output { operand: output.as_mut_ptr(), at: channel * task.pixels + first_pixel * I::LANES };
            match (stride, output_rows, largest.is_empty()) {
                (1, 1, _) => strip.every_pixel::<I, 1>(output),
                (1, _, _) => strip.every_pixel::<I, 2>(output),
                (_, _, true) => strip.every_second_pixel::<I, false>(output, std::ptr::null_mut()),
                _ => strip.every_second_pixel::<I, true>(output, largest.as_mut_ptr().add(channel)),
            }
        }
    }
}

/// A place in the operand.
#[derive(Clone, Copy)]
struct Output {
    operand: *mut f32,
    /// Number of the value, counted in the precision of the operand.
    at: usize,
}

/// One vector of channels of a task.
#[derive(Clone, Copy)]
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
    /// The processor must have the instruction set; the sizes must be those that [`check`] checks.
    #[inline(always)]
    unsafe fn every_pixel<I: InstructionSet<Vector = V>, const R: usize>(&self, output: Output) {
        // SAFETY: the caller vouches for all sizes.
        unsafe {
            let zero = [I::zero(); 4];
            let (mut left, mut middle) = (zero, self.column::<I>(R + 2, 0));
            let mut x = 0;
            while x + 4 < self.columns {
                [left, middle] = self.four_pixels::<I, R, false>(output, x, [left, middle]);
                x += 4;
            }
            if x + 4 == self.columns {
                self.four_pixels::<I, R, true>(output, x, [left, middle]);
                return;
            }
            while x < self.columns {
                let right = if x + 1 < self.columns { self.column::<I>(R + 2, x + 1) } else { zero };
                self.put::<I, R, 1>(output, x, [self.sums::<I, R>([left, middle, right])]);
                (left, middle) = (middle, right);
                x += 1;
            }
        }
    }

    /// Computes four pixels of `R` rows. They use four columns of registers in turn, so that none is copied. Takes and
    /// returns the two columns that the next pixels share with these.
    #[inline(always)]
    unsafe fn four_pixels<I: InstructionSet<Vector = V>, const R: usize, const LAST: bool>(
        &self,
        output: Output,
        x: usize,
        [left, middle]: [[V; 4]; 2],
    ) -> [[V; 4]; 2] {
        // SAFETY: the caller vouches for all sizes.
        unsafe {
            let third = self.column::<I>(R + 2, x + 1);
            let first_sums = self.sums::<I, R>([left, middle, third]);
            let fourth = self.column::<I>(R + 2, x + 2);
            let second_sums = self.sums::<I, R>([middle, third, fourth]);
            let left = self.column::<I>(R + 2, x + 3);
            let third_sums = self.sums::<I, R>([third, fourth, left]);
            let middle = if LAST { [I::zero(); 4] } else { self.column::<I>(R + 2, x + 4) };
            let fourth_sums = self.sums::<I, R>([fourth, left, middle]);
            self.put::<I, R, 4>(output, x, [first_sums, second_sums, third_sums, fourth_sums]);
            [left, middle]
        }
    }

    /// Computes one row with stride 2, and the largest of every 2 x 2 pixels if `POOL`.
    ///
    /// # Safety
    /// As [`every_pixel`](Self::every_pixel).
    #[inline(always)]
    unsafe fn every_second_pixel<I: InstructionSet<Vector = V>, const POOL: bool>(
        &self,
        output: Output,
        largest: *mut f32,
    ) {
        // SAFETY: the caller vouches for all sizes.
        unsafe {
            let mut left = self.column::<I>(3, 0);
            // Advancing each pointer is cheaper than multiplying the number of a pixel for each of them.
            let (mut strip, mut output, mut largest, mut pixels) = (*self, output, largest, self.columns);
            while pixels > 2 {
                left = strip.two_windows::<I, POOL, false>(output, largest, left);
                strip.rows = strip.rows.map(|row| row.wrapping_add(4 * self.channels));
                output.at += 2 * I::LANES;
                largest = largest.wrapping_add(2 * self.channels);
                pixels -= 2;
            }
            if pixels == 2 {
                strip.two_windows::<I, POOL, true>(output, largest, left);
            } else {
                let middle = strip.column::<I>(3, 1);
                strip.put::<I, 1, 1>(output, 0, [strip.sums::<I, 1>([left, middle, [I::zero(); 4]])]);
                if POOL {
                    I::store(largest, Self::largest::<I>(left, middle));
                }
            }
        }
    }

    /// Computes two pixels with stride 2. Takes and returns the column that the next pixel shares with these.
    #[inline(always)]
    unsafe fn two_windows<I: InstructionSet<Vector = V>, const POOL: bool, const LAST: bool>(
        &self,
        output: Output,
        largest: *mut f32,
        left: [V; 4],
    ) -> [V; 4] {
        // SAFETY: the caller vouches for all sizes.
        unsafe {
            let second = self.column::<I>(3, 1);
            let third = self.column::<I>(3, 2);
            let fourth = self.column::<I>(3, 3);
            let right = if LAST { [I::zero(); 4] } else { self.column::<I>(3, 4) };
            let sums = [self.sums::<I, 1>([left, second, third]), self.sums::<I, 1>([third, fourth, right])];
            self.put::<I, 1, 2>(output, 0, sums);
            if POOL {
                I::store(largest, Self::largest::<I>(left, second));
                I::store(largest.add(self.channels), Self::largest::<I>(third, fourth));
            }
            right
        }
    }

    /// The largest of the first two pixels of two columns.
    #[inline(always)]
    unsafe fn largest<I: InstructionSet<Vector = V>>(left: [V; 4], right: [V; 4]) -> V {
        // SAFETY: the caller vouches for the instruction set.
        unsafe { I::max(I::max(left[0], left[1]), I::max(right[0], right[1])) }
    }

    /// The pixels of `count` rows in column `x`.
    #[inline(always)]
    unsafe fn column<I: InstructionSet<Vector = V>>(&self, count: usize, x: usize) -> [V; 4] {
        // SAFETY: the caller vouches for the rows and the column.
        unsafe {
            let mut column = [I::zero(); 4];
            for (pixel, row) in column.iter_mut().zip(self.rows).take(count) {
                *pixel = I::load(row.add(x * self.channels));
            }
            column
        }
    }

    /// The sums of the windows over three columns, for `R` rows.
    #[inline(always)]
    unsafe fn sums<I: InstructionSet<Vector = V>, const R: usize>(&self, columns: [[V; 4]; 3]) -> [V; R] {
        // SAFETY: the caller vouches for the instruction set.
        unsafe {
            let mut sums = [I::zero(); R];
            for (row, sum) in sums.iter_mut().enumerate() {
                *sum = I::mul(columns[0][row], self.taps[0]);
                // Column by column, as in the assembly for 32-bit ARM, which has too few registers for three columns.
                for tap in 1..9 {
                    let (column, below) = (tap / 3, tap % 3);
                    *sum = I::mul_add(columns[column][row + below], self.taps[3 * below + column], *sum);
                }
            }
            sums
        }
    }

    /// Stores the sums of `P` pixels from column `x` on.
    #[inline(always)]
    unsafe fn put<I: InstructionSet<Vector = V>, const R: usize, const P: usize>(
        &self,
        output: Output,
        x: usize,
        sums: [[V; R]; P],
    ) {
        for row in 0..R {
            for (pixel, sums) in sums.iter().enumerate() {
                // SAFETY: the caller vouches for the place.
                unsafe {
                    let at = output.at + (row * self.columns + x + pixel) * I::LANES;
                    I::store_operand(output.operand, at, sums[row]);
                }
            }
        }
    }
}
