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
        block(self.end).map(Memory).map_err(|_| Error::Unsupported("the system gives no memory for the network"))
    }
}

/// A map of its own, which the system gets back whole when a network is dropped. In the heap it would leave a hole that the
/// C library keeps, so that memory would grow with every network that is loaded. Its beginning is that of a page.
#[cfg(not(test))]
type Block = memmap2::MmapMut;
#[cfg(not(test))]
fn block(length: usize) -> std::io::Result<Block> {
    memmap2::MmapMut::map_anon(length * size_of::<f32>())
}

/// In tests the heap, so that a sanitizer detects a kernel that reads past the end.
#[cfg(test)]
type Block = Vec<f32>;
#[cfg(test)]
#[allow(clippy::unnecessary_wraps, reason = "a map can fail")]
fn block(length: usize) -> std::io::Result<Block> {
    Ok(vec![0.0; length])
}

/// The values of all areas.
#[derive(Debug)]
pub(crate) struct Memory(Block);

impl Memory {
    /// All areas.
    pub(crate) fn all(&self) -> &[f32] {
        bytemuck::cast_slice(&self.0)
    }

    /// All areas.
    pub(crate) fn all_mut(&mut self) -> &mut [f32] {
        bytemuck::cast_slice_mut(&mut self.0)
    }
}
