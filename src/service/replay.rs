//! Replay: sends what was recorded, with the original timing, through the links and the failsafe of the service.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, mpsc};
use std::thread::{Builder, park_timeout};
use std::time::Duration;

use super::counters::Counters;
use super::failsafe::News;
use super::frame_timing::FrameTiming;
use super::links::Links;
use super::sender::{Sender, SenderSettings};
use super::supervisor::Signals;
use super::{STACK_BYTES, ServiceError};
use crate::capture::{FrameRate, monotonic_us};
use crate::config::Settings;
use crate::recording::Recorded;

/// Longest sleep. It bounds how late a signal is seen.
const LONGEST_SLEEP: Duration = Duration::from_millis(50);

/// Sends frames through the links of the settings until `next` returns `None`, or until SIGTERM or SIGINT; then moves the
/// face to neutral. Each frame is shown at its own time after the first one. A recording may begin anew: its first frame
/// then follows the last one. Returns how many packets were sent and dropped.
///
/// # Errors
/// A link cannot be opened, the system refuses a thread or a signal handler, or the error of `next`.
pub fn replay<E: From<ServiceError>>(
    settings: &Settings,
    mut next: impl FnMut() -> Result<Option<Recorded>, E>,
) -> Result<[u64; 2], E> {
    let counters = Arc::new(Counters::default());
    let _signals = Signals::catch(&counters).map_err(ServiceError::from)?;
    let links = Links::open(&settings.links, &counters.traffic).map_err(ServiceError::from)?;
    let (mut newest, news) = triple_buffer::triple_buffer(&News::Nothing);
    let (_changes, for_sender) = mpsc::channel();
    let sender = Sender::new(SenderSettings::new(settings, Some(links)), for_sender, news, Arc::clone(&counters));
    let sender = Builder::new().name("fw-sender".to_owned()).stack_size(STACK_BYTES).spawn(|| sender.run());
    let sender = sender.map_err(ServiceError::from)?;
    let (mut clock, mut timing) = (Clock::default(), FrameTiming::new(Arc::clone(&counters)));
    let outcome = loop {
        match next() {
            Ok(Some(frame)) if clock.wait_for(frame.time_us, &counters) => {
                timing.captured(frame.time_us);
                newest.write(News::of(frame.pose(), monotonic_us()));
                sender.thread().unpark();
            }
            Ok(_) => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    counters.stop();
    sender.thread().unpark();
    sender.join().map_err(|_| ServiceError::Panicked("sender"))?;
    outcome.map(|()| [&counters.traffic.sent, &counters.traffic.dropped].map(|count| count.load(Relaxed)))
}

/// Turns the times of a recording into times of the monotonic clock.
#[derive(Debug, Default)]
struct Clock {
    /// A time of the recording and the time of the monotonic clock at which it is due, microseconds.
    anchor: Option<(u64, u64)>,
    /// The last frame's time in the recording, and when it was due.
    last: Option<(u64, u64)>,
}

impl Clock {
    /// When a frame of this time is due. The first frame is due now. A frame that is not later than the one before, because
    /// the recording begins anew or states no times, follows that one after a frame period: without it, a recording that
    /// is repeated could keep a processor busy.
    fn due_us(&mut self, time_us: u64, now_us: u64) -> u64 {
        if let Some((_, due_us)) = self.last.filter(|(last_us, _)| time_us <= *last_us) {
            self.anchor = Some((time_us, now_us.max(due_us.saturating_add(FrameRate::FPS_30.period_us()))));
        }
        let (from_us, at_us) = *self.anchor.get_or_insert((time_us, now_us));
        let due_us = at_us.saturating_add(time_us - from_us.min(time_us));
        self.last = Some((time_us, due_us));
        due_us
    }

    /// Waits until the frame is due. Returns `false` if the program is to stop.
    fn wait_for(&mut self, time_us: u64, counters: &Counters) -> bool {
        let due_us = self.due_us(time_us, monotonic_us());
        while !counters.stopping() {
            let left = Duration::from_micros(due_us.saturating_sub(monotonic_us()));
            if left.is_zero() {
                return true;
            }
            park_timeout(left.min(LONGEST_SLEEP));
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_due_at_their_own_distances_also_when_the_recording_begins_anew() {
        let mut clock = Clock::default();
        assert_eq!(clock.due_us(70, 1000), 1000);
        assert_eq!(clock.due_us(103, 1040), 1033, "a late frame delays no later one");
        assert_eq!(clock.due_us(170, 1050), 1100);
        assert_eq!(clock.due_us(70, 1101), 1100 + 33_333);
        assert_eq!(clock.due_us(100, 1110), 1130 + 33_333);
    }

    #[test]
    fn frames_without_times_of_their_own_are_a_frame_period_apart() {
        let mut clock = Clock::default();
        let due: Vec<_> = (0..4).map(|_| clock.due_us(0, 1000)).collect();
        assert_eq!(due, [1000, 34_333, 67_666, 100_999]);
        assert_eq!(clock.due_us(0, 5_000_000), 5_000_000, "a program that was stopped does not catch up");
    }
}
