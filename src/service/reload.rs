//! Reload on SIGHUP: new settings take effect whole or not at all, while the service runs.
//!
//! A thread of its own reads the settings and builds what they change, because loading networks may take seconds. If
//! anything fails, the current settings stay. Otherwise the hot loop and the sender each find their part of the change
//! in a channel, take it between frames, and free what it replaces; that may delay one frame.

use std::io;
use std::sync::{Arc, mpsc};
use std::thread::{Builder, JoinHandle, Thread};

use super::hot::{HotChange, HotNews};
use super::links::Links;
use super::sender::SenderSettings;
use crate::calibration::StoreError;
use crate::config::{Faults, LogLevel, Settings};
use crate::link::{LinkError, Traffic};
use crate::preflight::{SetupError, is_same_profile, load_model, load_profile, load_tracker};

/// The program around the service, as far as a reload needs it.
pub trait Program: Send + Sync {
    /// Reads the settings again.
    ///
    /// # Errors
    /// Returns every fault of the settings.
    fn load(&self) -> Result<Settings, Faults>;

    /// Sets the least severe level that is logged.
    fn set_log_level(&self, level: LogLevel);
}

/// Why a reload is refused.
#[derive(Debug, thiserror::Error)]
enum Refusal {
    #[error(transparent)]
    Settings(#[from] Faults),
    #[error(transparent)]
    Setup(#[from] SetupError),
    #[error(transparent)]
    Wearer(#[from] StoreError),
    #[error(transparent)]
    Link(#[from] LinkError),
}

/// New settings with the parts that they change, loaded and opened.
struct Change {
    settings: Settings,
    hot: HotChange,
    sender: SenderSettings,
}

impl Change {
    /// Reads the settings and builds the parts that differ from the current ones.
    fn prepare(program: &dyn Program, live: &Settings, traffic: &Arc<Traffic>) -> Result<Self, Refusal> {
        let new = program.load()?;
        let is_new_model = new.solver.model != live.solver.model;
        let hot = HotChange {
            settings: new.clone(),
            tracker: if new.networks == live.networks {
                None
            } else {
                Some(load_tracker(&new.networks).map_err(SetupError::from)?)
            },
            model: if is_new_model { Some(load_model(&new.solver)?) } else { None },
            profile: if is_same_profile(&new.wearer, &live.wearer) { None } else { Some(load_profile(&new.wearer)?) },
        };
        let links = if new.links == live.links { None } else { Some(Links::change(&new.links, &live.links, traffic)?) };
        Ok(Self { hot, sender: SenderSettings::new(&new, links), settings: new })
    }
}

/// Where the changes for one thread go.
pub(super) struct Mailbox<T> {
    pub(super) changes: mpsc::Sender<T>,
    pub(super) thread: Thread,
}

impl<T> Clone for Mailbox<T> {
    fn clone(&self) -> Self {
        Self { changes: self.changes.clone(), thread: self.thread.clone() }
    }
}

impl<T> Mailbox<T> {
    /// Leaves a change for the thread and wakes it. A thread that has ended needs no change.
    pub(super) fn send(&self, change: T) {
        let _ = self.changes.send(change);
        self.thread.unpark();
    }
}

/// Where the changes for all threads go.
pub(super) struct Mailboxes {
    pub(super) hot: Mailbox<HotNews>,
    pub(super) sender: Mailbox<SenderSettings>,
    /// The control thread looks here when it has something to do.
    pub(super) control: mpsc::Sender<Settings>,
}

/// The current settings, and the reload in progress.
pub(super) struct Reloader {
    live: Settings,
    program: Arc<dyn Program>,
    mailboxes: Mailboxes,
    traffic: Arc<Traffic>,
    preparing: Option<JoinHandle<Result<Change, Refusal>>>,
}

impl Reloader {
    pub(super) fn new(live: Settings, program: Arc<dyn Program>, mailboxes: Mailboxes, traffic: Arc<Traffic>) -> Self {
        Self { live, program, mailboxes, traffic, preparing: None }
    }

    /// The current settings.
    pub(super) fn live(&self) -> &Settings {
        &self.live
    }

    /// Whether a reload can begin: one reload runs at a time.
    pub(super) fn is_idle(&self) -> bool {
        self.preparing.is_none()
    }

    /// Begins to prepare a reload on a thread of its own.
    pub(super) fn start(&mut self) {
        tracing::info!("reading the settings again");
        let (program, live, traffic) = (Arc::clone(&self.program), self.live.clone(), Arc::clone(&self.traffic));
        let prepare = move || Change::prepare(&*program, &live, &traffic);
        match Builder::new().name("fw-reload".to_owned()).spawn(prepare) {
            Ok(thread) => self.preparing = Some(thread),
            Err(error) => refuse(&error),
        }
    }

    /// Hands out the change if it is prepared by now. Returns whether the settings have changed.
    pub(super) fn step(&mut self) -> bool {
        let Some(thread) = self.preparing.take_if(|thread| thread.is_finished()) else { return false };
        match thread.join() {
            Ok(Ok(change)) => return self.hand_out(change),
            Ok(Err(refusal)) => refuse(&refusal),
            Err(_) => refuse(&io::Error::other("the thread that read them panicked; please report it")),
        }
        false
    }

    fn hand_out(&mut self, Change { mut settings, hot, sender }: Change) -> bool {
        let changed = changed_tables(&self.live, &settings);
        if changed.is_empty() {
            tracing::info!("settings are unchanged");
            // The sender's links look up their host names again on every reload.
            self.mailboxes.sender.send(sender);
            return false;
        }
        tracing::info!("settings changed: {}", changed.join(", "));
        if settings.realtime != self.live.realtime {
            tracing::warn!("[realtime] takes effect at the next start: restart the service to change it now");
            settings.realtime = self.live.realtime.clone();
        }
        self.program.set_log_level(settings.log.level);
        self.live = settings;
        self.mailboxes.hot.send(HotNews::Settings(Box::new(hot)));
        self.mailboxes.sender.send(sender);
        // Without a control socket nobody reads it.
        let _ = self.mailboxes.control.send(self.live.clone());
        true
    }
}

/// Logs one line for each fault.
fn refuse(reason: &dyn std::error::Error) {
    for line in reason.to_string().lines() {
        tracing::error!("{line}");
    }
    tracing::error!("settings refused: the current ones stay");
}

/// Returns the names of the tables that differ.
fn changed_tables(old: &Settings, new: &Settings) -> Vec<&'static str> {
    let tables = [
        ("camera", old.camera != new.camera),
        ("networks", old.networks != new.networks),
        ("solver", old.solver != new.solver),
        ("smoothing", old.smoothing != new.smoothing),
        ("wearer", old.wearer != new.wearer),
        ("plausibility", old.plausibility != new.plausibility),
        ("adjust", old.adjust != new.adjust),
        ("failsafe", old.failsafe != new.failsafe),
        ("send", old.send != new.send),
        ("link", old.links != new.links),
        ("realtime", old.realtime != new.realtime),
        ("metrics", old.metrics != new.metrics),
        ("log", old.log != new.log),
    ];
    tables.into_iter().filter(|(_, is_changed)| *is_changed).map(|(name, _)| name).collect()
}
