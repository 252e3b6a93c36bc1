//! What the service manager is told, by `sd_notify`: ready, stopping, a status line, and that the service moves.
//!
//! Only the supervisor speaks to it. Without a manager (no `NOTIFY_SOCKET`) nothing is said.

use std::time::Duration;

use sd_notify::NotifyState;

use super::heartbeat::{Beats, Watch};

/// Networks are loaded and have run, memory is locked if it is to be, and the sender runs. There may be no camera.
pub(super) fn ready() {
    tell(NotifyState::Ready);
}

pub(super) fn stopping() {
    tell(NotifyState::Stopping);
}

/// One line for `systemctl status`.
pub(super) fn status(line: &str) {
    tell(NotifyState::Status(line));
}

/// A manager that does not listen is no reason to stop.
fn tell(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::debug!("the service manager was not told: {error}");
    }
}

/// Gives the manager signs of life, twice in the time it asks for.
#[derive(Debug)]
pub(super) struct Watchdog {
    period_us: u64,
    last_us: u64,
}

impl Watchdog {
    /// For the time that the environment names, if it does.
    pub(super) fn new(now_us: u64) -> Option<Self> {
        sd_notify::watchdog_enabled().map(|timeout| Self::every(timeout / 2, now_us))
    }

    fn every(period: Duration, now_us: u64) -> Self {
        Self { period_us: u64::try_from(period.as_micros()).unwrap_or(u64::MAX), last_us: now_us }
    }

    /// Gives a sign of life if one is due.
    pub(super) fn ping(&mut self, watch: Watch, beats: &Beats, now_us: u64) {
        if self.is_due(watch, beats, now_us) {
            tell(NotifyState::Watchdog);
        }
    }

    /// Whether it is time and the threads have moved since the last sign of life; if so, counts it as given.
    fn is_due(&mut self, watch: Watch, beats: &Beats, now_us: u64) -> bool {
        let is_time = now_us.saturating_sub(self.last_us) >= self.period_us;
        let is_due = is_time && watch.moved(beats, now_us, self.last_us);
        if is_due {
            self.last_us = now_us;
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::super::heartbeat::Phase;
    use super::*;
    use crate::config::CameraSettings;

    /// Times of the pings in 10 s, looked for every 50 ms, with a sender that always moves.
    fn pings_ms(hot_at: impl Fn(u64) -> (Phase, u64)) -> Vec<u64> {
        let watch = Watch::new(&CameraSettings::default());
        let mut watchdog = Watchdog::every(Duration::from_secs(1), 0);
        let is_due = |ms: &u64| {
            let (phase, since_ms) = hot_at(*ms);
            let beats = Beats { phase, since_us: since_ms * 1000, sender_us: ms * 1000 };
            watchdog.is_due(watch, &beats, ms * 1000)
        };
        (50..10_000).step_by(50).filter(is_due).collect()
    }

    #[test]
    fn a_service_that_moves_pings_twice_in_the_watchdogs_time() {
        assert_eq!(pings_ms(|ms| (Phase::Work, ms)), [1000, 2000, 3000, 4000, 5000, 6000, 7000, 8000, 9000]);
    }

    #[test]
    fn an_inference_stuck_at_2500_ms_gets_one_more_ping_and_then_none() {
        assert_eq!(pings_ms(|ms| (Phase::Work, ms.min(2500))), [1000, 2000, 3000]);
    }

    #[test]
    fn a_slow_inference_delays_the_ping_and_no_more() {
        assert_eq!(pings_ms(|ms| (Phase::Work, ms - ms % 1500))[..3], [1500, 3000, 4500]);
    }
}
