//! The supervisor: signals, settings, watchdog and log, on the thread that started the others.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::Receiver;
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGUSR1};
use signal_hook::flag;

use super::counters::Counters;
use super::log::Log;
use super::manager::{self, Watchdog};
use super::metrics::Metrics;
use super::realtime;
use super::reload::Reloader;
use super::report::Event;
use crate::capture::monotonic_us;
use crate::config::Listen;

/// How often signals are looked for.
const TICK: Duration = Duration::from_millis(50);
/// Exit status after a second signal.
const IMPATIENT: i32 = 130;

/// Signals that ask for something.
#[derive(Default)]
pub(super) struct Signals {
    reload: Arc<AtomicBool>,
    status: Arc<AtomicBool>,
}

impl Signals {
    /// Lets SIGTERM and SIGINT stop the service, the second of them at once; SIGHUP and SIGUSR1 are noted.
    pub(super) fn catch(counters: &Counters) -> io::Result<Self> {
        for signal in [SIGTERM, SIGINT] {
            flag::register_conditional_shutdown(signal, IMPATIENT, counters.stop_flag())?;
            flag::register(signal, counters.stop_flag())?;
        }
        let signals = Self::default();
        flag::register(SIGHUP, Arc::clone(&signals.reload))?;
        flag::register(SIGUSR1, Arc::clone(&signals.status))?;
        Ok(signals)
    }
}

pub(super) struct Supervisor {
    counters: Arc<Counters>,
    signals: Signals,
    events: Receiver<Event>,
    reloader: Reloader,
    watchdog: Option<Watchdog>,
    log: Log,
    /// Where the metrics are read, and the thread that gives them.
    metrics: (Listen, Option<Metrics>),
}

impl Supervisor {
    pub(super) fn new(counters: Arc<Counters>, signals: Signals, events: Receiver<Event>, reloader: Reloader) -> Self {
        let watchdog = Watchdog::from_env(monotonic_us());
        Self { counters, signals, events, reloader, watchdog, log: Log::default(), metrics: (Listen::Off, None) }
    }

    /// Watches over the service until it is to stop, or a thread has ended without being told to.
    pub(super) fn run(&mut self, all_run: impl Fn() -> bool) {
        self.serve_metrics();
        self.lock_memory();
        manager::ready();
        while !self.counters.stopping() && all_run() {
            self.hear();
            self.reload();
            self.ping();
            self.tell_status();
        }
        tracing::info!("stopping");
        manager::stopping();
    }

    /// Waits a moment for an event.
    fn hear(&mut self) {
        let Ok(event) = self.events.recv_timeout(TICK) else { return };
        let has_grown = matches!(event, Event::Opened(_));
        let before = self.log.sight();
        self.log.event(event);
        let sight = self.log.sight();
        if sight != before {
            manager::status(&sight);
        }
        if has_grown {
            self.lock_memory();
        }
    }

    /// One reload after the other.
    fn reload(&mut self) {
        if self.reloader.is_idle() && self.signals.reload.swap(false, Relaxed) {
            self.reloader.start();
        }
        if self.reloader.step() {
            self.lock_memory();
        }
        self.serve_metrics();
    }

    fn ping(&mut self) {
        if let Some(watchdog) = &mut self.watchdog {
            let now_us = monotonic_us();
            watchdog.update(self.counters.heartbeats.are_alive(now_us), now_us);
        }
    }

    fn tell_status(&mut self) {
        let is_asked = self.signals.status.swap(false, Relaxed);
        if is_asked || self.log.is_due() {
            let line = self.log.status(&self.counters);
            manager::status(&line);
            self.log.refusal(self.refusal());
        }
    }

    /// What the network has against the packets of a link.
    fn refusal(&self) -> Option<String> {
        let (place, reason) = self.counters.refusal()?;
        let address = &self.reloader.live().links.get(place)?.address;
        let remedy = "check this machine's cable or Wi-Fi, the address, and IPAddressAllow in the unit";
        Some(format!("link {address}: the network takes no packets ({reason}); {remedy}"))
    }

    /// Lets the metrics be read where the settings say, and no longer anywhere else.
    fn serve_metrics(&mut self) {
        let wanted = &self.reloader.live().metrics.listen;
        if *wanted == self.metrics.0 {
            return;
        }
        self.metrics = (wanted.clone(), None);
        if *wanted == Listen::Off {
            return;
        }
        match Metrics::start(wanted.clone(), &self.counters) {
            Ok(metrics) => self.metrics.1 = Some(metrics),
            Err(error) => tracing::warn!("no metrics at {wanted} ({error}): raise the limit of threads and files"),
        }
    }

    fn lock_memory(&mut self) {
        if self.reloader.live().realtime.lock_memory {
            self.log.grant(realtime::lock_memory());
        }
    }
}
