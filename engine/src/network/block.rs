//! The work of one thread on a block: a depthwise convolution, the pointwise convolution of its output, the sum with the
//! block's input and the activation.

use std::ops::Range;

use super::layer::{Depthwise, Share, Sources, Work};
use crate::fusion::Residual;
use crate::kernels;

impl Sources<'_> {
    /// Computes a share, a few rows at a time, so that the values between the two convolutions stay
    /// in the cache.
    pub(super) fn block(&self, share: &mut Share) {
        let rows_at_a_time = self.layer.division.rows_at_a_time;
        let mut rows = share.range.start..share.range.start;
        for output in share.output.chunks_mut(rows_at_a_time * self.to.row) {
            rows = rows.end..(rows.end + rows_at_a_time).min(share.range.end);
            self.block_rows(rows.clone(), output, share.scratch);
        }
    }

    fn block_rows(&self, rows: Range<usize>, output: &mut [f32], scratch: &mut [f32]) {
        let Work::Block { depthwise, weights, bias, residual } = &self.layer.work else { return };
        let (from, to) = (self.from, self.to);
        let pixels = rows.len() * to.columns;
        let (operand, largest) = scratch.split_at_mut(pixels * from.channels);
        match depthwise {
            Some(depthwise) => {
                let pool = *residual == Residual::Largest;
                self.depthwise(depthwise, &rows, operand, if pool { largest } else { &mut [] });
            }
            None => self.kernels.operand_of(&self.input[from.rows(rows.clone())], from.channels, operand),
        }
        let residual: &[f32] = match residual {
            Residual::None => &[],
            Residual::Input => &self.input[from.rows(rows)],
            Residual::Largest => largest,
        };
        let task = kernels::Pointwise {
            operand,
            pixels,
            depth: from.channels,
            channels: to.channels,
            weights: &self.weights[weights.clone()],
            bias: &self.weights[bias.clone()],
            residual,
            residual_channels: if residual.is_empty() { 0 } else { from.channels },
            activation: self.activation(),
        };
        (self.kernels.pointwise)(&task, output);
    }

    /// Computes output rows into the operand of the pointwise convolution, two at a time where the stride is 1.
    /// `largest` receives the largest values of every 2 x 2 pixels, unless it is empty.
    fn depthwise(&self, depthwise: &Depthwise, rows: &Range<usize>, operand: &mut [f32], mut largest: &mut [f32]) {
        let (from, columns, stride) = (self.from, self.to.columns, depthwise.stride);
        let (mut row, mut first_pixel) = (rows.start, 0);
        while row < rows.end {
            let output_rows = if stride == 1 { (rows.end - row).min(2) } else { 1 };
            let task = kernels::Depthwise {
                rows: self.covered_rows(row * stride, stride),
                output_rows,
                stride,
                weights: &self.weights[depthwise.weights.clone()],
                channels: from.channels,
                columns,
                first_pixel,
                pixels: rows.len() * columns,
            };
            let (largest_of_row, rest) = largest.split_at_mut((columns * from.channels).min(largest.len()));
            (self.kernels.depthwise)(&task, operand, largest_of_row);
            largest = rest;
            row += output_rows;
            first_pixel += output_rows * columns;
        }
    }

    /// Returns the input rows that windows cover. The window of the first output row is centred on the input row `row` if
    /// the stride is 1, and begins at `row` if the stride is 2. Rows outside the map are zeros.
    fn covered_rows(&self, row: usize, stride: usize) -> [&[f32]; 4] {
        let from = self.from;
        // The first row is -1 for the first window with stride 1.
        let first_plus_1 = row + stride - 1;
        std::array::from_fn(|offset| match (first_plus_1 + offset).checked_sub(1) {
            Some(y) if y < from.rows => &self.input[from.rows(y..y + 1)],
            _ => &self.zeros[..from.row],
        })
    }
}
