//! The history of the failsafe.

use facewire_packet::{Reason, State};

use crate::link::{Output, Pose};

/// Good poses in a row that end a decay or a neutral face.
const RECOVERY_POSES: u32 = 3;
/// Shortest time from the first to the last of them.
const RECOVERY_US: u64 = 100_000;

/// What the failsafe remembers between updates.
#[derive(Debug, Clone)]
pub struct History {
    pub(super) state: State,
    pub(super) reason: Reason,
    pub(super) shown: Pose,
    pub(super) target: Pose,
    /// Whether `shown` still has to catch up with `target`.
    pub(super) ramping: bool,
    /// Whether the output has not followed any pose yet.
    pub(super) fresh: bool,
    pub(super) age_us: u64,
    pub(super) capture_us: u64,
    pub(super) now_us: Option<u64>,
    /// Capture time of the last pose in the news, followed or not.
    pub(super) heard_us: Option<u64>,
    pub(super) recovery: Recovery,
}

/// Good poses in a row.
#[derive(Debug, Clone, Default)]
pub struct Recovery {
    poses: u32,
    since_first_us: u64,
    since_last_us: u64,
}

impl Recovery {
    fn advance(&mut self, elapsed_us: u64) {
        self.since_first_us = self.since_first_us.saturating_add(elapsed_us);
        self.since_last_us = self.since_last_us.saturating_add(elapsed_us);
    }

    /// Counts a good pose. A pose that comes `gap_us` or more after the last one starts a new row.
    pub fn count(&mut self, gap_us: u64) {
        if self.poses == 0 || self.since_last_us >= gap_us {
            *self = Self::default();
        }
        self.poses = self.poses.saturating_add(1);
        self.since_last_us = 0;
    }

    /// Whether the row is long enough to follow poses again.
    pub fn complete(&self) -> bool {
        self.poses >= RECOVERY_POSES && self.since_first_us >= RECOVERY_US
    }
}

impl Default for History {
    /// Neutral, as before the first frame.
    fn default() -> Self {
        Self {
            state: State::Neutral,
            reason: Reason::NoCamera,
            shown: Pose::NEUTRAL,
            target: Pose::NEUTRAL,
            ramping: false,
            fresh: true,
            age_us: u64::MAX,
            capture_us: 0,
            now_us: None,
            heard_us: None,
            recovery: Recovery::default(),
        }
    }
}

impl History {
    /// Lets time pass, and returns how much. A clock that steps back counts as standing still.
    pub fn advance(&mut self, now_us: u64) -> u64 {
        let elapsed_us = now_us.saturating_sub(self.now_us.unwrap_or(now_us));
        self.now_us = Some(now_us);
        self.age_us = self.age_us.saturating_add(elapsed_us);
        self.recovery.advance(elapsed_us);
        elapsed_us
    }

    /// Notes why there is no pose, and starts the recovery over.
    pub fn fault(&mut self, reason: Reason) {
        self.reason = reason;
        self.recovery = Recovery::default();
    }

    /// The reason to send with the state. While the face is live this is `None`, even if a fault is known already: it is
    /// sent once the state leaves `Live`.
    #[must_use]
    pub fn reason_to_send(&self) -> Reason {
        match self.state {
            State::Live => Reason::None,
            State::Hold | State::Decay | State::Neutral => self.reason,
        }
    }

    /// Follows a good pose from now on. The output moves to it by a ramp if the face was not live before.
    pub fn follow(&mut self, pose: Pose, capture_us: u64, age_us: u64) {
        self.ramping |= self.state != State::Live;
        if self.fresh {
            self.fresh = false;
            self.shown.position_mm = pose.position_mm;
        }
        self.target = pose;
        self.state = State::Live;
        self.reason = Reason::None;
        self.capture_us = capture_us;
        self.age_us = age_us;
    }

    /// The neutral output that a receiver gets last.
    #[must_use]
    pub fn last(&self) -> Output {
        let (state, reason, pose) = (State::Neutral, Reason::Stopping, self.shown.neutral_here());
        Output { state, reason, pose, ..self.output() }
    }

    /// The output of this moment.
    pub(super) fn output(&self) -> Output {
        Output {
            state: self.state,
            reason: self.reason_to_send(),
            pose: self.shown,
            age_us: self.age_us,
            capture_us: self.capture_us,
            followed: false,
            moving: false,
        }
    }
}
