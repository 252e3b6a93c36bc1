//! What the threads count, shared without a lock and in fixed memory.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering::Relaxed};

use super::heartbeat::Heartbeats;

/// Width of a latency bucket, microseconds.
const BUCKET_US: u64 = 250;
/// Latencies up to 256 ms are told apart; longer ones fall into the last bucket.
const BUCKETS: usize = 1024;
/// The last bucket's end, milliseconds.
const LONGEST_MS: f64 = (BUCKET_US * BUCKETS as u64) as f64 / 1000.0;

/// Counters of a running service. Every one only grows, but for the links that are open.
#[derive(Debug)]
pub struct Counters {
    stop: Arc<AtomicBool>,
    stop_sending: AtomicBool,
    /// What the watchdog goes by.
    pub(super) beats: Heartbeats,
    /// Frames the pipeline was given.
    pub(super) frames: AtomicU64,
    /// Frames with a solution.
    pub(super) solved: AtomicU64,
    /// Frames rejected though there was a face.
    pub(super) rejected: AtomicU64,
    /// Frames passed over because a newer one was there.
    pub(super) skipped: AtomicU64,
    /// Frames that were damaged.
    pub(super) damaged: AtomicU64,
    /// Times a camera was opened.
    pub(super) opened: AtomicU64,
    /// Packets given to each link.
    pub(super) packets: AtomicU64,
    /// Packets that a link did not take.
    pub(super) dropped: AtomicU64,
    /// Links that are open at present.
    pub(super) links_open: AtomicU64,
    /// Microseconds between frames that give a pose, for the failsafe's patience.
    pub(super) frame_period_us: AtomicU64,
    /// From capture to sending.
    latency: [AtomicU32; BUCKETS],
}

impl Default for Counters {
    fn default() -> Self {
        let zero = || AtomicU64::new(0);
        Self {
            stop: Arc::default(),
            stop_sending: AtomicBool::new(false),
            beats: Heartbeats::default(),
            frames: zero(),
            solved: zero(),
            rejected: zero(),
            skipped: zero(),
            damaged: zero(),
            opened: zero(),
            packets: zero(),
            dropped: zero(),
            links_open: zero(),
            frame_period_us: zero(),
            latency: [const { AtomicU32::new(0) }; BUCKETS],
        }
    }
}

impl Counters {
    /// Whether the service is to stop.
    pub(super) fn stopping(&self) -> bool {
        self.stop.load(Relaxed)
    }

    /// The flag that signals set.
    pub(super) fn stop_flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
    }

    /// Whether the sender is to say its last word.
    pub(super) fn sending_stops(&self) -> bool {
        self.stop_sending.load(Relaxed)
    }

    /// Tells all threads to end.
    pub(super) fn stop(&self) {
        self.stop.store(true, Relaxed);
        self.stop_sending.store(true, Relaxed);
    }

    /// Counts the time from a frame's capture to the sending of its pose.
    pub(super) fn count_latency(&self, latency_us: u64) {
        let bucket = usize::try_from(latency_us / BUCKET_US).unwrap_or(BUCKETS).min(BUCKETS - 1);
        if let Some(count) = self.latency.get(bucket) {
            count.fetch_add(1, Relaxed);
        }
    }

    /// All counts now.
    #[must_use]
    pub fn status(&self) -> Status {
        Status {
            frames: self.frames.load(Relaxed),
            solved: self.solved.load(Relaxed),
            rejected: self.rejected.load(Relaxed),
            skipped: self.skipped.load(Relaxed),
            damaged: self.damaged.load(Relaxed),
            opened: self.opened.load(Relaxed),
            packets: self.packets.load(Relaxed),
            dropped: self.dropped.load(Relaxed),
            links_open: self.links_open.load(Relaxed),
            latency_ms: [0.5, 0.95, 0.99].map(|part| self.latency_ms(part)),
        }
    }

    /// The latency that `part` of the poses did not exceed; 0 before the first.
    fn latency_ms(&self, part: f64) -> f64 {
        let counts = self.latency.iter().map(|count| u64::from(count.load(Relaxed)));
        let total: u64 = counts.clone().sum();
        let wanted = part * total as f64;
        let below = counts.scan(0, |sum, count| {
            *sum += count;
            Some(*sum)
        });
        let buckets = below.take_while(|sum| (*sum as f64) < wanted).count() as u64;
        if total == 0 { 0.0 } else { ((buckets + 1) * BUCKET_US) as f64 / 1000.0 }
    }
}

/// A latency as the status line has it.
fn shown_ms(ms: f64) -> String {
    if ms < LONGEST_MS { format!("{ms:.2}") } else { format!(">{LONGEST_MS}") }
}

/// The counts at one moment; prints as the status line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// Frames the pipeline was given.
    pub frames: u64,
    /// Frames with a solution.
    pub solved: u64,
    /// Frames rejected though there was a face.
    pub rejected: u64,
    /// Frames passed over because a newer one was there.
    pub skipped: u64,
    /// Frames that were damaged.
    pub damaged: u64,
    /// Times a camera was opened.
    pub opened: u64,
    /// Packets sent.
    pub packets: u64,
    /// Packets that a link did not take.
    pub dropped: u64,
    /// Links that are open at present.
    pub links_open: u64,
    /// From capture to sending: p50, p95, p99, milliseconds.
    pub latency_ms: [f64; 3],
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [p50, p95, p99] = self.latency_ms.map(shown_ms);
        write!(
            f,
            "frames={} faces={} rejected={} skipped={} damaged={} cameras_opened={} packets={} dropped={} \
             links_open={} latency_ms p50={p50} p95={p95} p99={p99}",
            self.frames,
            self.solved,
            self.rejected,
            self.skipped,
            self.damaged,
            self.opened,
            self.packets,
            self.dropped,
            self.links_open
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latencies_are_told_to_a_quarter_of_a_millisecond() {
        let counters = Counters::default();
        (1..=100).for_each(|ms| counters.count_latency(ms * 1000));
        let [p50, p95, p99] = counters.status().latency_ms;
        assert!((p50 - 50.0).abs() <= 0.25 && (p95 - 95.0).abs() <= 0.25 && (p99 - 99.0).abs() <= 0.25);
    }

    #[test]
    fn latency_beyond_the_last_bucket_is_counted_there_and_told_as_more() {
        let counters = Counters::default();
        counters.count_latency(u64::MAX);
        assert!(counters.status().to_string().contains("p50=>256 "));
    }
}
