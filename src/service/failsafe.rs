//! The failsafe: what the face shows while no poses come.
//!
//! [`State`] has the diagram. [`Failsafe::update`] is called for every pose and fault, and no later than
//! [`Failsafe::wait_us`] after the last call. All times count from the capture of the last pose that the output followed.
//! The output moves at most by `slew_per_s`, except while the face is live and the output has caught up with it. A clock
//! that stands still or steps back delays transitions by the step and does no other harm. The head's rotation decays with
//! the coefficients; its position has no neutral value and stays.

#[cfg(test)]
mod tests;

use std::time::Duration;

use facewire_packet::{Pose, Reason, State};
use nalgebra::Quaternion;

use crate::config::FailsafeSettings;
use crate::link::{LONGEST_STEP_US, Output, towards};

/// Frame periods without a pose for which the face stays live: a camera may drop two frames in a row.
pub(super) const LIVE_FRAMES: u64 = 3;
/// Good poses in a row that end a decay or a neutral face, and the shortest time from the first to the last of them.
const RECOVERY_POSES: u32 = 3;
const RECOVERY_US: u64 = 100_000;
/// Rounding errors that a coefficient of 0 or 1, and the length of the quaternion, may have.
const COEFFICIENT_TOLERANCE: f32 = 1e-3;
const ROTATION_TOLERANCE: f32 = 1e-2;
/// Farther than any camera sees a face, and within the 16 bits of the packet.
const POSITION_LIMIT_MM: f32 = 32_000.0;

#[derive(Debug, Clone, PartialEq)]
pub struct Failsafe {
    live_us: u64,
    hold_us: u64,
    neutral_us: u64,
    slew_per_s: f32,
}

/// The newest pose and the capture time of its frame, or why there is none. A pose that was given before changes nothing.
/// A reason stands until a pose or another reason comes. The hot loop leaves news for the sender, which sees the newest
/// only.
pub type News = Result<(Pose, u64), Reason>;

impl Failsafe {
    /// Returns the limits of the settings. If three frame periods take longer than `live_ms`, all times move by the
    /// difference.
    pub fn new(settings: &FailsafeSettings, frame_period_us: u64) -> Self {
        let FailsafeSettings { live_ms, hold_ms, neutral_ms, slew_per_s } = *settings;
        let longer_us = frame_period_us.saturating_mul(LIVE_FRAMES).saturating_sub(u64::from(live_ms) * 1000);
        let [live_us, hold_us, neutral_us] =
            [live_ms, hold_ms, neutral_ms].map(|ms| (u64::from(ms) * 1000).saturating_add(longer_us));
        Self { live_us, hold_us, neutral_us, slew_per_s }
    }

    pub fn update(&self, history: &mut History, now_us: u64, news: Option<&News>) -> Output {
        let before_us = history.output.age_us;
        let elapsed_us = history.advance(now_us);
        self.age(history);
        let heard = news.map(|news| news.and_then(|(pose, capture_us)| self.hear(history, now_us, pose, capture_us)));
        if let Some(Err(reason)) = heard {
            history.reason = reason;
            history.row = 0;
        }
        history.output.followed = heard == Some(Ok(true));
        self.move_output(history, before_us, elapsed_us);
        let output = &mut history.output;
        output.moving = output.state == State::Decay || (output.state == State::Live && history.is_ramping);
        // A fault that is known while the face is still live is told once it no longer is.
        output.reason = if output.state == State::Live { Reason::None } else { history.reason };
        output.clone()
    }

    /// Moves the face towards neutral as fast as `slew_per_s` allows, because the service stops.
    pub fn stop(&self, history: &mut History, now_us: u64) -> Output {
        let limit = self.slew(history.advance(now_us));
        let output = &mut history.output;
        let neutral = output.pose.neutral_here();
        output.pose = towards(&output.pose, &neutral, 1.0, limit);
        let state = if output.pose == neutral { State::Neutral } else { State::Decay };
        Output { state, reason: Reason::Stopping, followed: false, moving: true, ..output.clone() }
    }

    fn slew(&self, elapsed_us: u64) -> f32 {
        self.slew_per_s * Duration::from_micros(elapsed_us.min(LONGEST_STEP_US)).as_secs_f32()
    }

    /// Time from the last update to the next change of state, if no pose or fault comes first.
    pub fn wait_us(&self, history: &History) -> u64 {
        let next_state_us = match history.output.state {
            State::Live => self.live_us,
            State::Hold => self.hold_us,
            State::Decay => self.neutral_us,
            State::Neutral => u64::MAX,
        };
        next_state_us.checked_sub(history.output.age_us).filter(|us| *us > 0).unwrap_or(u64::MAX)
    }

    fn age(&self, history: &mut History) {
        let output = &mut history.output;
        output.state = match output.state {
            State::Neutral => State::Neutral,
            _ if output.age_us >= self.hold_us => State::Decay,
            _ if output.age_us >= self.live_us => State::Hold,
            state => state,
        };
        if output.state != State::Live && history.reason == Reason::None {
            history.reason = Reason::Late;
        }
    }

    /// Returns whether the output follows the pose from now on, or the fault that the pose has.
    fn hear(&self, history: &mut History, now_us: u64, pose: Pose, capture_us: u64) -> Result<bool, Reason> {
        if history.heard_us.replace(capture_us) == Some(capture_us) {
            return Ok(false);
        }
        let age_us = now_us.saturating_sub(capture_us);
        let pose = checked(&pose).ok_or(Reason::BadResult)?;
        if age_us >= self.live_us {
            return Err(Reason::Late);
        }
        if history.row == 0 || history.since_last_us >= self.live_us {
            history.row = 0;
            history.since_first_us = 0;
        }
        history.row = history.row.saturating_add(1);
        history.since_last_us = 0;
        let is_recovered = history.row >= RECOVERY_POSES && history.since_first_us >= RECOVERY_US;
        let is_followed = is_recovered || matches!(history.output.state, State::Live | State::Hold);
        if is_followed {
            history.follow(pose, capture_us, age_us);
        }
        Ok(is_followed)
    }

    fn move_output(&self, history: &mut History, before_us: u64, elapsed_us: u64) {
        let limit = self.slew(elapsed_us);
        let output = &mut history.output;
        match output.state {
            State::Live if history.is_ramping => {
                output.pose = towards(&output.pose, &history.target, 1.0, limit);
                history.is_ramping = output.pose != history.target;
            }
            State::Live => output.pose = history.target,
            State::Hold | State::Neutral => {}
            State::Decay => {
                let part = self.decayed_part(before_us, output.age_us);
                let neutral = output.pose.neutral_here();
                output.pose = towards(&output.pose, &neutral, part, limit);
                if part >= 1.0 && output.pose == neutral {
                    output.state = State::Neutral;
                }
            }
        }
    }

    /// Which part of the remaining way to neutral the face covers between two ages, on a line that ends at `neutral_us`.
    fn decayed_part(&self, before_us: u64, age_us: u64) -> f32 {
        let from_us = before_us.max(self.hold_us);
        let left = Duration::from_micros(self.neutral_us.saturating_sub(from_us));
        let passed = Duration::from_micros(age_us.saturating_sub(from_us));
        if passed >= left { 1.0 } else { passed.div_duration_f32(left) }
    }
}

#[derive(Debug, Clone)]
pub struct History {
    output: Output,
    reason: Reason,
    target: Pose,
    /// Whether the output still has to catch up with `target`.
    is_ramping: bool,
    /// Whether the news are those of a puppet. The output moves to and from it by a ramp.
    pub(super) hears_puppet: bool,
    now_us: Option<u64>,
    /// Capture time of the last pose in the news, followed or not.
    heard_us: Option<u64>,
    /// The good poses in a row. One that comes `live_us` or more after the last starts a new row.
    row: u32,
    since_first_us: u64,
    since_last_us: u64,
}

impl Default for History {
    fn default() -> Self {
        Self {
            output: Output { reason: Reason::NoCamera, ..Output::NEUTRAL },
            reason: Reason::NoCamera,
            target: Pose::NEUTRAL,
            is_ramping: false,
            hears_puppet: false,
            now_us: None,
            heard_us: None,
            row: 0,
            since_first_us: 0,
            since_last_us: 0,
        }
    }
}

impl History {
    /// Lets time pass, and returns how much. A clock that steps back counts as standing still.
    fn advance(&mut self, now_us: u64) -> u64 {
        let elapsed_us = now_us.saturating_sub(self.now_us.replace(now_us).unwrap_or(now_us));
        for time_us in [&mut self.output.age_us, &mut self.since_first_us, &mut self.since_last_us] {
            *time_us = time_us.saturating_add(elapsed_us);
        }
        elapsed_us
    }

    /// Follows a good pose from now on. The output moves to it by a ramp if the face was not live before, and to and from
    /// a puppet.
    fn follow(&mut self, pose: Pose, capture_us: u64, age_us: u64) {
        let output = &mut self.output;
        let is_puppet = self.hears_puppet;
        self.is_ramping |= output.state != State::Live || is_puppet || output.is_puppet;
        if output.age_us == u64::MAX {
            output.pose.position_mm = pose.position_mm;
        }
        output.state = State::Live;
        output.is_puppet = is_puppet;
        output.capture_us = capture_us;
        output.age_us = age_us;
        self.target = pose;
        self.reason = Reason::None;
    }

    /// The neutral output that a receiver gets last.
    pub fn last(&self) -> Output {
        Output {
            state: State::Neutral,
            reason: Reason::Stopping,
            pose: self.output.pose.neutral_here(),
            followed: false,
            moving: false,
            ..self.output
        }
    }
}

/// Removes rounding errors. Returns `None` if any value is not a number or out of range.
fn checked(pose: &Pose) -> Option<Pose> {
    let plausible = -COEFFICIENT_TOLERANCE..=1.0 + COEFFICIENT_TOLERANCE;
    let quaternion = Quaternion::from(pose.rotation);
    let is_good = pose.coefficients.iter().all(|value| plausible.contains(value))
        && pose.position_mm.iter().all(|mm| mm.abs() <= POSITION_LIMIT_MM)
        && (quaternion.norm() - 1.0).abs() <= ROTATION_TOLERANCE;
    is_good.then(|| Pose {
        rotation: quaternion.normalize().coords.into(),
        coefficients: pose.coefficients.map(|value| value.clamp(0.0, 1.0)),
        ..*pose
    })
}
