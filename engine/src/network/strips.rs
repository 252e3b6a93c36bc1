//! How the rows of a layer are divided: into strips that follow each other, and each strip among threads.

use super::map::Map;

/// How the work of a network is divided.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sharing {
    pub threads: usize,
    /// A strip is divided among so few threads that each computes at least this number of multiply-adds.
    pub min_products: usize,
}

impl Sharing {
    pub(super) const NONE: Self = Self { threads: 1, min_products: usize::MAX };
    /// [`min_products`](Self::min_products) of a real network. A fast core computes them in some microseconds, and two
    /// threads need some tenths of a microsecond to begin and end a strip together.
    pub(super) const MIN_PRODUCTS: usize = 1 << 17;

    fn shares(self, products: usize) -> usize {
        (products / self.min_products).clamp(1, self.threads)
    }
}

/// The division of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Division {
    /// Rows that are computed before another layer has its turn.
    pub strip: usize,
    /// Rows of a strip that a thread computes at a time.
    pub rows_at_a_time: usize,
    /// Threads among which a strip is divided.
    pub shares: usize,
    /// The number of rows in each share but the last is a multiple of this.
    pub grain: usize,
}

/// The number of rows that a map keeps is a multiple of this, so that the rows that a thread computes at a time are
/// contiguous in memory.
pub(super) const KEPT_MULTIPLE: usize = 4;

impl Division {
    /// The whole layer as one strip of one thread.
    pub(super) fn whole(to: &Map) -> Self {
        Self { strip: to.rows, rows_at_a_time: to.rows, shares: 1, grain: 1 }
    }

    /// The division of a convolution with `products` multiply-adds.
    ///
    /// For one thread, strips are the smallest with which the kernels are fast, so that they stay in the cache. For several
    /// threads, strips are so large that each thread has enough work in each of them.
    pub(super) fn of_rows(to: &Map, products: usize, sharing: Sharing) -> Self {
        let rows_at_a_time = match to.columns {
            ..12 => to.rows,
            12..24 => KEPT_MULTIPLE,
            _ => 2,
        };
        let Sharing { threads, min_products } = sharing;
        if threads == 1 {
            return Self { strip: rows_at_a_time, rows_at_a_time, shares: 1, grain: 1 };
        }
        let products_of = |rows: usize| rows * (products / to.rows);
        let mut strip = KEPT_MULTIPLE * threads;
        while strip < to.rows && products_of(strip) < 2 * threads * min_products {
            strip *= 2;
        }
        if strip >= to.rows {
            return Self { strip: to.rows, rows_at_a_time, shares: sharing.shares(products), grain: 1 };
        }
        let rows_at_a_time = rows_at_a_time.min(KEPT_MULTIPLE);
        Self { strip, rows_at_a_time, shares: sharing.shares(products_of(strip)), grain: KEPT_MULTIPLE }
    }

    /// The division of a dense layer, whose outputs are one row: threads divide its panels.
    pub(super) fn of_panels(products: usize, sharing: Sharing) -> Self {
        Self { strip: 1, rows_at_a_time: 1, shares: sharing.shares(products), grain: 1 }
    }

    /// Returns the number of rows or panels in every share but the last, for a strip of `count` rows or panels.
    pub(super) fn share_size(&self, count: usize) -> usize {
        count.div_ceil(self.shares).next_multiple_of(self.grain)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Shape;
    use crate::testing::Random;

    #[test]
    fn rows_that_a_thread_computes_at_a_time_are_contiguous_in_any_map() {
        let mut random = Random::new(1);
        for _ in 0..3000 {
            let map = Shape { rows: random.below(100) + 1, columns: random.below(40) + 1, channels: 8 };
            let sharing = Sharing { threads: random.below(8) + 1, min_products: 500 };
            let division = Division::of_rows(&Map::new(map, 8), map.rows * random.below(2000), sharing);
            if division.strip == map.rows {
                continue;
            }
            let fits = KEPT_MULTIPLE.is_multiple_of(division.strip) || division.strip.is_multiple_of(KEPT_MULTIPLE);
            assert!(fits, "{division:?}");
            for start in (0..map.rows).step_by(division.strip) {
                let end = (start + division.strip).min(map.rows);
                let share = division.share_size(end - start);
                assert!((end - start).div_ceil(share) <= division.shares, "{map:?} {division:?}");
                for first in
                    (start..end).step_by(share).flat_map(|at| (at..at + share).step_by(division.rows_at_a_time))
                {
                    let last = first + division.rows_at_a_time - 1;
                    assert_eq!(first / KEPT_MULTIPLE, last / KEPT_MULTIPLE, "{map:?} {division:?}");
                }
            }
        }
    }
}
