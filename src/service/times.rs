//! How long frames take, from capture to sending.

use std::fmt;
use std::time::Duration;

use super::histogram::Histogram;
use crate::pipeline::StageTimes;

/// Histograms over all frames since the service started.
#[derive(Debug, Default)]
pub(super) struct Times {
    /// From capture to the start of processing: exposure, transfer, decoding and waiting.
    pub(super) wait: Histogram,
    /// The decoding of a frame.
    pub(super) decode: Histogram,
    /// The search for the face: the detector, or almost nothing while a face is followed.
    pub(super) detect: Histogram,
    /// The landmark networks, for the frames on which they ran.
    pub(super) mesh: Histogram,
    /// Landmarks to coefficients, for the frames on which the solver ran.
    pub(super) solve: Histogram,
    /// From a frame in memory to the hand-over of its result to the sender.
    pub(super) work: Histogram,
    /// From capture to sending, for poses that the failsafe accepted.
    pub(super) age: Histogram,
}

impl Times {
    /// Records the stages that ran.
    pub(super) fn record_stages(&self, times: &StageTimes) {
        let stages = [(&self.detect, times.detect), (&self.mesh, times.mesh), (&self.solve, times.solve)];
        for (histogram, time) in stages {
            if let Some(time) = time {
                histogram.record(time);
            }
        }
    }

    /// Returns the name and the quantiles of each histogram.
    pub(super) fn quantiles(&self) -> [(&'static str, Quantiles); 7] {
        let Self { wait, decode, detect, mesh, solve, work, age } = self;
        let named = [
            ("wait", wait),
            ("decode", decode),
            ("detect", detect),
            ("mesh", mesh),
            ("solve", solve),
            ("work", work),
            ("age", age),
        ];
        named.map(|(name, histogram)| (name, Quantiles::of(histogram)))
    }
}

/// The 50th, 95th and 99th percentile in milliseconds. Displays as `9.25/10.5/12.0`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quantiles(pub [f64; 3]);

impl Quantiles {
    fn of(histogram: &Histogram) -> Self {
        Self(histogram.quantiles_ms([0.5, 0.95, 0.99]))
    }
}

/// Prints three significant digits, which is the precision of the histogram, and no digit below a microsecond.
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

/// Returns the time between two readings of the monotonic clock, or zero if the second is earlier.
pub(super) fn between(begun_us: u64, ended_us: u64) -> Duration {
    Duration::from_micros(ended_us.saturating_sub(begun_us))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_that_did_not_run_is_not_recorded() {
        let times = Times::default();
        times.record_stages(&StageTimes { detect: Some(Duration::from_millis(2)), ..StageTimes::default() });
        let recorded = times.quantiles().into_iter().filter(|(_, Quantiles([p50, ..]))| *p50 > 0.0);
        let recorded: Vec<_> = recorded.map(|(name, _)| name).collect();
        assert_eq!(recorded, ["detect"]);
    }

    #[test]
    fn recording_times_does_not_allocate() {
        let (times, stage) = (Times::default(), Some(Duration::from_micros(9)));
        let allocated = allocation_counter::measure(|| {
            times.record_stages(&StageTimes { detect: stage, mesh: stage, solve: stage });
            times.work.record(between(1, u64::MAX));
        });
        assert_eq!(allocated, allocation_counter::AllocationInfo::default());
    }

    #[test]
    fn quantiles_display_with_three_significant_digits() {
        assert_eq!(Quantiles([0.0094, 9.25, 101.4]).to_string(), "0.009/9.25/101");
        assert_eq!(Quantiles([0.0, 0.254, 12.04]).to_string(), "0.000/0.254/12.0");
    }
}
