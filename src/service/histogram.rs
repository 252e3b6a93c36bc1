//! A lock-free histogram of durations in fixed memory.
//!
//! The buckets are log-linear, as in `HdrHistogram`: each power of two in nanoseconds is divided into 32 equal parts. A
//! reported duration is therefore never too short and at most 1/32 (3.2 %) too long; below 64 ns it is exact. Durations
//! above 68 s count as 68 s. Threads may read and record at the same time: a reader loads the buckets one by one, so it
//! may or may not see a duration that is recorded meanwhile.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

const PART_BITS: u32 = 5;
/// Buckets per power of two.
const PARTS: u64 = 1 << PART_BITS;
/// Number of buckets: they end at 64 * 2^30 ns = 68.7 s.
const BUCKETS: usize = 1024;

#[derive(Debug)]
pub struct Histogram {
    counts: [AtomicU64; BUCKETS],
    sum_ns: AtomicU64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: [const { AtomicU64::new(0) }; BUCKETS], sum_ns: AtomicU64::new(0) }
    }
}

impl Histogram {
    pub fn record(&self, time: Duration) {
        let ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX).min(MAX_NS);
        if let Some(count) = self.counts.get(bucket_of(ns)) {
            count.fetch_add(1, Relaxed);
        }
        self.sum_ns.fetch_add(ns, Relaxed);
    }

    pub fn sum_s(&self) -> f64 {
        self.sum_ns.load(Relaxed) as f64 / 1e9
    }

    /// Returns the duration in milliseconds at each of the given quantiles, such as 0.5 for the median. All are 0 before
    /// the first duration is recorded.
    pub fn quantiles_ms<const N: usize>(&self, quantiles: [f64; N]) -> [f64; N] {
        let total: u64 = self.counts().map(|(_, count)| count).sum();
        quantiles.map(|quantile| self.quantile_ms(quantile * total as f64))
    }

    /// Returns the end of the bucket in which the cumulative count reaches `rank`.
    fn quantile_ms(&self, rank: f64) -> f64 {
        let mut sum = 0;
        let reached = self.counts().find(|(_, count)| {
            sum += count;
            sum > 0 && sum as f64 >= rank
        });
        reached.map_or(0.0, |(end_ns, _)| end_ns as f64 / 1e6)
    }

    /// Counts the durations below each of the ascending limits but not below the previous limit, and those at or above
    /// the last limit. The counts are exact if each limit is the end of a bucket, such as a power of two from 64 on or
    /// 1.5 times that.
    pub fn counts_between<const N: usize>(&self, limits_ns: &[u64; N]) -> ([u64; N], u64) {
        let (mut counts, mut longer) = ([0; N], 0);
        for (end_ns, count) in self.counts() {
            match limits_ns.iter().zip(&mut counts).find(|(limit_ns, _)| end_ns <= **limit_ns) {
                Some((_, sum)) => *sum += count,
                None => longer += count,
            }
        }
        (counts, longer)
    }

    /// Iterates over the end of each bucket in nanoseconds (exclusive) and the count of the bucket.
    fn counts(&self) -> impl Iterator<Item = (u64, u64)> {
        self.counts.iter().zip(0..).map(|(count, bucket)| (end_ns(bucket), count.load(Relaxed)))
    }
}

/// Longest duration that is told apart from longer ones.
const MAX_NS: u64 = end_ns(BUCKETS as u64 - 1) - 1;

fn bucket_of(ns: u64) -> usize {
    let shift = ns.max(PARTS).ilog2() - PART_BITS;
    usize::try_from((u64::from(shift) << PART_BITS) + (ns >> shift)).unwrap_or(usize::MAX)
}

/// Returns the end of a bucket (exclusive).
const fn end_ns(bucket: u64) -> u64 {
    let shift = (bucket >> PART_BITS).saturating_sub(1);
    (bucket - (shift << PART_BITS) + 1) << shift
}

#[cfg(test)]
mod tests {
    use super::*;

    fn histogram_of(times_ns: impl IntoIterator<Item = u64>) -> Histogram {
        let histogram = Histogram::default();
        times_ns.into_iter().for_each(|ns| histogram.record(Duration::from_nanos(ns)));
        histogram
    }

    #[test]
    fn a_reported_duration_is_never_too_short_and_at_most_1_in_32_too_long() {
        let mut ns = 1_u64;
        while ns < MAX_NS {
            for near_ns in [ns - 1, ns, ns + 1, ns + ns / 3] {
                let reported_ns = histogram_of([near_ns]).quantiles_ms([1.0])[0] * 1e6;
                let (least, most) = (near_ns as f64, near_ns as f64 * (1.0 + 1.0 / 32.0) + 1.0);
                assert!((least..=most + 0.01).contains(&reported_ns), "{near_ns} is reported as {reported_ns}");
            }
            ns *= 2;
        }
    }

    #[test]
    fn buckets_have_no_gaps_and_no_overlaps() {
        for bucket in 0..BUCKETS - 1 {
            let end = end_ns(bucket as u64);
            assert_eq!((bucket_of(end - 1), bucket_of(end)), (bucket, bucket + 1));
        }
    }

    #[test]
    fn quantiles_of_evenly_spaced_durations_are_correct() {
        let reported = histogram_of((1..=100).map(|ms| ms * 1_000_000)).quantiles_ms([0.5, 0.95, 0.99, 1.0]);
        for (reported_ms, ms) in reported.into_iter().zip([50.0, 95.0, 99.0, 100.0]) {
            assert!((ms..=ms * 1.032).contains(&reported_ms), "{reported_ms} instead of {ms}");
        }
    }

    #[test]
    fn an_empty_histogram_reports_zeros() {
        let empty = Histogram::default();
        assert_eq!((empty.quantiles_ms([0.5, 1.0]), empty.sum_s()), ([0.0, 0.0], 0.0));
        assert_eq!(empty.counts_between(&[64]), ([0], 0));
    }

    #[test]
    fn durations_beyond_the_last_bucket_count_in_the_last_bucket() {
        let histogram = Histogram::default();
        histogram.record(Duration::MAX);
        assert!((histogram.quantiles_ms([0.5])[0] - 68_719.5).abs() < 0.1);
        assert!((histogram.sum_s() - 68.7).abs() < 0.1);
    }

    #[test]
    fn counts_between_limits_are_exact_and_complete() {
        let counts = histogram_of([0, 63, 64, 95, 96, 1023, 1024, u64::MAX]).counts_between(&[64, 96, 1024]);
        assert_eq!(counts, ([2, 2, 2], 2));
    }
}
