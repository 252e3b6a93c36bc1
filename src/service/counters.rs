//! What the threads count, shared without a lock and in fixed memory.

use std::fmt;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::time::Duration;

use facewire_packet::State;

use super::heartbeat::Heartbeats;
use super::times::{Quantiles, Times};
use crate::link::Traffic;

/// States by their number in [`Counters::state`].
pub(super) const STATES: [State; 4] = [State::Neutral, State::Live, State::Hold, State::Decay];

/// Counters of a running service. Every one only grows, but for those that say "at present". How they add up is told at
/// [`Status`].
#[derive(Debug, Default)]
pub struct Counters {
    stop: Arc<AtomicBool>,
    stop_sending: AtomicBool,
    /// Signs of life, for the watchdog.
    pub(super) heartbeats: Heartbeats,
    /// Frames the pipeline was given.
    pub(super) frames: AtomicU64,
    /// Frames with a solution.
    pub(super) solved: AtomicU64,
    /// Frames that show no face.
    pub(super) no_face: AtomicU64,
    /// Frames rejected though there was a face.
    pub(super) rejected: AtomicU64,
    /// Failed inferences; their frames are among the rejected ones.
    pub(super) engine_failures: AtomicU64,
    /// Frames passed over because a newer one was there.
    pub(super) skipped: AtomicU64,
    /// Frames whose work took longer than the camera's frame period.
    pub(super) deadline_misses: AtomicU64,
    /// Frames that were damaged.
    pub(super) damaged: AtomicU64,
    /// Times a camera was opened.
    pub(super) opened: AtomicU64,
    /// Whether a camera is open at present.
    pub(super) camera_open: AtomicBool,
    /// Packets of all links, counted by the links themselves.
    pub(super) traffic: Arc<Traffic>,
    /// Links that are open at present.
    pub(super) links_open: AtomicU64,
    /// The first link whose last packet the network did not take, by its place plus 1, and why; 0 is none. One word, so
    /// that both belong together.
    refusal: AtomicU64,
    /// Microseconds between frames that give a pose at present, for the failsafe's patience.
    pub(super) frame_period_us: AtomicU64,
    /// The failsafe's state at present, by its place in [`STATES`].
    state: AtomicU64,
    /// How long frames take.
    pub(super) times: Times,
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

    /// The network does not take the packets of the link at this place, for a reason by the system's number.
    pub(super) fn refuse(&self, refusal: Option<(u32, i32)>) {
        let word = refusal.map_or(0, |(place, reason)| (u64::from(place) + 1) << 32 | u64::from(reason.unsigned_abs()));
        self.refusal.store(word, Relaxed);
    }

    /// What [`Counters::refuse`] said last.
    pub(super) fn refusal(&self) -> Option<(usize, io::Error)> {
        let word = self.refusal.load(Relaxed);
        let place = usize::try_from(word >> 32).ok()?.checked_sub(1)?;
        let reason = i32::try_from(word & u64::from(u32::MAX)).ok()?;
        Some((place, io::Error::from_raw_os_error(reason)))
    }

    /// The failsafe is in this state now. It sends every change of it.
    pub(super) fn set_state(&self, state: State) {
        let number = STATES.iter().zip(0..).find(|(known, _)| **known == state);
        self.state.store(number.map_or(0, |(_, number)| number), Relaxed);
    }

    /// A frame was worked on for so long; longer than `deadline` makes the camera's next one wait.
    pub(super) fn worked(&self, work: Duration, deadline: Duration) {
        self.times.work.record(work);
        self.deadline_misses.fetch_add(u64::from(work > deadline), Relaxed);
    }

    /// All counts now.
    #[must_use]
    pub fn status(&self) -> Status {
        let state = usize::try_from(self.state.load(Relaxed)).ok().and_then(|number| STATES.get(number));
        Status {
            frames: self.frames.load(Relaxed),
            solved: self.solved.load(Relaxed),
            no_face: self.no_face.load(Relaxed),
            rejected: self.rejected.load(Relaxed),
            engine_failures: self.engine_failures.load(Relaxed),
            skipped: self.skipped.load(Relaxed),
            deadline_misses: self.deadline_misses.load(Relaxed),
            damaged: self.damaged.load(Relaxed),
            opened: self.opened.load(Relaxed),
            camera_open: self.camera_open.load(Relaxed),
            packets: self.traffic.packets.load(Relaxed),
            sent: self.traffic.sent.load(Relaxed),
            dropped: self.traffic.dropped.load(Relaxed),
            links_open: self.links_open.load(Relaxed),
            state: state.copied().unwrap_or_default(),
            times_ms: self.times.quantiles(),
        }
    }
}

/// The counts at one moment; prints as the status line.
///
/// How they add up, once the threads have ended (a line of a running service may be one frame or packet off):
/// - `frames = solved + no_face + rejected`;
/// - `packets = sent + dropped`, each over all links, including those that a reload has replaced.
///
/// `skipped` and `damaged` frames never reached the pipeline and are not in `frames`. A `deadline_misses` frame is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Status {
    /// Frames the pipeline was given.
    pub frames: u64,
    /// Frames with a solution.
    pub solved: u64,
    /// Frames that show no face.
    pub no_face: u64,
    /// Frames rejected though there was a face.
    pub rejected: u64,
    /// Failed inferences; their frames are among the rejected ones.
    pub engine_failures: u64,
    /// Frames passed over because a newer one was there.
    pub skipped: u64,
    /// Frames whose work took longer than the camera's frame period.
    pub deadline_misses: u64,
    /// Frames that were damaged.
    pub damaged: u64,
    /// Times a camera was opened.
    pub opened: u64,
    /// Whether a camera is open at present.
    pub camera_open: bool,
    /// Packets that all links were given to send.
    pub packets: u64,
    /// Packets that all links sent.
    pub sent: u64,
    /// Packets that all links dropped.
    pub dropped: u64,
    /// Links that are open at present.
    pub links_open: u64,
    /// The failsafe's state.
    pub state: State,
    /// Names and distributions of times: wait, detect, mesh, solve, work, age.
    pub times_ms: [(&'static str, Quantiles); 6],
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "frames={} faces={} no_face={} rejected={}", self.frames, self.solved, self.no_face, self.rejected)?;
        let Self { skipped, deadline_misses, damaged, opened, .. } = self;
        write!(
            f,
            " engine_failures={} skipped={skipped} deadline_misses={deadline_misses} damaged={damaged} cameras_opened={opened}",
            self.engine_failures
        )?;
        write!(f, " packets={} sent={} dropped={}", self.packets, self.sent, self.dropped)?;
        write!(f, " links_open={} state={}", self.links_open, self.state.name())?;
        self.times_ms.iter().try_for_each(|(name, quantiles)| write!(f, " {name}_ms={quantiles}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_status_line_has_every_count_under_its_name() {
        let counters = Counters::default();
        counters.frames.store(10, Relaxed);
        counters.no_face.store(1, Relaxed);
        counters.deadline_misses.store(2, Relaxed);
        counters.traffic.sent.store(3, Relaxed);
        counters.times.age.record(Duration::from_millis(8));
        let line = counters.status().to_string();
        let parts = ["frames=10 ", " no_face=1 ", " deadline_misses=2 ", " sent=3 ", " wait_ms=0.000/0.000/0.000 "];
        assert!(parts.iter().all(|part| line.contains(part)), "{line}");
        assert!(line.ends_with(" age_ms=8.13/8.13/8.13"), "{line}");
        assert!(line.split(' ').all(|part| part.matches('=').count() == 1), "{line}");
    }

    #[test]
    fn work_as_long_as_the_frame_period_is_in_time_and_a_microsecond_longer_is_a_miss() {
        let counters = Counters::default();
        let misses = |work_us| {
            counters.worked(Duration::from_micros(work_us), Duration::from_micros(33_333));
            counters.status().deadline_misses
        };
        assert_eq!([0, 33_333, 33_334, 33_333, 500_000].map(misses), [0, 0, 1, 1, 2]);
    }

    #[test]
    fn a_refusal_is_told_with_its_link_and_reason_until_there_is_none() {
        let counters = Counters::default();
        assert!(counters.refusal().is_none());
        counters.refuse(Some((2, 101)));
        let (place, reason) = counters.refusal().unwrap();
        assert_eq!((place, reason.raw_os_error()), (2, Some(101)));
        counters.refuse(None);
        assert!(counters.refusal().is_none());
    }

    #[test]
    fn the_state_told_is_the_one_that_was_set() {
        let counters = Counters::default();
        assert_eq!(counters.status().state, State::Neutral);
        for state in STATES {
            counters.set_state(state);
            assert_eq!(counters.status().state, state);
        }
    }
}
