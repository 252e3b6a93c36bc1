//! What the face shows when poses stop coming.
//!
//! Role: stands between the pipeline and the links, in the sender's thread, so that a stuck inference or a lost
//! camera cannot freeze a face. See [`State`] for the diagram.
//! Contract: [`Failsafe::update`] is called for every pose or fault, and no later than [`Failsafe::wait_us`] after
//! the last call; its output is sent when it says [`Output::due`]. All times count from the capture of the last pose
//! that was followed. The output never moves faster than `slew_per_s` except while live and caught up.
//! Limits: a clock that stands still or steps back delays transitions by the step and does no other harm.
//! The head's rotation decays with the coefficients; its position has no neutral and stays.

mod history;
mod pose;
#[cfg(test)]
mod tests;

use std::time::Duration;

use facewire_packet::{Packet, Reason, State};

pub use history::History;
pub use pose::Pose;

use crate::config::FailsafeSettings;

/// How often a neutral face is sent, and at least whatever stands still: receivers go neutral by themselves after
/// 500 ms without a packet.
const STILL_PERIOD_US: u64 = 100_000;
/// A camera may drop two frames in a row and stay live.
const LIVE_FRAMES: u64 = 3;
/// Times a neutral face is sent when the sender stops: one may be lost.
pub const STOPPING_PACKETS: usize = 3;

/// Limits of the failsafe, fixed while it runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Failsafe {
    live_us: u64,
    hold_us: u64,
    neutral_us: u64,
    slew_per_s: f32,
    period_us: u64,
}

/// What the sender learned since the last update.
#[derive(Debug, Clone, Copy)]
pub enum News<'a> {
    /// Nothing: only time has passed.
    Nothing,
    /// The newest pose and the capture time of its frame. Giving the same one again changes nothing.
    Pose(&'a Pose, u64),
    /// Why there is no pose. It stands until a pose or another fault comes.
    Fault(Reason),
}

/// What to show now.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    /// How much the pose is to be trusted.
    pub state: State,
    /// Why it is not live; [`Reason::None`] while it is.
    pub reason: Reason,
    /// The pose.
    pub pose: Pose,
    /// Time since the capture of the last pose that was followed; `u64::MAX` when there was none.
    pub age_us: u64,
    /// When that one was captured; 0 when there was none.
    pub capture_us: u64,
    /// Send it now. The failsafe counts it as sent.
    pub due: bool,
}

impl Failsafe {
    /// Limits from the settings, for a camera of this frame period. Three frame periods longer than `live_ms`
    /// lengthen it, and move the later times along.
    #[must_use]
    pub fn new(settings: &FailsafeSettings, rate_hz: u32, frame_period_us: u64) -> Self {
        let [live_us, hold_us, neutral_us] =
            [settings.live_ms, settings.hold_ms, settings.neutral_ms].map(|ms| u64::from(ms) * 1000);
        let longer_us = frame_period_us.saturating_mul(LIVE_FRAMES).saturating_sub(live_us);
        Self {
            live_us: live_us.saturating_add(longer_us),
            hold_us: hold_us.saturating_add(longer_us),
            neutral_us: neutral_us.saturating_add(longer_us),
            slew_per_s: settings.slew_per_s,
            period_us: 1_000_000 / u64::from(rate_hz.max(1)),
        }
    }

    /// Lets time pass, takes the news in and moves the output.
    pub fn update(&self, history: &mut History, now_us: u64, news: News<'_>) -> Output {
        let before_us = history.age_us;
        let elapsed_us = history.advance(now_us);
        self.age(history);
        let followed = self.hear(history, now_us, news);
        self.move_output(history, before_us, elapsed_us);
        let due = self.send(history, followed);
        Output {
            state: history.state,
            reason: history.told_reason(),
            pose: history.shown,
            age_us: history.age_us,
            capture_us: history.capture_us,
            due,
        }
    }

    /// Moves a face that stops towards neutral, as fast as it may; [`State::Neutral`] once it is there. To be sent each
    /// time, at the rate of a decay.
    pub fn stop(&self, history: &mut History, now_us: u64) -> Output {
        let elapsed_us = history.advance(now_us);
        let neutral = history.shown.neutral_here();
        history.shown = history.shown.towards(&neutral, 1.0, self.slew(elapsed_us));
        let state = if history.shown == neutral { State::Neutral } else { State::Decay };
        Output { state, ..history.stopping() }
    }

    /// How far the output may move in a time.
    fn slew(&self, elapsed_us: u64) -> f32 {
        self.slew_per_s * Duration::from_micros(elapsed_us).as_secs_f32()
    }

    /// When to call [`Failsafe::update`] again at the latest, from the last call on.
    #[must_use]
    pub fn wait_us(&self, history: &History) -> u64 {
        let next_state_us = match history.state {
            State::Live => self.live_us,
            State::Hold => self.hold_us,
            State::Decay => self.neutral_us,
            State::Neutral => u64::MAX,
        };
        let until_state_us = next_state_us.checked_sub(history.age_us).filter(|us| *us > 0);
        let until_packet_us = self.interval_us(history).saturating_sub(history.since_sent_us);
        until_packet_us.min(until_state_us.unwrap_or(u64::MAX))
    }

    /// Leaves live and hold when their time is over.
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

    /// Takes the news in; whether it is a pose that the output follows from now on.
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

    /// Moves what is shown by what the time allows.
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

    /// Which part of the way to neutral belongs to the time between two ages: a straight line that ends at
    /// `neutral_us`.
    fn decayed_part(&self, before_us: u64, age_us: u64) -> f32 {
        let from_us = before_us.max(self.hold_us);
        let left = Duration::from_micros(self.neutral_us.saturating_sub(from_us));
        let passed = Duration::from_micros(age_us.saturating_sub(from_us));
        if passed >= left { 1.0 } else { passed.div_duration_f32(left) }
    }

    /// Time from one packet to the next when no pose is followed.
    fn interval_us(&self, history: &History) -> u64 {
        match history.state {
            State::Live if history.ramping => self.period_us,
            State::Hold | State::Decay => self.period_us,
            State::Live | State::Neutral => STILL_PERIOD_US,
        }
    }

    /// Whether to send now, and if so, counts it as sent.
    fn send(&self, history: &mut History, followed: bool) -> bool {
        let sent = Some((history.state, history.told_reason()));
        let due = followed || history.sent != sent || history.since_sent_us >= self.interval_us(history);
        if due {
            history.sent = sent;
            history.since_sent_us = 0;
        }
        due
    }
}

impl Output {
    /// The packet to send under this number.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "the packet's clock wraps")]
    pub fn packet(&self, sequence: u16) -> Packet {
        Packet {
            state: self.state,
            reason: self.reason,
            sequence,
            age_us: u32::try_from(self.age_us).unwrap_or(u32::MAX),
            capture_us: self.capture_us as u32,
            rotation: self.pose.rotation,
            position_mm: self.pose.position_mm,
            coefficients: self.pose.coefficients,
        }
    }
}
