//! Signs of life of the hot loop and the sender, on which the service manager's watchdog depends.
//!
//! Each thread states by when it will report again: its deadline. A thread that lets its deadline pass is stuck, and the
//! watchdog is no longer served. Waiting for a camera is not being stuck, and neither is a slow frame on a throttled
//! board: the patience of each phase is far longer than the phase takes on a healthy machine.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Longest time to open or close a camera, microseconds. The kernel gives up each control call to a USB camera after
/// 5 s, and the first frame may take another 5 s.
const CAMERA_PATIENCE_US: u64 = 30_000_000;
/// A frame may take two stall timeouts: one to arrive, and one more for a newer frame if it waited in a buffer for long.
const STALL_TIMEOUTS_PER_FRAME: u64 = 2;
/// Added to the wait for a frame, microseconds: half a second for the frames that a step leaves out, and as much again, so
/// that the camera's own timeout comes first.
const GRACE_US: u64 = 1_000_000;
/// Longest time to work on one frame, microseconds. Emulated and swapping machines have taken 2 s.
const WORK_PATIENCE_US: u64 = 10_000_000;
/// Longest time between two rounds of the sender, which sleeps for 0.1 s at most, microseconds.
const SENDER_PATIENCE_US: u64 = 5_000_000;

/// What the hot loop is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// Loads networks or a model, opens or closes a camera, or pauses before the next attempt.
    Open,
    /// Waits for a frame from a camera with this stall timeout.
    Wait { stall_timeout_ms: u32 },
    /// Works on a frame.
    Work,
}

impl Phase {
    fn patience_us(self) -> u64 {
        match self {
            Self::Open => CAMERA_PATIENCE_US,
            Self::Wait { stall_timeout_ms } => u64::from(stall_timeout_ms) * 1000 * STALL_TIMEOUTS_PER_FRAME + GRACE_US,
            Self::Work => WORK_PATIENCE_US,
        }
    }
}

/// The deadlines, on the monotonic clock. The threads write them, the supervisor reads them.
#[derive(Debug, Default)]
pub(super) struct Heartbeats {
    hot_deadline_us: AtomicU64,
    sender_deadline_us: AtomicU64,
}

impl Heartbeats {
    /// The hot loop begins a phase.
    pub(super) fn hot(&self, phase: Phase, now_us: u64) {
        self.hot_deadline_us.store(now_us + phase.patience_us(), Relaxed);
    }

    /// The sender begins another round.
    pub(super) fn sender(&self, now_us: u64) {
        self.sender_deadline_us.store(now_us + SENDER_PATIENCE_US, Relaxed);
    }

    /// Whether both threads are within their deadlines.
    pub(super) fn are_alive(&self, now_us: u64) -> bool {
        [&self.hot_deadline_us, &self.sender_deadline_us].iter().all(|deadline_us| now_us < deadline_us.load(Relaxed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    /// How long the watchdog is served after the hot loop began a phase, if the sender goes on, seconds.
    fn patience_s(phase: Phase) -> f64 {
        let heartbeats = Heartbeats::default();
        heartbeats.hot(phase, 100 * S);
        let alive = |at_us: &u64| {
            heartbeats.sender(*at_us);
            heartbeats.are_alive(*at_us)
        };
        let passed = (100 * S..).step_by(100_000).take_while(alive).count();
        passed as f64 / 10.0
    }

    #[test]
    fn each_phase_is_stuck_after_its_own_time() {
        let wait = |stall_timeout_ms| Phase::Wait { stall_timeout_ms };
        for (phase, expected_s) in [(Phase::Work, 10.0), (Phase::Open, 30.0), (wait(1000), 3.0), (wait(60_000), 121.0)]
        {
            assert!((patience_s(phase) - expected_s).abs() < 0.11, "{phase:?}");
        }
    }

    #[test]
    fn a_sender_that_stops_going_round_is_noticed_after_5_s() {
        let heartbeats = Heartbeats::default();
        heartbeats.hot(Phase::Open, 100 * S);
        heartbeats.sender(100 * S);
        assert!(heartbeats.are_alive(105 * S - 1));
        assert!(!heartbeats.are_alive(105 * S));
    }
}
