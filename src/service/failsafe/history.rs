//! What the failsafe remembers.

use facewire_packet::{Reason, State};

use super::{Output, Pose};

/// Good poses in a row that end a decay or a neutral face.
const RECOVERY_POSES: u32 = 3;
/// Time from the first to the last of them, at least.
const RECOVERY_US: u64 = 100_000;

/// What the failsafe remembers from update to update.
#[derive(Debug, Clone)]
pub struct History {
    pub(super) state: State,
    pub(super) reason: Reason,
    pub(super) shown: Pose,
    pub(super) target: Pose,
    /// Live, but `shown` has not caught up with `target`.
    pub(super) ramping: bool,
    /// No pose was followed yet.
    pub(super) fresh: bool,
    pub(super) age_us: u64,
    pub(super) capture_us: u64,
    pub(super) now_us: Option<u64>,
    /// Capture time of the last pose heard of, followed or not.
    pub(super) heard_us: Option<u64>,
    pub(super) recovery: Recovery,
    pub(super) sent: Option<(State, Reason)>,
    pub(super) since_sent_us: u64,
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

    /// Counts a good pose; a gap of `gap_us` begins a new row.
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
    /// Neutral, before any frame.
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
            sent: None,
            since_sent_us: u64::MAX,
        }
    }
}

impl History {
    /// Lets time pass; returns how much. A clock that steps back has stood still.
    pub fn advance(&mut self, now_us: u64) -> u64 {
        let elapsed_us = now_us.saturating_sub(self.now_us.unwrap_or(now_us));
        self.now_us = Some(now_us);
        self.age_us = self.age_us.saturating_add(elapsed_us);
        self.since_sent_us = self.since_sent_us.saturating_add(elapsed_us);
        self.recovery.advance(elapsed_us);
        elapsed_us
    }

    /// Notes why there is no pose, and begins the recovery anew.
    pub fn fault(&mut self, reason: Reason) {
        self.reason = reason;
        self.recovery = Recovery::default();
    }

    /// The reason that goes with the state: while live, one that is known already is not told yet.
    #[must_use]
    pub fn told_reason(&self) -> Reason {
        match self.state {
            State::Live => Reason::None,
            State::Hold | State::Decay | State::Neutral => self.reason,
        }
    }

    /// Makes a good pose the one to show, by a ramp when the output stood still or decayed before.
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

    /// What is shown, by a sender that stops.
    pub(super) fn stopping(&self) -> Output {
        Output {
            state: State::Neutral,
            reason: Reason::Stopping,
            pose: self.shown,
            age_us: self.age_us,
            capture_us: self.capture_us,
            due: true,
        }
    }
}
