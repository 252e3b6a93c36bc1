//! The sender: failsafe and links, on a thread that no inference can hold up.
//!
//! It sleeps until the hot loop wakes it or the failsafe's next moment comes. Once running, it allocates nothing and
//! cannot fail; links count what they lose.

use std::mem::swap;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;
use std::time::Duration;

use facewire_packet::State;
use triple_buffer::Output as Newest;

use super::counters::Counters;
use super::exchange::Exchange;
use super::failsafe::{Failsafe, History, News, Output, STOPPING_PACKETS};
use super::report::Report;
use crate::capture::monotonic_us;
use crate::config::{FailsafeSettings, Settings};
use crate::link::Link;

/// Longest sleep, so that a stop is heard without a wake-up.
const MAX_SLEEP_US: u64 = 100_000;

/// From one of the last packets to the next: a serial link that is given another before it wrote the first drops the
/// first, and what spoils one datagram often spoils those close behind it.
const STOPPING_PERIOD: Duration = Duration::from_millis(20);

/// What the settings say to the sender.
#[derive(Debug)]
pub(super) struct SenderSettings {
    failsafe: FailsafeSettings,
    rate_hz: u32,
    /// `None` in a change that leaves the links as they are.
    links: Option<Vec<Link>>,
}

impl SenderSettings {
    pub(super) fn new(settings: &Settings, links: Option<Vec<Link>>) -> Self {
        Self { failsafe: settings.failsafe.clone(), rate_hz: settings.send.rate_hz, links }
    }

    /// Takes the new, and leaves the old in its place.
    fn adopt(&mut self, change: &mut Self) {
        swap(&mut self.failsafe, &mut change.failsafe);
        swap(&mut self.rate_hz, &mut change.rate_hz);
        if change.links.is_some() {
            swap(&mut self.links, &mut change.links);
        }
    }

    /// Packets that the links dropped.
    fn dropped(&self) -> u64 {
        self.links.iter().flatten().map(|link| link.counts().dropped).sum()
    }
}

pub(super) struct Sender {
    settings: SenderSettings,
    changes: Arc<Exchange<SenderSettings>>,
    reports: Newest<Report>,
    counters: Arc<Counters>,
    sequence: u16,
    /// Of these links, already in the counters.
    dropped: u64,
}

impl Sender {
    pub(super) fn new(
        settings: SenderSettings,
        changes: Arc<Exchange<SenderSettings>>,
        reports: Newest<Report>,
        counters: Arc<Counters>,
    ) -> Self {
        Self { settings, changes, reports, counters, sequence: 0, dropped: 0 }
    }

    pub(super) fn run(mut self) {
        let mut history = History::default();
        while !self.counters.sending_stops() {
            self.counters.beats.sender(monotonic_us());
            let failsafe = self.failsafe();
            self.step(&failsafe, &mut history);
            self.adopt();
            thread::park_timeout(Duration::from_micros(failsafe.wait_us(&history).min(MAX_SLEEP_US)));
        }
        let last = history.stopping();
        for number in 0..STOPPING_PACKETS {
            if number > 0 {
                thread::sleep(STOPPING_PERIOD);
            }
            self.send(&last);
        }
    }

    /// Hears the news and sends what is due.
    fn step(&mut self, failsafe: &Failsafe, history: &mut History) {
        let news = if self.reports.update() { self.reports.peek_output_buffer().news() } else { News::Nothing };
        let followed = matches!(news, News::Pose(..));
        let output = failsafe.update(history, monotonic_us(), news);
        if !output.due {
            return;
        }
        self.send(&output);
        if followed && output.state == State::Live {
            self.counters.count_latency(output.age_us);
        }
    }

    /// The failsafe for the camera's present frame period.
    fn failsafe(&self) -> Failsafe {
        let SenderSettings { failsafe, rate_hz, .. } = &self.settings;
        Failsafe::new(failsafe, *rate_hz, self.counters.frame_period_us.load(Relaxed))
    }

    /// Takes new settings, if there are any.
    fn adopt(&mut self) {
        let (settings, dropped) = (&mut self.settings, &mut self.dropped);
        self.changes.take(|change| {
            settings.adopt(change);
            *dropped = settings.dropped();
        });
    }

    fn send(&mut self, output: &Output) {
        let packet = output.packet(self.sequence);
        self.sequence = self.sequence.wrapping_add(1);
        self.settings.links.iter_mut().flatten().for_each(|link| link.send(&packet));
        self.counters.packets.fetch_add(1, Relaxed);
        self.count_links();
    }

    fn count_links(&mut self) {
        let dropped = self.settings.dropped();
        self.counters.dropped.fetch_add(dropped.saturating_sub(self.dropped), Relaxed);
        self.dropped = dropped;
        let open = self.settings.links.iter().flatten().filter(|link| link.is_open()).count();
        self.counters.links_open.store(open as u64, Relaxed);
    }
}
