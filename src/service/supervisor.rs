//! The supervisor: signals, reloads, watchdog and log, on the thread that starts the others.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::mpsc::Receiver;
use std::time::Duration;

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGUSR1};
use signal_hook::flag;

use super::adaptation::{Adaptation, Conditions};
use super::counters::Counters;
use super::log::Log;
use super::manager::{self, Watchdog};
use super::metrics::Metrics;
use super::picture_size::{Need, PictureSize};
use super::realtime;
use super::reload::Reloader;
use super::report::Event;
use crate::capture::monotonic_us;
use crate::config::Listen;
use crate::hardware::{self, Board, Hardware};

/// Time between two looks at the signals.
const TICK: Duration = Duration::from_millis(50);
/// Exit status after a second SIGTERM or SIGINT.
const EXIT_SECOND_SIGNAL: i32 = 130;

/// The signals that ask for something other than to stop.
#[derive(Default)]
pub(super) struct Signals {
    reload: Arc<AtomicBool>,
    status: Arc<AtomicBool>,
}

impl Signals {
    /// Installs the handlers. The first SIGTERM or SIGINT stops the service, the second ends the process at once.
    ///
    /// # Errors
    /// The system refuses a handler.
    pub(super) fn catch(counters: &Counters) -> io::Result<Self> {
        for signal in [SIGTERM, SIGINT] {
            flag::register_conditional_shutdown(signal, EXIT_SECOND_SIGNAL, counters.stop_flag())?;
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
    adaptation: Adaptation,
    picture_size: PictureSize,
    log: Log,
    /// Where the metrics are served, and the thread that serves them.
    metrics: (Listen, Option<Metrics>),
    hardware: Hardware,
}

impl Supervisor {
    pub(super) fn new(counters: Arc<Counters>, signals: Signals, events: Receiver<Event>, reloader: Reloader) -> Self {
        let watchdog = Watchdog::from_env(monotonic_us());
        let hardware = Hardware::new(hardware::root(), reloader.live().hardware.clone());
        let (adaptation, picture_size) = (Adaptation::default(), PictureSize::default());
        let (log, metrics) = (Log::default(), (Listen::Off, None));
        Self { counters, signals, events, reloader, watchdog, adaptation, picture_size, log, metrics, hardware }
    }

    /// Runs until the service is to stop, or until `all_run` says that a thread has ended by itself.
    pub(super) fn run(&mut self, all_run: impl Fn() -> bool) {
        tracing::info!("board {}", Board::detect(&hardware::root()).tell(self.reloader.live().board));
        self.serve_metrics();
        self.lock_memory();
        manager::ready();
        while !self.counters.stopping() && all_run() {
            self.receive();
            self.reload();
            self.ping();
            self.sense();
            self.adapt();
            self.log.impairments(self.counters.impairments.present());
            self.tell_status();
        }
        tracing::info!("stopping");
        manager::stopping();
    }

    /// Waits up to one [`TICK`] for an event.
    fn receive(&mut self) {
        let Ok(event) = self.events.recv_timeout(TICK) else { return };
        let has_grown = matches!(event, Event::Opened(_) | Event::EngineReloaded);
        let before = self.log.camera_line();
        self.log.event(event);
        let now = self.log.camera_line();
        if now != before {
            manager::status(&now);
        }
        if has_grown {
            self.lock_memory();
        }
    }

    /// Logs the events that are left after the threads have ended.
    pub(super) fn log_events(&mut self) {
        self.events.try_iter().for_each(|event| self.log.event(event));
    }

    /// Begins a reload if one is asked for, and goes on with the one in progress.
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

    /// Looks for impairments that the hardware causes. Sets only those that have changed, so that a rehearsal may set
    /// others.
    fn sense(&mut self) {
        self.hardware.set(&self.reloader.live().hardware);
        let Some(found) = self.hardware.poll(monotonic_us()) else { return };
        for impairment in Hardware::FINDS {
            self.counters.impairments.set(impairment, found.contains(impairment));
        }
    }

    /// Chooses the step of the pipeline and the size of the camera's picture.
    fn adapt(&mut self) {
        let is_open = self.counters.camera_open.load(Relaxed);
        let load = self.counters.recent.load().filter(|_| is_open);
        let is_allowed = self.reloader.live().adaptation.enabled;
        let conditions = Conditions { is_allowed, load, impaired_by: self.counters.impairments.present() };
        self.choose_step(&conditions);
        self.choose_picture(&conditions);
    }

    fn choose_step(&mut self, conditions: &Conditions) {
        let before = self.adaptation.step();
        if !self.adaptation.update(monotonic_us(), conditions) {
            return;
        }
        let (step, cause) = (self.adaptation.step(), self.adaptation.cause());
        self.counters.set_step(step, cause);
        match (cause, conditions.load) {
            (Some(cause), Some(load)) if step > before => Log::step_down(step, cause, &load),
            _ => Log::step_up(step),
        }
    }

    fn choose_picture(&mut self, &Conditions { is_allowed, load, .. }: &Conditions) {
        let step = (self.adaptation.step(), self.adaptation.cause());
        let has_smaller_mode = self.counters.has_smaller_mode.load(Relaxed);
        if self.picture_size.update(monotonic_us(), &Need { is_allowed, load, step, has_smaller_mode }) {
            self.counters.small_picture.store(self.picture_size.is_small(), Relaxed);
            Log::picture_size(self.picture_size.is_small(), load);
        }
    }

    fn tell_status(&mut self) {
        let is_asked = self.signals.status.swap(false, Relaxed);
        if is_asked || self.log.is_status_due() {
            let line = self.log.status(&self.counters);
            manager::status(&line);
            self.log.refusal(self.refusal());
        }
    }

    /// Returns a sentence about the first link whose packets the network does not take.
    fn refusal(&self) -> Option<String> {
        let (index, reason) = self.counters.refusal()?;
        let link = self.reloader.live().links.get(index)?;
        let remedy = "check this machine's cable or Wi-Fi, the address, and IPAddressAllow in the unit";
        Some(format!("link {link}: the network takes no packets ({reason}); {remedy}"))
    }

    /// Serves the metrics at the address in the settings, and no longer at the former one.
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
