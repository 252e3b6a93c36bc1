//! Where maps lie in the arena.

use std::ops::Range;

use crate::graph::Shape;

/// A map in memory.
#[derive(Debug, Clone)]
pub(super) struct Map {
    pub area: Range<usize>,
    pub rows: usize,
    /// Number of rows that the area has room for. Row `y` takes the place of row `y % kept`.
    pub kept: usize,
    /// Values of a row.
    pub row: usize,
    pub columns: usize,
    /// Channels, padded to what the kernels need.
    pub channels: usize,
    /// Channels without the padding.
    pub true_channels: usize,
}

impl Map {
    pub(super) fn new(shape: Shape, lanes: usize) -> Self {
        let Shape { rows, columns, channels } = shape;
        let padded = channels.next_multiple_of(lanes);
        let row = columns * padded;
        Self { area: 0..0, rows, kept: rows, row, columns, channels: padded, true_channels: channels }
    }

    /// Pads the channels to a multiple, in place of the padding of [`new`](Self::new).
    pub(super) fn pad_channels(&mut self, multiple: usize) {
        self.channels = self.true_channels.next_multiple_of(multiple);
        self.row = self.columns * self.channels;
    }

    /// Where consecutive rows lie within the area. The range must not cross a multiple of `kept`.
    pub(super) fn rows(&self, rows: Range<usize>) -> Range<usize> {
        let start = rows.start % self.kept * self.row;
        start..start + rows.len() * self.row
    }
}

/// Where the caller writes the input.
#[derive(Debug)]
pub(super) struct Input {
    pub shape: Shape,
    /// Place of the first value in the arena.
    pub start: usize,
    /// Values from one row to the next.
    pub step: usize,
}
