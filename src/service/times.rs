//! How long frames take, from capture to sending.

use std::fmt;
use std::time::Duration;

use super::histogram::Histogram;
use crate::pipeline::StageTimes;

/// Distributions over all frames since the start.
#[derive(Debug, Default)]
pub(super) struct Times {
    /// From capture to the begin of work: exposure, transfer, decoding, waiting.
    pub(super) wait: Histogram,
    /// Stages of the pipeline, for frames in which they ran.
    pub(super) detect: Histogram,
    pub(super) mesh: Histogram,
    pub(super) solve: Histogram,
    /// From a frame in memory to the hand-over of what it gave.
    pub(super) work: Histogram,
    /// From capture to sending, for poses that were followed.
    pub(super) age: Histogram,
}

impl Times {
    /// Counts the stages that ran.
    pub(super) fn record_stages(&self, times: &StageTimes) {
        let stages = [(&self.detect, times.detect), (&self.mesh, times.mesh), (&self.solve, times.solve)];
        for (histogram, time) in stages {
            if let Some(time) = time {
                histogram.record(time);
            }
        }
    }

    pub(super) fn quantiles(&self) -> [(&'static str, Quantiles); 6] {
        let Self { wait, detect, mesh, solve, work, age } = self;
        [("wait", wait), ("detect", detect), ("mesh", mesh), ("solve", solve), ("work", work), ("age", age)]
            .map(|(name, histogram)| (name, Quantiles::of(histogram)))
    }
}

/// p50, p95 and p99, milliseconds. Prints as `9.25/10.5/12.0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quantiles(pub [f64; 3]);

impl Quantiles {
    fn of(histogram: &Histogram) -> Self {
        Self(histogram.quantiles_ms([0.5, 0.95, 0.99]))
    }
}

/// Three digits, as much as the buckets tell, and microseconds at most.
impl fmt::Display for Quantiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [p50, p95, p99] = self.0.map(|ms| match ms {
            ..1.0 => format!("{ms:.3}"),
            ..10.0 => format!("{ms:.2}"),
            ..100.0 => format!("{ms:.1}"),
            _ => format!("{ms:.0}"),
        });
        write!(f, "{p50}/{p95}/{p99}")
    }
}

/// Microseconds between two readings of the monotonic clock.
pub(super) fn between(begun_us: u64, ended_us: u64) -> Duration {
    Duration::from_micros(ended_us.saturating_sub(begun_us))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_that_did_not_run_is_not_counted() {
        let times = Times::default();
        times.record_stages(&StageTimes { detect: Some(Duration::from_millis(2)), ..StageTimes::default() });
        let told = times.quantiles().map(|(name, Quantiles([p50, ..]))| (name, p50 > 0.0));
        let want =
            [("wait", false), ("detect", true), ("mesh", false), ("solve", false), ("work", false), ("age", false)];
        assert_eq!(told, want);
    }

    #[test]
    fn counting_times_allocates_nothing() {
        let (times, stage) = (Times::default(), Some(Duration::from_micros(9)));
        let allocated = allocation_counter::measure(|| {
            times.record_stages(&StageTimes { detect: stage, mesh: stage, solve: stage });
            times.work.record(between(1, u64::MAX));
        });
        assert_eq!(allocated, allocation_counter::AllocationInfo::default());
    }

    #[test]
    fn quantiles_are_shown_with_three_digits() {
        assert_eq!(Quantiles([0.0094, 9.25, 101.4]).to_string(), "0.009/9.25/101");
        assert_eq!(Quantiles([0.0, 0.254, 12.04]).to_string(), "0.000/0.254/12.0");
    }
}
