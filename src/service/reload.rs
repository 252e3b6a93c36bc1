//! SIGHUP: new settings, built and checked beside the running service, and taken whole or not at all.
//!
//! Reading the file, resolving names and loading networks may take seconds. A thread of its own does it, so that the
//! watchdog is served meanwhile; at the first fault the old settings stay.

use std::io;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle, Thread};

use super::counters::Counters;
use super::exchange::Exchange;
use super::heartbeat::Watch;
use super::hot::HotChange;
use super::links::Links;
use super::sender::SenderSettings;
use crate::config::{Faults, LogLevel, Settings};
use crate::link::LinkError;
use crate::pipeline::{SetupError, Solver, load_tracker};

/// What the service needs of the program around it to change its settings.
pub trait Program: Send + Sync {
    /// Reads the settings again.
    ///
    /// # Errors
    /// Every fault found.
    fn load(&self) -> Result<Settings, Faults>;

    /// Changes what is logged.
    fn set_log_level(&self, level: LogLevel);
}

/// Why settings are refused.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    Settings(#[from] Faults),
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error(transparent)]
    Link(#[from] LinkError),
}

/// Everything that new settings need, ready to be taken.
struct Change {
    settings: Settings,
    hot: HotChange,
    sender: SenderSettings,
}

impl Change {
    /// Reads the settings and builds what differs from the live ones.
    fn prepare(program: &dyn Program, live: &Settings) -> Result<Self, Refusal> {
        let new = program.load()?;
        let is_new_camera = new.camera != live.camera;
        // The solver goes by the camera's field of view.
        let is_new_solver = new.solver != live.solver || is_new_camera;
        let hot = HotChange {
            camera: is_new_camera.then(|| new.camera.clone()),
            tracker: if new.networks == live.networks {
                None
            } else {
                Some(load_tracker(&new.networks).map_err(SetupError::from)?)
            },
            solver: if is_new_solver { Some(Solver::load(&new)?) } else { None },
        };
        let links = if new.links == live.links { None } else { Some(Links::change(&new.links, &live.links)?) };
        Ok(Self { hot, sender: SenderSettings::new(&new, links), settings: new })
    }
}

/// A thread that takes changes.
pub(super) struct Taker<T> {
    pub(super) changes: Arc<Exchange<T>>,
    pub(super) thread: Thread,
}

impl<T> Taker<T> {
    fn offer(&self, change: T) {
        self.changes.offer(change);
        self.thread.unpark();
    }
}

/// The live settings and how they change.
pub(super) struct Reloader {
    live: Settings,
    /// Those that the threads may still go by.
    former: Option<Settings>,
    program: Arc<dyn Program>,
    hot: Taker<HotChange>,
    sender: Taker<SenderSettings>,
    counters: Arc<Counters>,
    preparing: Option<JoinHandle<Result<Change, Refusal>>>,
    /// Prepared, while the threads have not taken the change before it.
    prepared: Option<Change>,
}

impl Reloader {
    pub(super) fn new(
        live: Settings,
        program: Arc<dyn Program>,
        hot: Taker<HotChange>,
        sender: Taker<SenderSettings>,
        counters: Arc<Counters>,
    ) -> Self {
        Self { live, former: None, program, hot, sender, counters, preparing: None, prepared: None }
    }

    /// The settings that hold now.
    pub(super) fn live(&self) -> &Settings {
        &self.live
    }

    /// How long the hot loop may wait, by the new settings or by those that it has not left yet.
    pub(super) fn watch(&self) -> Watch {
        let live = Watch::new(&self.live.camera);
        self.former.as_ref().map_or(live, |former| live.max(Watch::new(&former.camera)))
    }

    /// Whether settings can be read: one change waits at most.
    pub(super) fn is_ready(&self) -> bool {
        self.preparing.is_none() && self.prepared.is_none()
    }

    /// Begins a reload.
    pub(super) fn start(&mut self) {
        tracing::info!("reading the settings again");
        let (program, live) = (Arc::clone(&self.program), self.live.clone());
        let prepare = move || Change::prepare(&*program, &live);
        match Builder::new().name("fw-reload".to_owned()).spawn(prepare) {
            Ok(thread) => self.preparing = Some(thread),
            Err(error) => refuse(&error),
        }
    }

    /// Goes on with a reload; whether new settings have been taken just now.
    pub(super) fn step(&mut self) -> bool {
        if let Some(thread) = self.preparing.take_if(|thread| thread.is_finished()) {
            self.conclude(thread);
        }
        let is_taken = self.former.is_some() && !self.hot.changes.is_waiting() && !self.sender.changes.is_waiting();
        if is_taken {
            self.finish();
        }
        if self.former.is_none()
            && let Some(change) = self.prepared.take()
        {
            self.offer(change);
        }
        is_taken
    }

    /// Keeps the prepared change, or says why there is none.
    fn conclude(&mut self, thread: JoinHandle<Result<Change, Refusal>>) {
        match thread.join() {
            Ok(Ok(change)) => self.prepared = Some(change),
            Ok(Err(refusal)) => refuse(&refusal),
            Err(_) => refuse(&io::Error::other("reading them ended by a panic")),
        }
    }

    /// Hands the change out to the threads.
    fn offer(&mut self, change: Change) {
        let changed = changed_tables(&self.live, &change.settings);
        if changed.is_empty() {
            tracing::info!("settings are unchanged");
            return;
        }
        tracing::info!("settings changed: {}", changed.join(", "));
        let mut settings = change.settings;
        if settings.realtime != self.live.realtime {
            tracing::warn!("[realtime] is read at the start only: restart the service to change it");
            settings.realtime = self.live.realtime.clone();
        }
        self.program.set_log_level(settings.log.level);
        self.former = Some(std::mem::replace(&mut self.live, settings));
        self.hot.offer(change.hot);
        self.sender.offer(change.sender);
    }

    /// Frees what the threads left, on a thread of its own: a serial port that hangs takes its time to close.
    fn finish(&mut self) {
        let (hot, sender) = (self.hot.changes.left(), self.sender.changes.left());
        let counters = Arc::clone(&self.counters);
        let free = move || {
            if let Some(left) = sender {
                left.close(&counters);
            }
            drop(hot);
        };
        if let Err(error) = Builder::new().name("fw-free".to_owned()).spawn(free) {
            tracing::debug!("what was replaced was freed without a thread: {error}");
        }
        self.former = None;
        tracing::info!("new settings hold");
    }
}

/// One line for each fault.
fn refuse(reason: &dyn std::error::Error) {
    for line in reason.to_string().lines() {
        tracing::error!("{line}");
    }
    tracing::error!("settings refused: the old ones stay");
}

/// Names of the tables that differ.
fn changed_tables(old: &Settings, new: &Settings) -> Vec<&'static str> {
    let tables = [
        ("camera", old.camera != new.camera),
        ("networks", old.networks != new.networks),
        ("solver", old.solver != new.solver),
        ("failsafe", old.failsafe != new.failsafe),
        ("send", old.send != new.send),
        ("link", old.links != new.links),
        ("realtime", old.realtime != new.realtime),
        ("metrics", old.metrics != new.metrics),
        ("log", old.log != new.log),
    ];
    tables.into_iter().filter(|(_, is_changed)| *is_changed).map(|(name, _)| name).collect()
}
