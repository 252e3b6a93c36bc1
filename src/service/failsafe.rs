//! The failsafe: what the face shows while no poses come.
//!
//! Role: stands between the pipeline and the links, in the sender's thread, so that neither a stuck inference nor a lost
//! camera can freeze a face. [`State`] has the diagram.
//! Contract: [`Failsafe::update`] is called for every pose and fault, and no later than [`Failsafe::wait_us`] after the
//! last call. All times count from the capture of the last pose that the output followed. The output moves at most by
//! `slew_per_s`, except while the face is live and the output has caught up with it.
//! Limits: a clock that stands still or steps back delays transitions by the step and does no other harm. The head's
//! rotation decays with the coefficients; its position has no neutral value and stays.

mod history;
mod pose;
#[cfg(test)]
mod tests;

use std::time::Duration;

use facewire_packet::{Reason, State};

pub use history::History;

use crate::config::FailsafeSettings;
use crate::link::{Output, Pose};

/// Frame periods without a pose for which the face stays live: a camera may drop two frames in a row.
const LIVE_FRAMES: u64 = 3;
/// Number of neutral packets that the sender sends last, because some may be lost.
pub const STOPPING_PACKETS: usize = 3;

/// The limits of the failsafe.
#[derive(Debug, Clone, PartialEq)]
pub struct Failsafe {
    live_us: u64,
    hold_us: u64,
    neutral_us: u64,
    slew_per_s: f32,
}

/// What has happened since the last update.
#[derive(Debug, Clone, Copy)]
pub enum News<'a> {
    /// Nothing, except that time has passed.
    Nothing,
    /// The newest pose and the capture time of its frame. A pose that was given before changes nothing.
    Pose(&'a Pose, u64),
    /// Why there is no pose. The reason stands until a pose or another fault comes.
    Fault(Reason),
}

impl Failsafe {
    /// Returns the limits in the settings, for a camera of this frame period. If three frame periods take longer than
    /// `live_ms`, all times move by the difference.
    #[must_use]
    pub fn new(settings: &FailsafeSettings, frame_period_us: u64) -> Self {
        let [live_us, hold_us, neutral_us] =
            [settings.live_ms, settings.hold_ms, settings.neutral_ms].map(|ms| u64::from(ms) * 1000);
        let longer_us = frame_period_us.saturating_mul(LIVE_FRAMES).saturating_sub(live_us);
        Self {
            live_us: live_us.saturating_add(longer_us),
            hold_us: hold_us.saturating_add(longer_us),
            neutral_us: neutral_us.saturating_add(longer_us),
            slew_per_s: settings.slew_per_s,
        }
    }

    /// Lets time pass, takes in the news, moves the output and returns it.
    pub fn update(&self, history: &mut History, now_us: u64, news: News<'_>) -> Output {
        let before_us = history.age_us;
        let elapsed_us = history.advance(now_us);
        self.age(history);
        let followed = self.hear(history, now_us, news);
        self.move_output(history, before_us, elapsed_us);
        let moving = history.state == State::Decay || (history.state == State::Live && history.ramping);
        Output { followed, moving, ..history.output() }
    }

    /// Moves the face towards neutral as fast as `slew_per_s` allows, because the service stops. The state is
    /// [`State::Neutral`] once the face is neutral.
    pub fn stop(&self, history: &mut History, now_us: u64) -> Output {
        let elapsed_us = history.advance(now_us);
        let neutral = history.shown.neutral_here();
        history.shown = history.shown.towards(&neutral, 1.0, self.slew(elapsed_us));
        let state = if history.shown == neutral { State::Neutral } else { State::Decay };
        Output { state, reason: Reason::Stopping, moving: true, ..history.output() }
    }

    /// How far the output may move in this time.
    fn slew(&self, elapsed_us: u64) -> f32 {
        self.slew_per_s * Duration::from_micros(elapsed_us).as_secs_f32()
    }

    /// Time from the last update to the next change of state, if no pose or fault comes first.
    #[must_use]
    pub fn wait_us(&self, history: &History) -> u64 {
        let next_state_us = match history.state {
            State::Live => self.live_us,
            State::Hold => self.hold_us,
            State::Decay => self.neutral_us,
            State::Neutral => u64::MAX,
        };
        let until_state_us = next_state_us.checked_sub(history.age_us).filter(|us| *us > 0);
        until_state_us.unwrap_or(u64::MAX)
    }

    /// Leaves the states live and hold when their time is over.
    fn age(&self, history: &mut History) {
        history.state = match history.state {
            State::Neutral => State::Neutral,
            _ if history.age_us >= self.hold_us => State::Decay,
            _ if history.age_us >= self.live_us => State::Hold,
            state => state,
        };
        if history.state != State::Live && history.reason == Reason::None {
            history.reason = Reason::Late;
        }
    }

    /// Takes in the news. Returns whether the output follows a new pose from now on.
    fn hear(&self, history: &mut History, now_us: u64, news: News<'_>) -> bool {
        let (pose, capture_us) = match news {
            News::Nothing => return false,
            News::Fault(reason) => {
                history.fault(reason);
                return false;
            }
            News::Pose(pose, capture_us) => (pose, capture_us),
        };
        if history.heard_us.replace(capture_us) == Some(capture_us) {
            return false;
        }
        let age_us = now_us.saturating_sub(capture_us);
        let Some(pose) = pose.checked() else {
            history.fault(Reason::BadResult);
            return false;
        };
        if age_us >= self.live_us {
            history.fault(Reason::Late);
            return false;
        }
        history.recovery.count(self.live_us);
        let waiting = matches!(history.state, State::Decay | State::Neutral);
        if waiting && !history.recovery.complete() {
            return false;
        }
        history.follow(pose, capture_us, age_us);
        true
    }

    /// Moves the output as far as the elapsed time allows.
    fn move_output(&self, history: &mut History, before_us: u64, elapsed_us: u64) {
        let limit = self.slew(elapsed_us);
        match history.state {
            State::Live if history.ramping => {
                history.shown = history.shown.towards(&history.target, 1.0, limit);
                history.ramping = history.shown != history.target;
            }
            State::Live => history.shown = history.target,
            State::Hold | State::Neutral => {}
            State::Decay => {
                let part = self.decayed_part(before_us, history.age_us);
                let neutral = history.shown.neutral_here();
                history.shown = history.shown.towards(&neutral, part, limit);
                if part >= 1.0 && history.shown == neutral {
                    history.state = State::Neutral;
                }
            }
        }
    }

    /// Which part of the remaining way to neutral the face covers between two ages: a straight line that ends at
    /// `neutral_us`.
    fn decayed_part(&self, before_us: u64, age_us: u64) -> f32 {
        let from_us = before_us.max(self.hold_us);
        let left = Duration::from_micros(self.neutral_us.saturating_sub(from_us));
        let passed = Duration::from_micros(age_us.saturating_sub(from_us));
        if passed >= left { 1.0 } else { passed.div_duration_f32(left) }
    }
}
