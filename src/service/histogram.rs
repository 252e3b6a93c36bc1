//! Distribution of times in fixed memory, counted without waiting.
//!
//! Buckets are log-linear, as in `HdrHistogram`: every power of two of nanoseconds is cut into 32 equal parts. So a time
//! is told at most 1/32 (3.2 %) too long and never too short; below 64 ns it is exact. What is longer than 68 s counts
//! as 68 s. Any thread may read while another counts: the buckets are read one by one, so that a time counted
//! meanwhile is seen or not, and nothing else.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

/// A power of two has 2 to the power of this many parts.
const PART_BITS: u32 = 5;
const PARTS: u64 = 1 << PART_BITS;
/// Up to 64 * 2^30 ns: 68.7 s.
const BUCKETS: usize = 1024;

/// Times and how often each came.
#[derive(Debug)]
pub(crate) struct Histogram {
    counts: [AtomicU64; BUCKETS],
    sum_ns: AtomicU64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: [const { AtomicU64::new(0) }; BUCKETS], sum_ns: AtomicU64::new(0) }
    }
}

impl Histogram {
    /// Counts a time.
    pub(crate) fn record(&self, time: Duration) {
        let ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX).min(LONGEST_NS);
        if let Some(count) = self.counts.get(bucket_of(ns)) {
            count.fetch_add(1, Relaxed);
        }
        self.sum_ns.fetch_add(ns, Relaxed);
    }

    /// Sum of all times, seconds.
    pub(crate) fn sum_s(&self) -> f64 {
        self.sum_ns.load(Relaxed) as f64 / 1e9
    }

    /// Times that no `parts` of all exceed, milliseconds; 0 before the first.
    pub(crate) fn quantiles_ms<const N: usize>(&self, parts: [f64; N]) -> [f64; N] {
        let total: u64 = self.counts().map(|(_, count)| count).sum();
        parts.map(|part| self.quantile_ms(part * total as f64))
    }

    /// The end of the bucket in which the sum of counts reaches `rank`.
    fn quantile_ms(&self, rank: f64) -> f64 {
        let mut sum = 0;
        let reached = self.counts().find(|(_, count)| {
            sum += count;
            sum > 0 && sum as f64 >= rank
        });
        reached.map_or(0.0, |(end_ns, _)| end_ns as f64 / 1e6)
    }

    /// How many times lie below each of the limits and not below the one before; the last for all that are longer.
    /// Exact for limits at which a bucket ends, such as powers of two from 64 on and one and a half times them.
    pub(crate) fn counts_below<const N: usize>(&self, limits_ns: &[u64; N]) -> ([u64; N], u64) {
        let (mut below, mut longer) = ([0; N], 0);
        for (end_ns, count) in self.counts() {
            match limits_ns.iter().zip(&mut below).find(|(limit_ns, _)| end_ns <= **limit_ns) {
                Some((_, below)) => *below += count,
                None => longer += count,
            }
        }
        (below, longer)
    }

    /// The first time beyond each bucket, nanoseconds, and its count.
    fn counts(&self) -> impl Iterator<Item = (u64, u64)> {
        self.counts.iter().zip(0..).map(|(count, bucket)| (end_ns(bucket), count.load(Relaxed)))
    }
}

/// The last time that has a bucket of its own.
const LONGEST_NS: u64 = end_ns(BUCKETS as u64 - 1) - 1;

fn bucket_of(ns: u64) -> usize {
    let shift = ns.max(PARTS).ilog2() - PART_BITS;
    usize::try_from((u64::from(shift) << PART_BITS) + (ns >> shift)).unwrap_or(usize::MAX)
}

/// The first time beyond a bucket.
const fn end_ns(bucket: u64) -> u64 {
    let shift = (bucket >> PART_BITS).saturating_sub(1);
    (bucket - (shift << PART_BITS) + 1) << shift
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "0 and counts are exact")]
mod tests {
    use super::*;

    fn of(times_ns: impl IntoIterator<Item = u64>) -> Histogram {
        let histogram = Histogram::default();
        times_ns.into_iter().for_each(|ns| histogram.record(Duration::from_nanos(ns)));
        histogram
    }

    #[test]
    fn every_time_is_told_at_most_a_thirty_second_too_long_and_never_too_short() {
        let mut ns = 1_u64;
        while ns < LONGEST_NS {
            for near_ns in [ns - 1, ns, ns + 1, ns + ns / 3] {
                let told_ns = of([near_ns]).quantiles_ms([1.0])[0] * 1e6;
                let (least, most) = (near_ns as f64, near_ns as f64 * (1.0 + 1.0 / 32.0) + 1.0);
                assert!((least..=most + 0.01).contains(&told_ns), "{near_ns} is told as {told_ns}");
            }
            ns *= 2;
        }
    }

    #[test]
    fn buckets_follow_on_each_other_without_gap_or_overlap() {
        for bucket in 0..BUCKETS - 1 {
            let end = end_ns(bucket as u64);
            assert_eq!((bucket_of(end - 1), bucket_of(end)), (bucket, bucket + 1));
        }
    }

    #[test]
    fn quantiles_are_those_of_all_times() {
        let told = of((1..=100).map(|ms| ms * 1_000_000)).quantiles_ms([0.5, 0.95, 0.99, 1.0]);
        for (told_ms, ms) in told.into_iter().zip([50.0, 95.0, 99.0, 100.0]) {
            assert!((ms..=ms * 1.032).contains(&told_ms), "{told_ms} in place of {ms}");
        }
    }

    #[test]
    fn before_the_first_time_all_is_0() {
        let none = Histogram::default();
        assert_eq!((none.quantiles_ms([0.5, 1.0]), none.sum_s()), ([0.0, 0.0], 0.0));
        assert_eq!(none.counts_below(&[64]), ([0], 0));
    }

    #[test]
    fn a_time_without_end_counts_as_the_longest() {
        let endless = Histogram::default();
        endless.record(Duration::MAX);
        assert!((endless.quantiles_ms([0.5])[0] - 68_719.5).abs() < 0.1);
        assert!((endless.sum_s() - 68.7).abs() < 0.1);
    }

    #[test]
    fn counts_below_limits_are_exact_and_lose_nothing() {
        let counts = of([0, 63, 64, 95, 96, 1023, 1024, u64::MAX]).counts_below(&[64, 96, 1024]);
        assert_eq!(counts, ([2, 2, 2], 2));
    }
}
