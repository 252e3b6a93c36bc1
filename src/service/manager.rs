//! Messages to the service manager by `sd_notify`: ready, stopping, a status line, and the watchdog's pings.
//!
//! Only the supervisor sends them. Without a manager (no `NOTIFY_SOCKET`) they go nowhere.

use std::time::Duration;

use sd_notify::NotifyState;

/// Says that the service has started: the sender runs and memory is locked if the settings ask for it. The camera, or a
/// model file on a disk that is not mounted yet, may still be missing.
pub(super) fn ready() {
    notify(NotifyState::Ready);
}

/// Says that the service is stopping.
pub(super) fn stopping() {
    notify(NotifyState::Stopping);
}

/// Sets the line that `systemctl status` shows.
pub(super) fn status(line: &str) {
    notify(NotifyState::Status(line));
}

/// The service runs on if its manager does not listen.
fn notify(state: NotifyState<'_>) {
    if let Err(error) = sd_notify::notify(&[state]) {
        tracing::debug!("the service manager could not be notified: {error}");
    }
}

/// Pings the manager twice in each of its watchdog periods, as long as the service is alive.
#[derive(Debug)]
pub(super) struct Watchdog {
    period_us: u64,
    last_ping_us: u64,
}

impl Watchdog {
    /// A watchdog for the period in the environment; `None` if the manager has not asked for pings.
    pub(super) fn from_env(now_us: u64) -> Option<Self> {
        sd_notify::watchdog_enabled().map(|timeout| Self::every(timeout / 2, now_us))
    }

    fn every(period: Duration, now_us: u64) -> Self {
        Self { period_us: u64::try_from(period.as_micros()).unwrap_or(u64::MAX), last_ping_us: now_us }
    }

    /// Pings the manager if a ping is due and the service is alive.
    pub(super) fn update(&mut self, is_alive: bool, now_us: u64) {
        if self.take_ping(is_alive, now_us) {
            notify(NotifyState::Watchdog);
        }
    }

    /// Returns whether to ping now, and counts that ping as sent.
    fn take_ping(&mut self, is_alive: bool, now_us: u64) -> bool {
        let is_due = is_alive && now_us.saturating_sub(self.last_ping_us) >= self.period_us;
        if is_due {
            self.last_ping_us = now_us;
        }
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Times of the pings in 5 s of a supervisor that looks every 50 ms.
    fn pings_ms(is_alive: impl Fn(u64) -> bool) -> Vec<u64> {
        let mut watchdog = Watchdog::every(Duration::from_secs(1), 0);
        (50..5000).step_by(50).filter(|ms| watchdog.take_ping(is_alive(*ms), ms * 1000)).collect()
    }

    #[test]
    fn a_service_that_is_alive_is_pinged_for_twice_in_each_period() {
        assert_eq!(pings_ms(|_| true), [1000, 2000, 3000, 4000]);
    }

    #[test]
    fn a_stuck_service_gets_no_ping_and_one_that_recovers_gets_the_next_at_once() {
        assert_eq!(pings_ms(|ms| ms < 2500), [1000, 2000]);
        assert_eq!(pings_ms(|ms| !(2500..3400).contains(&ms)), [1000, 2000, 3400, 4400]);
    }
}
