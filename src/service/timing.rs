//! How long frames wait and take, from capture to sending, and how busy they keep the hot loop: counted without a lock
//! and in fixed memory.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use heapless::HistoryBuf;

use super::adaptation::{Load, Step};
use super::counters::Counters;
use crate::capture::{FrameRate, Source};
use crate::pipeline::StageTimes;

/// Buckets per power of two, and the binary logarithm of that number.
const PARTS: u64 = 1 << PART_BITS;
const PART_BITS: u32 = 5;
/// Number of buckets: they end at 64 * 2^30 ns = 68.7 s.
const BUCKETS: usize = 1024;
const MAX_NS: u64 = end_ns(BUCKETS as u64 - 1) - 1;
/// A longer time between two frames does not count as a frame period, microseconds.
const MAX_PERIOD_US: u64 = 500_000;
/// The newest frame counts for one part in this many of the mean frame period.
const PERIOD_SHARE: u64 = 8;
/// The load is computed from this many frames, and unknown with fewer than [`LEAST_FRAMES`].
const FRAMES: usize = 16;
const LEAST_FRAMES: usize = 4;
/// Of [`FRAMES`] frames, this many may take longer than the load says, for example because another program woke up.
const SLOWER: usize = FRAMES / 5;

/// A lock-free histogram of durations.
///
/// The buckets are log-linear, as in `HdrHistogram`: each power of two in nanoseconds is divided into 32 equal parts. A
/// reported duration is therefore never too short and at most 1/32 (3.2 %) too long; below 64 ns it is exact. A reader
/// may or may not see a duration that is recorded meanwhile.
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

    /// Returns the duration in milliseconds at each of the given quantiles. All are 0 before the first duration.
    pub fn quantiles_ms<const N: usize>(&self, quantiles: [f64; N]) -> [f64; N] {
        let total: u64 = self.counts().map(|(_, count)| count).sum();
        quantiles.map(|quantile| {
            let mut sum = 0;
            let reached = self.counts().find(|(_, count)| {
                sum += count;
                sum > 0 && sum as f64 >= quantile * total as f64
            });
            reached.map_or(0.0, |(end_ns, _)| end_ns as f64 / 1e6)
        })
    }

    /// Counts the durations below a limit. The count is exact at the ends of buckets, such as powers of two from 64 on and
    /// 1.5 times these.
    pub(super) fn count_below(&self, limit_ns: u64) -> u64 {
        self.counts().take_while(|(end_ns, _)| *end_ns <= limit_ns).map(|(_, count)| count).sum()
    }

    pub(super) fn sum_s(&self) -> f64 {
        self.sum_ns.load(Relaxed) as f64 / 1e9
    }

    fn counts(&self) -> impl Iterator<Item = (u64, u64)> {
        self.counts.iter().zip(0..).map(|(count, bucket)| (end_ns(bucket), count.load(Relaxed)))
    }
}

fn bucket_of(ns: u64) -> usize {
    let shift = ns.max(PARTS).ilog2() - PART_BITS;
    usize::try_from((u64::from(shift) << PART_BITS) + (ns >> shift)).unwrap_or(usize::MAX)
}

const fn end_ns(bucket: u64) -> u64 {
    let shift = (bucket >> PART_BITS).saturating_sub(1);
    (bucket - (shift << PART_BITS) + 1) << shift
}

/// The 50th, 95th and 99th percentile in milliseconds, such as `9.25/10.5/12.0`, in the precision of the histogram.
pub(super) fn quantiles(histogram: &Histogram) -> String {
    let digits = |ms: f64| match ms {
        ..1.0 => format!("{ms:.3}"),
        ..10.0 => format!("{ms:.2}"),
        ..100.0 => format!("{ms:.1}"),
        _ => format!("{ms:.0}"),
    };
    histogram.quantiles_ms([0.5, 0.95, 0.99]).map(digits).join("/")
}

#[derive(Default)]
pub(super) struct Times {
    /// From capture to the start of processing: exposure, transfer, decoding and waiting.
    wait: Histogram,
    decode: Histogram,
    /// The stages, for the frames on which they ran.
    detect: Histogram,
    pub(super) mesh: Histogram,
    solve: Histogram,
    /// From a frame in memory to the hand-over of its result to the sender.
    work: Histogram,
    /// From capture to sending, for poses that the failsafe accepted.
    pub(super) age: Histogram,
}

impl Times {
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

/// The time between two readings of the monotonic clock, or zero if the second is earlier.
pub(super) fn between(begun_us: u64, ended_us: u64) -> Duration {
    Duration::from_micros(ended_us.saturating_sub(begun_us))
}

/// Measures the frames of the open camera and adds to the counters.
pub(super) struct FrameTiming {
    counters: Arc<Counters>,
    last_captured_us: Option<u64>,
    camera_period: Duration,
    step: Step,
    /// How long the work on the newest frame took, until its decoding is known, too.
    work: Option<Duration>,
    /// How long the last frames would have taken with all networks, and the part that decoding took.
    recent: HistoryBuf<(Duration, Duration), FRAMES>,
}

impl FrameTiming {
    pub(super) fn new(counters: Arc<Counters>) -> Self {
        let camera_period = Duration::from_micros(FrameRate::FPS_30.period_us());
        let step = Step::Full;
        let recent = HistoryBuf::new();
        Self { counters, last_captured_us: None, camera_period, step, work: None, recent }
    }

    /// Begins with another camera, which is to deliver `fps` frames a second unless it states its own rate.
    pub(super) fn camera_opened(&mut self, camera: &dyn Source, fps: u32) {
        let asked = FrameRate::new(fps, 1).unwrap_or(FrameRate::FPS_30);
        self.camera_period = Duration::from_micros(camera.frame_period_us().unwrap_or(asked.period_us()));
        self.last_captured_us = None;
        self.recent = HistoryBuf::new();
        self.set_step(self.step);
    }

    /// Sets the step. The failsafe uses the frame period of the new step immediately.
    pub(super) fn set_step(&mut self, step: Step) {
        if step != self.step || self.last_captured_us.is_none() {
            self.step = step;
            self.counters.frame_period_us.store(micros(step.period(self.camera_period)), Relaxed);
        }
    }

    /// The earliest time of capture of the next frame that the step takes. Frames may come half a period early.
    pub(super) fn wanted_us(&self) -> u64 {
        let Some(last_us) = self.last_captured_us.filter(|_| self.step.every() > 1) else { return 0 };
        last_us + micros(self.step.period(self.camera_period).saturating_sub(self.camera_period / 2))
    }

    /// Follows the mean time between processed frames: the failsafe is more patient on a slow board.
    pub(super) fn captured(&mut self, captured_us: u64) {
        let gap_us = self.last_captured_us.and_then(|last_us| captured_us.checked_sub(last_us));
        self.last_captured_us = Some(captured_us);
        let Some(gap_us) = gap_us.filter(|gap_us| *gap_us <= MAX_PERIOD_US) else { return };
        let mean_us = self.counters.frame_period_us.load(Relaxed);
        // A recording does not state its rate.
        let next_us = if mean_us == 0 { gap_us } else { (mean_us * (PERIOD_SHARE - 1) + gap_us) / PERIOD_SHARE };
        self.counters.frame_period_us.store(next_us, Relaxed);
    }

    /// Counts how long a frame waited, how long each stage that ran took, and how long the whole work took.
    pub(super) fn worked(&mut self, captured_us: u64, begun_us: u64, ended_us: u64, stages: &StageTimes) {
        let times = &self.counters.times;
        let work = between(begun_us, ended_us);
        times.wait.record(between(captured_us, begun_us));
        times.work.record(work);
        let ran = [(&times.detect, stages.detect), (&times.mesh, stages.mesh), (&times.solve, stages.solve)];
        ran.iter().for_each(|(stage, time)| time.iter().for_each(|time| stage.record(*time)));
        self.work = Some(work);
    }

    /// Counts how long the frame that was worked on took to decode. Ignores the decoding of other frames.
    pub(super) fn decoded(&mut self, decoding: Duration) {
        let Some(work) = self.work.take() else { return };
        let busy = decoding + work;
        self.counters.times.decode.record(decoding);
        let is_late = busy > self.step.period(self.camera_period);
        self.counters.deadline_misses.fetch_add(u64::from(is_late), Relaxed);
        self.recent.write((self.step.full_busy(busy), decoding));
    }

    pub(super) fn load(&self) -> Option<Load> {
        let mut busy: heapless::Vec<_, FRAMES> = self.recent.iter().map(|(busy, _)| *busy).collect();
        busy.sort_unstable();
        let count = Some(busy.len()).filter(|count| *count >= LEAST_FRAMES)?;
        let decoding: Duration = self.recent.iter().map(|(_, decoding)| *decoding).sum();
        let busy = *busy.iter().rev().nth(SLOWER * count / FRAMES)?;
        let decoding = decoding / u32::try_from(count).ok()?;
        Some(Load { busy, decoding, camera_period: self.camera_period })
    }
}

fn micros(time: Duration) -> u64 {
    u64::try_from(time.as_micros()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::Clip;

    fn histogram_of(times_ns: impl IntoIterator<Item = u64>) -> Histogram {
        let histogram = Histogram::default();
        times_ns.into_iter().for_each(|ns| histogram.record(Duration::from_nanos(ns)));
        histogram
    }

    #[test]
    fn durations_are_told_never_too_short_and_at_most_1_in_32_too_long_in_3_digits_and_counts_below_limits_are_exact() {
        for ns in (0..36).map(|power| 1_u64 << power).flat_map(|ns| [ns - 1, ns, ns + 1, ns + ns / 3]) {
            let reported_ns = histogram_of([ns]).quantiles_ms([1.0])[0] * 1e6;
            let least = ns as f64;
            let most = ns as f64 * (1.0 + 1.0 / 32.0) + 1.01;
            assert!((least..=most).contains(&reported_ns), "{ns} is reported as {reported_ns}");
        }
        let of = |times_us: &[u64]| quantiles(&histogram_of(times_us.iter().map(|us| us * 1000)));
        assert_eq!(of(&[9, 9250, 101_400]), "9.44/103/103");
        assert_eq!(of(&[]), "0.000/0.000/0.000");
        let histogram = histogram_of([0, 63, 64, 95, 96, 1023, 1024, u64::MAX]);
        assert_eq!([64, 96, 1024, u64::MAX].map(|limit_ns| histogram.count_below(limit_ns)), [2, 4, 6, 8]);
    }

    fn timing() -> FrameTiming {
        let mut timing = FrameTiming::new(Arc::default());
        timing.camera_opened(&Clip::once().unwrap(), 30);
        timing
    }

    #[test]
    fn a_lower_step_wants_every_nth_frame_even_if_it_comes_early() {
        let mut timing = timing();
        timing.captured(1_000_000);
        assert_eq!(timing.wanted_us(), 0, "every frame");
        timing.set_step(Step::Third);
        assert!((1_076_000..1_090_000).contains(&timing.wanted_us()), "{}", timing.wanted_us());
        assert_eq!(timing.counters.frame_period_us.load(Relaxed), 99_999);
    }

    /// The camera and the reader are on the clock of the test. The reader takes the newest frame that has come, or waits for
    /// the one that the step wants, and is then busy.
    #[test]
    fn frames_come_evenly_on_a_step_that_fits_however_late_the_reader_is() {
        for (busy_periods, step) in [(0.5, Step::Third), (2.5, Step::Third), (4.5, Step::Sixth), (8.5, Step::Twelfth)] {
            let mut timing = timing();
            timing.set_step(step);
            let period_us = micros(timing.camera_period);
            let mut now_us = 1_000_000;
            let mut taken = Vec::new();
            for _ in 0..20 {
                let number = (now_us / period_us).max(timing.wanted_us().div_ceil(period_us));
                timing.captured(number * period_us);
                taken.push(number);
                now_us = now_us.max(number * period_us) + micros(timing.camera_period.mul_f64(busy_periods));
            }
            let gaps: Vec<u64> = taken.windows(2).map(|pair| pair[1] - pair[0]).collect();
            assert!(gaps.iter().all(|gap| *gap == u64::from(step.every())), "{busy_periods}, {step:?}: {gaps:?}");
        }
    }

    fn frame(timing: &mut FrameTiming, decoding_ms: u64, work_ms: u64) {
        timing.worked(0, 0, work_ms * 1000, &StageTimes::default());
        timing.decoded(Duration::from_millis(decoding_ms));
        // A picture that was left out.
        timing.decoded(Duration::from_secs(1));
    }

    #[test]
    fn a_frame_misses_its_deadline_if_decoding_and_work_take_longer_than_the_step_allows() {
        for (step, most_ms) in [(Step::Full, 13), (Step::Half, 46)] {
            let mut timing = timing();
            timing.set_step(step);
            [most_ms, most_ms + 1].iter().for_each(|decoding_ms| frame(&mut timing, *decoding_ms, 20));
            assert_eq!(timing.counters.deadline_misses.load(Relaxed), 1, "{step:?}");
        }
    }

    #[test]
    fn a_few_slow_frames_are_no_load_more_of_them_are_and_a_new_camera_is_judged_by_its_own_frames() {
        for (frames, want_ms) in [
            (&[(10, 3)][..], None),
            (&[(10, 4)], Some(10)),
            (&[(10, 13), (500, 3)], Some(10)),
            (&[(10, 12), (500, 4)], Some(500)),
            (&[(500, 9), (10, 16)], Some(10)),
        ] {
            let mut timing = timing();
            frames.iter().for_each(|(ms, count)| (0..*count).for_each(|_| frame(&mut timing, 4, ms - 4)));
            let load = timing.load();
            assert_eq!(load.map(|load| load.busy.as_millis()), want_ms, "{frames:?}");
            assert!(load.is_none_or(|load| load.decoding.as_millis() == 4), "{load:?}");
            timing.camera_opened(&Clip::once().unwrap(), 30);
            assert_eq!(timing.load(), None);
        }
    }
}
