//! The memory of a network: one block, cut into areas that begin at cache lines.

use std::ops::Range;

use crate::error::Error;

/// Values of a cache line, and of the widest vector.
const LINE: usize = 16;

/// Lays out areas one after the other.
#[derive(Debug, Default)]
pub(crate) struct Layout {
    end: usize,
}

impl Layout {
    /// Values of the largest block. The networks of facewire need less than a fifth of them.
    pub(crate) const LARGEST: usize = 1 << 23;

    /// Takes an area of `length` values.
    pub(crate) fn area(&mut self, length: usize) -> Range<usize> {
        let start = self.end;
        self.end = start + Self::lines(length);
        start..start + length
    }

    /// Rounds a number of values up to whole cache lines.
    pub(crate) fn lines(length: usize) -> usize {
        length.next_multiple_of(LINE)
    }

    /// Makes the memory of all areas, filled with zeros.
    ///
    /// # Errors
    /// [`Error::Unsupported`] if that would be too much memory.
    pub(crate) fn memory(&self) -> Result<Memory, Error> {
        if self.end > Self::LARGEST {
            return Err(Error::Unsupported("the network needs too much memory"));
        }
        let values = vec![0.0; self.end + LINE - 1];
        let start = values.as_ptr().align_offset(LINE * size_of::<f32>()).min(LINE - 1);
        Ok(Memory { start, values })
    }
}

/// The values of all areas.
#[derive(Debug)]
pub(crate) struct Memory {
    start: usize,
    values: Vec<f32>,
}

impl Memory {
    /// All areas.
    pub(crate) fn all(&self) -> &[f32] {
        &self.values[self.start..]
    }

    /// All areas.
    pub(crate) fn all_mut(&mut self) -> &mut [f32] {
        &mut self.values[self.start..]
    }
}
