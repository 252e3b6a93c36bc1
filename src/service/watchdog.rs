//! The signs of life on which the pings for the service manager's watchdog depend.
//!
//! The hot loop and the sender each state by when they will report again. A thread that lets its deadline pass is stuck,
//! and the watchdog is no longer served. The patience of each phase is far longer than it takes on a healthy machine,
//! because waiting for a camera is not being stuck, and neither is a slow frame on a throttled board.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Longest time to load networks or a model, to open or close a camera, or to pause before the next attempt, microseconds.
/// The kernel gives up each control call to a USB camera after 5 s, and the first frame may take another 5 s.
pub(super) const OPEN_US: u64 = 30_000_000;
/// Longest time to work on one frame, microseconds. Emulated and swapping machines have taken 2 s.
pub(super) const WORK_US: u64 = 10_000_000;
/// A frame may take two stall timeouts: one to arrive, and one more for a newer frame if it waited in a buffer for long.
const STALL_TIMEOUTS_PER_FRAME: u64 = 2;
/// Time added to the stall timeouts, microseconds: half a second for frames that a step leaves out, and as much to spare.
const GRACE_US: u64 = 1_000_000;
/// Longest time between two rounds of the sender, which sleeps for 0.1 s at most, microseconds.
const SENDER_PATIENCE_US: u64 = 5_000_000;

/// Longest time to wait for a frame of a camera with this stall timeout, microseconds.
pub(super) fn wait_us(stall_timeout_ms: u32) -> u64 {
    u64::from(stall_timeout_ms) * 1000 * STALL_TIMEOUTS_PER_FRAME + GRACE_US
}

/// The deadlines, on the monotonic clock. The threads write them, the supervisor reads them.
#[derive(Debug, Default)]
pub(super) struct Heartbeats {
    hot_deadline_us: AtomicU64,
    sender_deadline_us: AtomicU64,
}

impl Heartbeats {
    pub(super) fn hot(&self, patience_us: u64, now_us: u64) {
        self.hot_deadline_us.store(now_us + patience_us, Relaxed);
    }

    pub(super) fn sender(&self, now_us: u64) {
        self.sender_deadline_us.store(now_us + SENDER_PATIENCE_US, Relaxed);
    }

    pub(super) fn are_alive(&self, now_us: u64) -> bool {
        [&self.hot_deadline_us, &self.sender_deadline_us].iter().all(|deadline_us| now_us < deadline_us.load(Relaxed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    #[test]
    fn each_phase_is_stuck_after_its_own_time() {
        for (patience_us, expected_s) in [(WORK_US, 10), (OPEN_US, 30), (wait_us(1000), 3), (wait_us(60_000), 121)] {
            let heartbeats = Heartbeats::default();
            heartbeats.hot(patience_us, 100 * S);
            let alive_s = (100..400).take_while(|at_s| {
                heartbeats.sender(at_s * S);
                heartbeats.are_alive(at_s * S)
            });
            assert_eq!(alive_s.count(), expected_s, "{patience_us}");
        }
    }

    #[test]
    fn a_sender_that_stops_going_round_is_noticed_after_5_s() {
        let heartbeats = Heartbeats::default();
        heartbeats.hot(OPEN_US, 100 * S);
        heartbeats.sender(100 * S);
        assert!(heartbeats.are_alive(105 * S - 1) && !heartbeats.are_alive(105 * S));
    }
}
