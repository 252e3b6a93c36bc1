//! The sender: failsafe and links, on a thread that no inference can hold up.
//!
//! It sleeps until the hot loop wakes it or the failsafe's next moment comes. Once running, it allocates nothing and
//! cannot fail; links count what they lose.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::Duration;

use facewire_packet::State;
use triple_buffer::Output as Newest;

use super::counters::Counters;
use super::failsafe::{Failsafe, History, News, Output, STOPPING_PACKETS};
use super::links::Links;
use super::report::Report;
use crate::capture::monotonic_us;
use crate::config::{FailsafeSettings, Settings};

/// Longest sleep, so that a stop is heard without a wake-up.
const MAX_SLEEP_US: u64 = 100_000;
/// Longest way to neutral of a face that stops. By then, `slew_per_s` of less than 2 is not heeded.
const LONGEST_STOP_US: u64 = 500_000;
/// From one of the last packets to the next: a serial link that is given another before it wrote the first drops the
/// first, and what spoils one datagram often spoils those close behind it.
const STOPPING_PERIOD: Duration = Duration::from_millis(20);

/// What the settings say to the sender.
#[derive(Debug)]
pub(super) struct SenderSettings {
    failsafe: FailsafeSettings,
    rate_hz: u32,
    /// `None` in a change that leaves the links as they are.
    links: Option<Links>,
}

impl SenderSettings {
    pub(super) fn new(settings: &Settings, links: Option<Links>) -> Self {
        Self { failsafe: settings.failsafe.clone(), rate_hz: settings.send.rate_hz, links }
    }

    /// Takes the new settings.
    fn adopt(&mut self, change: Self, counters: &Counters) {
        self.failsafe = change.failsafe;
        self.rate_hz = change.rate_hz;
        if let (Some(links), Some(mut change)) = (&mut self.links, change.links) {
            links.adopt(&mut change);
            change.close(counters);
        }
    }

    /// Closes the links and counts what became of their last packets.
    pub(super) fn close(self, counters: &Counters) {
        if let Some(links) = self.links {
            links.close(counters);
        }
    }
}

pub(super) struct Sender {
    settings: SenderSettings,
    changes: mpsc::Receiver<SenderSettings>,
    reports: Newest<Report>,
    counters: Arc<Counters>,
    sequence: u16,
}

impl Sender {
    pub(super) fn new(
        settings: SenderSettings,
        changes: mpsc::Receiver<SenderSettings>,
        reports: Newest<Report>,
        counters: Arc<Counters>,
    ) -> Self {
        Self { settings, changes, reports, counters, sequence: 0 }
    }

    pub(super) fn run(mut self) {
        let mut history = History::default();
        while !self.counters.sending_stops() {
            self.counters.heartbeats.sender(monotonic_us());
            let failsafe = self.failsafe();
            self.step(&failsafe, &mut history);
            self.adopt();
            thread::park_timeout(Duration::from_micros(failsafe.wait_us(&history).min(MAX_SLEEP_US)));
        }
        self.stop(&mut history);
        self.settings.close(&self.counters);
    }

    /// Brings the face to neutral by the slew limit, in a time that a stop may take, and then says three times that it
    /// is there.
    fn stop(&mut self, history: &mut History) {
        let (failsafe, end_us) = (self.failsafe(), monotonic_us() + LONGEST_STOP_US);
        let pause = Duration::from_secs(1) / self.settings.rate_hz.max(1);
        let mut output = failsafe.stop(history, monotonic_us());
        while output.state != State::Neutral && monotonic_us() < end_us {
            self.send(&output);
            thread::sleep(pause);
            output = failsafe.stop(history, monotonic_us());
        }
        let last = Output { state: State::Neutral, pose: output.pose.neutral_here(), ..output };
        for _ in 0..STOPPING_PACKETS {
            self.send(&last);
            thread::sleep(STOPPING_PERIOD);
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
            self.counters.times.age.record(Duration::from_micros(output.age_us));
        }
    }

    /// The failsafe for the camera's present frame period.
    fn failsafe(&self) -> Failsafe {
        let SenderSettings { failsafe, rate_hz, .. } = &self.settings;
        Failsafe::new(failsafe, *rate_hz, self.counters.frame_period_us.load(Relaxed))
    }

    /// Takes the settings of all reloads since the last call.
    fn adopt(&mut self) {
        while let Ok(change) = self.changes.try_recv() {
            self.settings.adopt(change, &self.counters);
        }
    }

    fn send(&mut self, output: &Output) {
        let packet = output.packet(self.sequence);
        self.sequence = self.sequence.wrapping_add(1);
        self.counters.packets.fetch_add(1, Relaxed);
        self.counters.set_state(output.state);
        if let Some(links) = &mut self.settings.links {
            links.send(&packet);
            links.count(&self.counters);
        }
    }
}
