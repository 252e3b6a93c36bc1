//! Whether the threads move: what the watchdog is told, and why it is not.
//!
//! The hot loop says what it is at and since when, the sender that it went round. [`Watch`] judges; it is pure, time
//! is an argument. Waiting is moving, as long as what is waited for may take so long; a stuck inference is not.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use crate::config::CameraSettings;

/// Longest time that opening or closing a camera may take, microseconds: some control calls of a USB camera, each
/// given up by the kernel after 5 s, then up to 5 s for the first frame.
const CAMERA_PATIENCE_US: u64 = 30_000_000;
/// Stall timeouts that one frame may take: one for it, and one for a newer where it lay waiting for long.
const WAITS_PER_FRAME: u64 = 2;
/// Added to the wait for a frame, so that the camera's own timeout comes first, microseconds.
const GRACE_US: u64 = 1_000_000;
/// Bits that hold the phase beside the time.
const PHASE_BITS: u32 = 2;

/// What the hot loop is at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Phase {
    /// Opens a camera, closes it, or waits before the next attempt.
    Camera,
    /// Waits for a frame.
    Frame,
    /// Works on a frame.
    Work,
}

/// Signs of life, written by the threads.
#[derive(Debug, Default)]
pub(super) struct Heartbeats {
    /// Phase and the time it began in one word, so that they always belong together.
    hot: AtomicU64,
    sender_us: AtomicU64,
}

impl Heartbeats {
    /// The hot loop enters a phase.
    pub(super) fn enter(&self, phase: Phase, now_us: u64) {
        self.hot.store(now_us << PHASE_BITS | phase as u64, Relaxed);
    }

    /// The sender went round.
    pub(super) fn sender(&self, now_us: u64) {
        self.sender_us.store(now_us, Relaxed);
    }

    pub(super) fn read(&self) -> Beats {
        let hot = self.hot.load(Relaxed);
        let phase = match hot & ((1 << PHASE_BITS) - 1) {
            0 => Phase::Camera,
            1 => Phase::Frame,
            _ => Phase::Work,
        };
        Beats { phase, since_us: hot >> PHASE_BITS, sender_us: self.sender_us.load(Relaxed) }
    }
}

/// The signs of life at one moment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Beats {
    pub(super) phase: Phase,
    /// When the phase began.
    pub(super) since_us: u64,
    /// When the sender last went round.
    pub(super) sender_us: u64,
}

/// How long the hot loop may wait; the greater is the more patient.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Watch {
    frame_patience_us: u64,
}

impl Watch {
    pub(super) fn new(camera: &CameraSettings) -> Self {
        Self { frame_patience_us: u64::from(camera.stall_timeout_ms) * 1000 * WAITS_PER_FRAME + GRACE_US }
    }

    /// Whether both threads have moved since `last_us`.
    pub(super) fn moved(self, beats: &Beats, now_us: u64, last_us: u64) -> bool {
        self.hot_moved(beats, now_us, last_us) && beats.sender_us > last_us
    }

    fn hot_moved(self, beats: &Beats, now_us: u64, last_us: u64) -> bool {
        let patience_us = match beats.phase {
            Phase::Camera => CAMERA_PATIENCE_US,
            Phase::Frame => self.frame_patience_us,
            Phase::Work => 0,
        };
        beats.since_us > last_us || now_us.saturating_sub(beats.since_us) < patience_us
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000;

    fn watch() -> Watch {
        Watch::new(&CameraSettings { stall_timeout_ms: 1000, ..CameraSettings::default() })
    }

    /// Whether a hot loop that entered the phase at 100 s is seen to move at `now_us`, a second after the last ping.
    fn moves(phase: Phase, now_us: u64) -> bool {
        let beats = Beats { phase, since_us: 100 * S, sender_us: now_us };
        watch().moved(&beats, now_us, now_us - S)
    }

    #[test]
    fn an_inference_stuck_since_before_the_last_ping_is_no_movement() {
        assert!(moves(Phase::Work, 100 * S + S / 2), "began after the last ping");
        assert!(!moves(Phase::Work, 101 * S));
        assert!(!moves(Phase::Work, 102 * S));
    }

    #[test]
    fn opening_a_camera_is_movement_for_30_s() {
        assert!(moves(Phase::Camera, 110 * S), "two control calls that the kernel gave up");
        assert!(moves(Phase::Camera, 130 * S - 1));
        assert!(!moves(Phase::Camera, 130 * S));
    }

    #[test]
    fn waiting_for_a_frame_is_movement_until_the_stall_timeout_must_be_over() {
        assert!(moves(Phase::Frame, 102 * S), "the stall timeout and more");
        assert!(moves(Phase::Frame, 103 * S - 1), "twice, and a second of grace");
        assert!(!moves(Phase::Frame, 103 * S));
    }

    #[test]
    fn a_sender_that_did_not_go_round_since_the_last_ping_is_stuck() {
        let beats = Beats { phase: Phase::Frame, since_us: 100 * S, sender_us: 99 * S };
        assert!(watch().moved(&beats, 100 * S, 98 * S));
        assert!(!watch().moved(&beats, 100 * S, 99 * S));
    }

    #[test]
    fn phases_are_read_as_they_were_entered() {
        let beats = Heartbeats::default();
        for phase in [Phase::Camera, Phase::Frame, Phase::Work] {
            beats.enter(phase, 5 * S);
            assert_eq!((beats.read().phase, beats.read().since_us), (phase, 5 * S));
        }
    }
}
