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
use super::hot::Event;
use super::log::Log;
use super::manager::{self, Watchdog};
use super::realtime;
use super::reload::Reloader;
use crate::capture::monotonic_us;
use crate::hardware::{self, Hardware, Machine};

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
    log: Log,
    hardware: Hardware,
}

impl Supervisor {
    pub(super) fn new(counters: Arc<Counters>, signals: Signals, events: Receiver<Event>, reloader: Reloader) -> Self {
        let watchdog = Watchdog::from_env(monotonic_us());
        let hardware = Hardware::new(hardware::root(), reloader.live().hardware.clone());
        let (adaptation, log) = (Adaptation::default(), Log::default());
        Self { counters, signals, events, reloader, watchdog, adaptation, log, hardware }
    }

    /// Runs until the service is to stop, or until `all_run` says that a thread has ended by itself.
    pub(super) fn run(&mut self, all_run: impl Fn() -> bool) {
        tracing::info!("board {}", Machine::detect(&hardware::root()).tell(self.reloader.live().board));
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
        let counters = &self.counters;
        let load = counters.recent.load().filter(|_| counters.camera_open.load(Relaxed));
        let conditions = Conditions {
            is_allowed: self.reloader.live().adaptation.enabled,
            load,
            impaired_by: counters.impairments.present(),
            has_smaller_mode: counters.has_smaller_mode.load(Relaxed),
        };
        let before = self.adaptation.step();
        let [is_new_step, is_new_size] = self.adaptation.update(monotonic_us(), &conditions);
        if is_new_step {
            let (step, cause) = (self.adaptation.step(), self.adaptation.cause());
            counters.set_step(step, cause);
            match (cause, load) {
                (Some(cause), Some(load)) if step > before => Log::step_down(step, cause, &load),
                _ => Log::step_up(step),
            }
        }
        if is_new_size {
            let is_small = self.adaptation.is_picture_small();
            counters.small_picture.store(is_small, Relaxed);
            Log::picture_size(is_small, load);
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

    fn lock_memory(&mut self) {
        if self.reloader.live().realtime.lock_memory {
            self.log.grant(realtime::lock_memory());
        }
    }
}
