//! Renders every counter, gauge and histogram of the service as one page of `OpenMetrics` text.

use std::fmt;
use std::fs;
use std::sync::Arc;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, EncodeMetric, MetricEncoder, NoLabelSet, text};
use prometheus_client::metrics::counter::ConstCounter;
use prometheus_client::metrics::gauge::ConstGauge;
use prometheus_client::metrics::info::Info;
use prometheus_client::metrics::{MetricType, TypedMetric};
use prometheus_client::registry::{Registry, Unit};
use rustix::param::page_size;

use crate::impairment::Impairment;
use crate::service::counters::{Counters, NEUTRAL_FACES, STATES, Status};
use crate::service::histogram::Histogram;
use crate::service::{Cause, Step};

/// The media type of the `OpenMetrics` text format.
pub(super) const CONTENT_TYPE: &str = "application/openmetrics-text; version=1.0.0; charset=utf-8";

/// Returns the upper limits of the histogram buckets on the page: powers of two in nanoseconds and 1.5 times each, from
/// 16 microseconds to 1.6 seconds. [`Histogram::counts_between`] is exact at these limits.
fn limits_ns() -> [u64; 34] {
    std::array::from_fn(|index| {
        let power = 1 << (14 + index / 2);
        if index % 2 == 0 { power } else { power + power / 2 }
    })
}

/// The registry of all metrics, which renders the page.
#[derive(Debug)]
pub(super) struct Page(Registry);

impl Page {
    pub(super) fn new(counters: Arc<Counters>) -> Self {
        let mut registry = Registry::with_prefix("facewire");
        registry.register("build", "Version of facewire", Info::new([("version", env!("CARGO_PKG_VERSION"))]));
        registry.register_collector(Box::new(CountersCollector(counters)));
        Self(registry)
    }

    /// Renders all metrics with their present values.
    pub(super) fn text(&self) -> String {
        let mut page = String::new();
        // Writing to a string cannot fail.
        let _ = text::encode(&mut page, &self.0);
        page
    }
}

/// Reads the counters each time that a page is rendered.
#[derive(Debug)]
struct CountersCollector(Arc<Counters>);

impl Collector for CountersCollector {
    fn encode(&self, encoder: DescriptorEncoder) -> fmt::Result {
        let mut writer = Writer(encoder);
        writer.frames(&self.0.status())?;
        writer.packets(&self.0.status())?;
        writer.impairments(&self.0.status())?;
        writer.step(&self.0.status())?;
        writer.neutral(&self.0.status())?;
        writer.times(&self.0)?;
        let help = "Resident memory of the process.";
        let mut metric = writer.0.encode_descriptor("resident_memory", help, Some(&Unit::Bytes), MetricType::Gauge)?;
        metric.encode_gauge(&resident_bytes())
    }
}

struct Writer<'a>(DescriptorEncoder<'a>);

impl Writer<'_> {
    fn frames(&mut self, status: &Status) -> fmt::Result {
        let results = [("solved", status.solved), ("no_face", status.no_face), ("rejected", status.rejected)];
        self.counters("frames", "Frames processed, by result.", "result", results)?;
        let help = "Failed inferences; their frames are among the rejected ones.";
        self.metric("engine_failures", help, &ConstCounter::new(status.engine_failures))?;
        self.metric("frames_skipped", "Frames skipped for a newer frame.", &ConstCounter::new(status.skipped))?;
        let help = "Frames left out by the present step of the pipeline.";
        self.metric("frames_left_out", help, &ConstCounter::new(status.left_out))?;
        self.metric("frames_damaged", "Frames damaged by camera or cable.", &ConstCounter::new(status.damaged))?;
        let help = "Frames that took longer than the time to the next frame that the step takes.";
        self.metric("deadline_misses", help, &ConstCounter::new(status.deadline_misses))?;
        self.metric("cameras_opened", "Number of times that a camera was opened.", &ConstCounter::new(status.opened))?;
        self.metric("camera_open", "1 if a camera is open, else 0.", &ConstGauge::new(u64::from(status.camera_open)))
    }

    fn packets(&mut self, status: &Status) -> fmt::Result {
        self.metric("packets", "Packets that all links were given to send.", &ConstCounter::new(status.packets))?;
        let results = [("sent", status.sent), ("dropped", status.dropped)];
        self.counters("link_packets", "Packets sent and dropped, summed over all links.", "result", results)?;
        self.metric("links_open", "Links that are open.", &ConstGauge::new(status.links_open))?;
        let gauges = STATES.map(|state| (state.name(), ConstGauge::new(u64::from(state == status.state))));
        self.family("failsafe_state", "1 for the present state of the failsafe, 0 for the others.", "state", &gauges)
    }

    fn impairments(&mut self, status: &Status) -> fmt::Result {
        let present =
            Impairment::ALL.map(|by| (by.name(), ConstGauge::new(u64::from(status.impaired_by.contains(by)))));
        self.family("impaired", "1 for each present impairment of tracking, else 0.", "by", &present)?;
        self.counters("impairments", "How often each impairment has begun.", "by", status.impairments)
    }

    fn step(&mut self, status: &Status) -> fmt::Result {
        let steps = Step::ALL.map(|step| (step.name(), ConstGauge::new(u64::from(step == status.step))));
        self.family("step", "1 for the present step of the pipeline, 0 for the others.", "step", &steps)?;
        let is_cause = |cause| ConstGauge::new(u64::from(status.step_cause == Some(cause)));
        let causes = Cause::ALL.map(|cause| (cause.name(), is_cause(cause)));
        self.family("step_by", "1 for the reason of a step other than full, else 0.", "by", &causes)?;
        self.metric("step_changes", "How often the step has changed.", &ConstCounter::new(status.step_changes))?;
        let help = "1 if the camera is opened with half the width and height, else 0.";
        self.metric("small_picture", help, &ConstGauge::new(u64::from(status.has_small_picture)))
    }

    fn neutral(&mut self, status: &Status) -> fmt::Result {
        let faces = NEUTRAL_FACES.map(|face| (face.name(), ConstGauge::new(u64::from(face == status.neutral_face))));
        let help = "1 for the neutral face that coefficients are measured from, 0 for the others.";
        self.family("neutral_face", help, "from", &faces)?;
        let help = "Share of the estimated face in the neutral face, from 0 to 1; 0 with a calibrated one.";
        self.metric("neutral_share", help, &ConstGauge::new(f64::from(status.neutral_share)))?;
        let help = "How often the estimated neutral face was forgotten because another person sat down.";
        self.metric("neutral_forgotten", help, &ConstCounter::new(status.neutral_forgotten))
    }

    fn times(&mut self, counters: &Counters) -> fmt::Result {
        let times = &counters.times;
        let stages = [
            ("wait", &times.wait),
            ("decode", &times.decode),
            ("detect", &times.detect),
            ("mesh", &times.mesh),
            ("solve", &times.solve),
        ];
        let help = "Time of each stage of a frame; wait lasts from capture to the start of processing.";
        self.histograms("stage", help, &stages.map(|(name, times)| (Some(("stage", name)), times)))?;
        self.histograms("work", "Time from a frame in memory to its result.", &[(None, &times.work)])?;
        self.histograms("age", "Time from the capture of a pose to its sending.", &[(None, &times.age)])
    }

    fn metric(&mut self, name: &str, help: &str, metric: &impl EncodeMetric) -> fmt::Result {
        metric.encode(self.0.encode_descriptor(name, help, None, metric.metric_type())?)
    }

    fn counters<const N: usize>(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        counts: [(&str, u64); N],
    ) -> fmt::Result {
        self.family(name, help, label, &counts.map(|(value, count)| (value, ConstCounter::new(count))))
    }

    /// Writes a metric with one series for each value of the label.
    fn family<M: EncodeMetric + TypedMetric, const N: usize>(
        &mut self,
        name: &str,
        help: &str,
        label: &str,
        metrics: &[(&str, M); N],
    ) -> fmt::Result {
        let mut family = self.0.encode_descriptor(name, help, None, M::TYPE)?;
        metrics.iter().try_for_each(|(value, metric)| metric.encode(family.encode_family(&[(label, *value)])?))
    }

    fn histograms(&mut self, name: &str, help: &str, all: &[(Option<(&str, &str)>, &Histogram)]) -> fmt::Result {
        let mut family = self.0.encode_descriptor(name, help, Some(&Unit::Seconds), MetricType::Histogram)?;
        all.iter().try_for_each(|(label, histogram)| match label {
            Some(label) => encode(histogram, &mut family.encode_family(&[*label])?),
            None => encode(histogram, &mut family),
        })
    }
}

fn encode(histogram: &Histogram, metric: &mut MetricEncoder) -> fmt::Result {
    let limits = limits_ns();
    let (counts, longer) = histogram.counts_between(&limits);
    let limits_s = limits.into_iter().map(|limit_ns| limit_ns as f64 / 1e9);
    let buckets: Vec<_> = limits_s.zip(counts).chain([(f64::INFINITY, longer)]).collect();
    let count = counts.iter().sum::<u64>() + longer;
    metric.encode_histogram::<NoLabelSet>(histogram.sum_s(), count, &buckets, None)
}

/// Returns the resident memory of the process, or 0 if `/proc/self/statm` cannot be read.
fn resident_bytes() -> u64 {
    let pages = fs::read_to_string("/proc/self/statm").unwrap_or_default();
    let resident = pages.split(' ').nth(1).and_then(|pages| pages.parse::<u64>().ok());
    resident.unwrap_or(0) * page_size() as u64
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use std::sync::atomic::Ordering::Relaxed;
    use std::time::Duration;

    use facewire_packet::NeutralFace;

    use super::*;

    #[test]
    fn the_page_shows_the_values_of_the_counters() {
        let counters = Arc::new(Counters::default());
        counters.solved.store(7, Relaxed);
        counters.traffic.dropped.store(2, Relaxed);
        counters.impairments.set(Impairment::Hot, true);
        counters.set_step(Step::Half, Some(Cause::Hot));
        counters.neutral.set(NeutralFace::Estimated, 0.5, 3);
        counters.times.mesh.record(Duration::from_micros(20));
        let page = Page::new(counters).text();
        for line in [
            "# TYPE facewire_frames counter",
            "facewire_frames_total{result=\"solved\"} 7",
            "facewire_link_packets_total{result=\"dropped\"} 2",
            "facewire_failsafe_state{state=\"neutral\"} 1",
            "facewire_failsafe_state{state=\"live\"} 0",
            "facewire_impaired{by=\"hot\"} 1",
            "facewire_impaired{by=\"dark\"} 0",
            "facewire_impairments_total{by=\"hot\"} 1",
            "facewire_step{step=\"half\"} 1",
            "facewire_step{step=\"full\"} 0",
            "facewire_step_by{by=\"hot\"} 1",
            "facewire_step_changes_total 1",
            "facewire_small_picture 0",
            "facewire_neutral_face{from=\"estimated\"} 1",
            "facewire_neutral_face{from=\"mean\"} 0",
            "facewire_neutral_share 0.5",
            "facewire_neutral_forgotten_total 3",
            "# UNIT facewire_stage_seconds seconds",
            "facewire_stage_seconds_bucket{le=\"0.000016384\",stage=\"mesh\"} 0",
            "facewire_stage_seconds_bucket{le=\"0.000024576\",stage=\"mesh\"} 1",
            "facewire_stage_seconds_sum{stage=\"mesh\"} 0.00002",
            "facewire_stage_seconds_count{stage=\"mesh\"} 1",
            "facewire_age_seconds_bucket{le=\"+Inf\"} 0",
            "# EOF",
        ] {
            assert!(page.lines().any(|found| found == line), "no {line} in:\n{page}");
        }
        let memory = page.lines().find_map(|line| line.strip_prefix("facewire_resident_memory_bytes ")).unwrap();
        assert!(memory.parse::<u64>().unwrap() > 1 << 20, "{memory}");
    }
}
