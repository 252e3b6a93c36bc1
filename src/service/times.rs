//! How long frames take, from capture to sending.

use std::time::Duration;

use super::histogram::Histogram;
use crate::pipeline::StageTimes;

/// Histograms over all frames since the service started.
#[derive(Debug, Default)]
pub(super) struct Times {
    /// From capture to the start of processing: exposure, transfer, decoding and waiting.
    pub(super) wait: Histogram,
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

    /// Every histogram with its name: the five stages first.
    pub(super) fn all(&self) -> [(&'static str, &Histogram); 7] {
        let Self { wait, decode, detect, mesh, solve, work, age } = self;
        [
            ("wait", wait),
            ("decode", decode),
            ("detect", detect),
            ("mesh", mesh),
            ("solve", solve),
            ("work", work),
            ("age", age),
        ]
    }
}

/// The 50th, 95th and 99th percentile in milliseconds, such as `9.25/10.5/12.0`: three significant digits, which is the
/// precision of the histogram, and no digit below a microsecond.
pub(super) fn quantiles(histogram: &Histogram) -> String {
    let digits = |ms: f64| match ms {
        ..1.0 => format!("{ms:.3}"),
        ..10.0 => format!("{ms:.2}"),
        ..100.0 => format!("{ms:.1}"),
        _ => format!("{ms:.0}"),
    };
    histogram.quantiles_ms([0.5, 0.95, 0.99]).map(digits).join("/")
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
        let recorded = times.all().into_iter().filter(|(_, histogram)| histogram.sum_s() > 0.0);
        assert_eq!(recorded.map(|(name, _)| name).collect::<Vec<_>>(), ["detect"]);
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
    fn quantiles_have_three_significant_digits() {
        let of = |us: &[u64]| {
            let histogram = Histogram::default();
            us.iter().for_each(|us| histogram.record(Duration::from_micros(*us)));
            quantiles(&histogram)
        };
        assert_eq!(of(&[9, 9250, 101_400]), "9.44/103/103");
        assert_eq!(of(&[]), "0.000/0.000/0.000");
        assert_eq!(of(&[12]), "0.012/0.012/0.012");
    }
}
