//! The sender: failsafe and links, on a thread that no inference can hold up.
//!
//! It sleeps until the hot loop wakes it or the failsafe's next moment comes. Once running, it allocates nothing and
//! cannot fail; links count what they lose.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;
use std::time::Duration;

use facewire_packet::State;
use triple_buffer::Output as Newest;

use super::counters::Counters;
use super::failsafe::{Failsafe, History, News, Output, STOPPING_PACKETS};
use super::report::Report;
use crate::capture::monotonic_us;
use crate::config::{FailsafeSettings, Settings};
use crate::link::Link;

/// Longest sleep, so that a stop is heard without a wake-up.
const MAX_SLEEP_US: u64 = 100_000;

pub(super) struct Sender {
    settings: FailsafeSettings,
    rate_hz: u32,
    links: Vec<Link>,
    reports: Newest<Report>,
    counters: Arc<Counters>,
    sequence: u16,
}

impl Sender {
    pub(super) fn new(settings: &Settings, links: Vec<Link>, reports: Newest<Report>, counters: Arc<Counters>) -> Self {
        let (failsafe, rate_hz) = (settings.failsafe.clone(), settings.send.rate_hz);
        Self { settings: failsafe, rate_hz, links, reports, counters, sequence: 0 }
    }

    pub(super) fn run(mut self) {
        let mut history = History::default();
        while !self.counters.sending_stops() {
            let failsafe = self.failsafe();
            let news = if self.reports.update() { self.reports.peek_output_buffer().news() } else { News::Nothing };
            let followed = matches!(news, News::Pose(..));
            let output = failsafe.update(&mut history, monotonic_us(), news);
            if output.due {
                self.send(&output);
                if followed && output.state == State::Live {
                    self.counters.count_latency(output.age_us);
                }
            }
            thread::park_timeout(Duration::from_micros(failsafe.wait_us(&history).min(MAX_SLEEP_US)));
        }
        let last = history.stopping();
        (0..STOPPING_PACKETS).for_each(|_| self.send(&last));
    }

    /// The failsafe for the camera's present frame period.
    fn failsafe(&self) -> Failsafe {
        Failsafe::new(&self.settings, self.rate_hz, self.counters.frame_period_us.load(Relaxed))
    }

    fn send(&mut self, output: &Output) {
        let packet = output.packet(self.sequence);
        self.sequence = self.sequence.wrapping_add(1);
        self.links.iter_mut().for_each(|link| link.send(&packet));
        self.counters.packets.fetch_add(1, Relaxed);
        let dropped = self.links.iter().map(|link| link.counts().dropped).sum();
        self.counters.dropped.store(dropped, Relaxed);
        let open = self.links.iter().filter(|link| link.is_open()).count();
        self.counters.links_open.store(open as u64, Relaxed);
    }
}
