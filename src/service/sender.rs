//! The sender: the failsafe and the links, on a thread of their own that no inference can hold up.
//!
//! The thread sleeps until the hot loop wakes it, or until the failsafe or a link is due. It cannot fail, and allocates
//! nothing; it frees memory only when a reload replaces links.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::Duration;

use facewire_packet::State;
use triple_buffer::Output as Newest;

use super::counters::Counters;
use super::failsafe::{Failsafe, History, News, STOPPING_PACKETS};
use super::links::Links;
use crate::capture::monotonic_us;
use crate::config::{FailsafeSettings, Settings};
use crate::link::{Output, Rates};

/// Longest sleep. It bounds how late the sender sees that it is to stop.
const MAX_SLEEP_US: u64 = 100_000;
/// Longest time that a stopping service takes to move the face to neutral. A face that `slew_per_s` would keep moving for
/// longer jumps to neutral then.
const LONGEST_STOP_US: u64 = 500_000;
/// Time between the last packets. A serial link drops a packet that it has not written when the next one comes, and
/// interference that spoils one datagram often spoils those close to it.
const STOPPING_PERIOD: Duration = Duration::from_millis(20);

/// The settings of the sender.
#[derive(Debug)]
pub(super) struct SenderSettings {
    failsafe: FailsafeSettings,
    rate_hz: u32,
    /// `None` in a change that keeps the links.
    links: Option<Links>,
}

impl SenderSettings {
    pub(super) fn new(settings: &Settings, links: Option<Links>) -> Self {
        Self { failsafe: settings.failsafe.clone(), rate_hz: settings.send.rate_hz, links }
    }

    /// Takes the settings of a reload. Links that it removes send `last`.
    fn adopt(&mut self, change: Self, last: &Output) {
        self.failsafe = change.failsafe;
        self.rate_hz = change.rate_hz;
        let Some(links) = &mut self.links else { return };
        change.links.into_iter().for_each(|change| links.adopt(change, last));
        links.refresh();
    }
}

/// The state of the sender's thread.
pub(super) struct Sender {
    settings: SenderSettings,
    changes: mpsc::Receiver<SenderSettings>,
    news: Newest<News>,
    counters: Arc<Counters>,
}

impl Sender {
    pub(super) fn new(
        settings: SenderSettings,
        changes: mpsc::Receiver<SenderSettings>,
        news: Newest<News>,
        counters: Arc<Counters>,
    ) -> Self {
        Self { settings, changes, news, counters }
    }

    /// Sends until the service stops, then moves the face to neutral and closes the links.
    pub(super) fn run(mut self) {
        let mut history = History::default();
        while !self.counters.sending_stops() {
            self.counters.heartbeats.sender(monotonic_us());
            self.adopt(&history);
            let wait_us = self.step(&mut history);
            thread::park_timeout(Duration::from_micros(wait_us.min(MAX_SLEEP_US)));
        }
        self.stop(&mut history);
        self.settings.links.into_iter().for_each(Links::close);
    }

    /// Moves the face to neutral by the slew limit, and then sends the neutral face three times.
    fn stop(&mut self, history: &mut History) {
        let (failsafe, end_us) = (self.failsafe(), monotonic_us() + LONGEST_STOP_US);
        let pause = Duration::from_secs(1) / self.settings.rate_hz.max(1);
        let mut output = failsafe.stop(history, monotonic_us());
        while (output.state != State::Neutral || self.has_held_links()) && monotonic_us() < end_us {
            self.offer(&output);
            thread::sleep(pause);
            output = failsafe.stop(history, monotonic_us());
        }
        let last = history.last();
        self.counters.set_state(last.state);
        for _ in 0..STOPPING_PACKETS {
            self.settings.links.iter_mut().for_each(|links| links.send_last(&last));
            thread::sleep(STOPPING_PERIOD);
        }
    }

    fn has_held_links(&mut self) -> bool {
        self.settings.links.as_mut().is_some_and(Links::is_held)
    }

    /// Updates the failsafe and offers its output to the links. Returns how long to wait for the next step, in
    /// microseconds.
    fn step(&mut self, history: &mut History) -> u64 {
        let failsafe = self.failsafe();
        let news = if self.news.update() { self.news.peek_output_buffer() } else { &News::Nothing };
        let output = failsafe.update(history, monotonic_us(), news);
        let wait_us = self.offer(&output).min(failsafe.wait_us(history));
        if output.followed {
            self.counters.times.age.record(Duration::from_micros(output.age_us));
        }
        wait_us
    }

    /// The failsafe for the camera's current frame period.
    fn failsafe(&self) -> Failsafe {
        Failsafe::new(&self.settings.failsafe, self.counters.frame_period_us.load(Relaxed))
    }

    /// Takes the settings of all reloads since the last call.
    fn adopt(&mut self, history: &History) {
        while let Ok(change) = self.changes.try_recv() {
            self.settings.adopt(change, &history.last());
        }
    }

    fn offer(&mut self, output: &Output) -> u64 {
        self.counters.set_state(output.state);
        let Some(links) = &mut self.settings.links else { return u64::MAX };
        let rates = Rates { send_hz: self.settings.rate_hz, slew_per_s: self.settings.failsafe.slew_per_s };
        let wait_us = links.offer(monotonic_us(), output, rates);
        links.count(&self.counters);
        wait_us
    }
}
