//! Reload on SIGHUP: new settings take effect whole or not at all, while the service runs.
//!
//! The loader's thread reads the settings and builds what they change, because loading networks may take seconds. If
//! anything fails, the current settings stay. Otherwise the hot loop and the sender each find their part of the change
//! in a channel, take it between frames, and free what it replaces; that may delay one frame.

use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::sync::{Arc, Mutex, PoisonError, mpsc};
use std::thread::{Builder, Thread};

use super::STACK_BYTES;
use super::hot::{HotChange, HotNews};
use super::links::Links;
use super::sender::SenderSettings;
use crate::calibration::{Store, StoreError, WearerName};
use crate::config::{Faults, LogLevel, Settings};
use crate::link::{LinkError, Traffic};
use crate::preflight::{SetupError, is_same_profile, load_model, load_tracker, model_warning};
use facewire_face::Profile;

/// The program around the service, as far as a reload needs it.
pub trait Program: Send + Sync {
    /// Reads the settings again.
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

/// The wearer whose profile is in use, which need not be the one that the settings name.
#[derive(Debug, Clone)]
pub(super) struct InUse(Arc<Mutex<Option<WearerName>>>);

impl InUse {
    pub(super) fn new(name: Option<WearerName>) -> Self {
        Self(Arc::new(Mutex::new(name)))
    }

    pub(super) fn get(&self) -> Option<WearerName> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    pub(super) fn set(&self, name: Option<WearerName>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = name;
    }
}

/// New settings with the parts that they change, loaded and opened.
struct Change {
    settings: Settings,
    hot: HotChange,
    sender: SenderSettings,
}

impl Change {
    /// Reads the settings and builds the parts that differ from the current ones. The files of the model and of the wearer in
    /// use are read again even if their names stay, because they may have changed; the hot loop compares them.
    fn prepare(
        program: &dyn Program,
        live: &Settings,
        traffic: &Arc<Traffic>,
        in_use: Option<WearerName>,
    ) -> Result<Self, Refusal> {
        let new = program.load()?;
        let is_new_model = new.solver.model != live.solver.model;
        let tracker = (new.networks != live.networks).then(|| load_tracker(&new.networks)).transpose();
        let model = match load_model(&new.solver) {
            Ok(_) if !is_new_model && new.solver.model.is_empty() => None,
            Err(error) if !is_new_model => {
                tracing::warn!("{error}; the present model stays");
                None
            }
            model => Some(model?),
        };
        let is_same_wearer = is_same_profile(&new.wearer, &live.wearer);
        let name = if is_same_wearer { in_use } else { WearerName::new(&new.wearer.name) };
        let profile = match name.map(|name| Store::new(&new.wearer.folder).load(&name)) {
            None if is_same_wearer => None,
            None => Some(Profile::default()),
            Some(Err(error)) if is_same_wearer => {
                tracing::warn!("{error}; the present profile stays");
                None
            }
            Some(file) => Some(file?.profile),
        };
        let hot = HotChange { settings: new.clone(), tracker: tracker.map_err(SetupError::from)?, model, profile };
        if hot.model.is_some() || hot.profile.is_some() {
            model_warning(&new).inspect(|warning| tracing::warn!("{warning}"));
        }
        let links = if new.links == live.links { None } else { Some(Links::change(&new.links, &live.links, traffic)?) };
        Ok(Self { hot, sender: SenderSettings::new(&new, links), settings: new })
    }
}

/// The thread that loads networks, models and profiles, at the start, for a reload and after the engine has failed.
///
/// It is one thread for all of them because the C library gives each thread a heap of its own, and keeps what was once in
/// use there. It has neither the priority nor the CPU of the hot loop, which the helper threads of the networks would
/// inherit.
#[derive(Debug, Clone)]
pub(super) struct Loader(mpsc::Sender<Box<dyn FnOnce() + Send>>);

impl Loader {
    pub(super) fn start() -> io::Result<Self> {
        let (jobs, to_do) = mpsc::channel::<Box<dyn FnOnce() + Send>>();
        let run = || to_do.into_iter().for_each(|job| drop(catch_unwind(AssertUnwindSafe(job))));
        Builder::new().name("fw-load".to_owned()).stack_size(STACK_BYTES).spawn(run)?;
        Ok(Self(jobs))
    }

    /// Begins a job. Its result never comes if it panics.
    pub(super) fn begin<T: Send + 'static>(&self, job: impl FnOnce() -> T + Send + 'static) -> Receiver<T> {
        let (done, result) = mpsc::channel();
        // Nobody waits for the result any more if the service ends meanwhile.
        let _ = self.0.send(Box::new(move || drop(done.send(job()))));
        result
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
    loader: Loader,
    in_use: InUse,
    preparing: Option<Receiver<Result<Change, Refusal>>>,
}

impl Reloader {
    pub(super) fn new(
        live: Settings,
        program: Arc<dyn Program>,
        mailboxes: Mailboxes,
        traffic: Arc<Traffic>,
        loader: Loader,
        in_use: InUse,
    ) -> Self {
        Self { live, program, mailboxes, traffic, loader, in_use, preparing: None }
    }

    /// The current settings.
    pub(super) fn live(&self) -> &Settings {
        &self.live
    }

    /// Whether a reload can begin: one reload runs at a time.
    pub(super) fn is_idle(&self) -> bool {
        self.preparing.is_none()
    }

    /// Begins to prepare a reload.
    pub(super) fn start(&mut self) {
        tracing::info!("reading the settings again");
        let (program, live, traffic) = (Arc::clone(&self.program), self.live.clone(), Arc::clone(&self.traffic));
        let in_use = self.in_use.get();
        self.preparing = Some(self.loader.begin(move || Change::prepare(&*program, &live, &traffic, in_use)));
    }

    /// Hands out the change if it is prepared by now. Returns whether it has.
    pub(super) fn step(&mut self) -> bool {
        let prepared = match self.preparing.as_ref().map(Receiver::try_recv) {
            None | Some(Err(TryRecvError::Empty)) => return false,
            Some(prepared) => prepared,
        };
        self.preparing = None;
        match prepared {
            Ok(Ok(change)) => {
                self.hand_out(change);
                return true;
            }
            Ok(Err(refusal)) => refuse(&refusal),
            Err(_) => refuse(&io::Error::other("the thread that read them panicked; please report it")),
        }
        false
    }

    /// Hands out the change. Links look up their host names again on every reload, and a model or profile may have changed
    /// in its file, even if the settings are the same.
    fn hand_out(&mut self, Change { mut settings, hot, sender }: Change) {
        match &*settings.changed_keys(&self.live) {
            [] => tracing::info!("settings are unchanged"),
            changed => tracing::info!("settings changed: {}", changed.join(", ")),
        }
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
    }
}

/// Logs one line for each fault.
fn refuse(reason: &dyn std::error::Error) {
    for line in reason.to_string().lines() {
        tracing::error!("{line}");
    }
    tracing::error!("settings refused: the current ones stay");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::test_profile;
    use crate::config;

    /// One change of every table that the settings have.
    const CHANGES: [(&str, &str); 16] = [
        ("board", "board = \"pi4\""),
        ("camera", "[camera]\nfps = 15"),
        ("networks", "[networks]\nthreads = 2"),
        ("solver", "[solver]\nmodel = \"/other.toml\""),
        ("smoothing", "[smoothing]\nhead_ms = 77"),
        ("wearer", "[wearer]\nname = \"anna\""),
        ("plausibility", "[plausibility]\nlids = false"),
        ("adjust", "[adjust]\nmirror = true"),
        ("failsafe", "[failsafe]\nlive_ms = 151"),
        ("send", "[send]\nrate_hz = 61"),
        ("link", "[[link]]\naddress = \"127.0.0.1:5999\""),
        ("realtime", "[realtime]\npriority = 7"),
        ("hardware", "[hardware]\ntemperature_limit_c = 66"),
        ("adaptation", "[adaptation]\nenabled = false"),
        ("metrics", "[metrics]\nlisten = \"127.0.0.1:9101\""),
        ("log", "[log]\nlevel = \"debug\""),
    ];

    struct Fixed(String);

    impl Program for Fixed {
        fn load(&self) -> Result<Settings, Faults> {
            config::parse("test", &self.0)
        }

        fn set_log_level(&self, _: LogLevel) {}
    }

    /// A reloader, and what the hot loop finds in its mailbox.
    fn reloader(toml: &str, live: Settings, in_use: Option<&str>) -> (Reloader, Receiver<HotNews>) {
        let thread = std::thread::current();
        let ((hot, told), (sender, _), (control, _)) = (mpsc::channel(), mpsc::channel(), mpsc::channel());
        let mailboxes = Mailboxes {
            hot: Mailbox { changes: hot, thread: thread.clone() },
            sender: Mailbox { changes: sender, thread },
            control,
        };
        let in_use = InUse::new(in_use.and_then(WearerName::new));
        let program = Arc::new(Fixed(toml.to_owned()));
        (Reloader::new(live, program, mailboxes, Arc::default(), Loader::start().unwrap(), in_use), told)
    }

    fn change(new: &Settings) -> Change {
        let hot = HotChange { settings: new.clone(), tracker: None, model: None, profile: None };
        Change { hot, sender: SenderSettings::new(new, None), settings: new.clone() }
    }

    #[test]
    fn a_change_of_any_table_takes_effect_or_waits_for_the_next_start() {
        let all: Vec<&str> = CHANGES.iter().filter(|(table, _)| *table != "board").map(|(_, toml)| *toml).collect();
        let all = config::parse("test", &all.join("\n")).unwrap();
        let tables = CHANGES.map(|(table, _)| table);
        let mut changed = all.changed_keys(&Settings::default());
        changed.push("board");
        assert!(changed.len() == tables.len() && tables.iter().all(|table| changed.contains(table)), "{changed:?}");
        for (table, toml) in CHANGES {
            let new = config::parse("test", toml).unwrap();
            let (mut reloader, told) = reloader(toml, Settings::default(), None);
            assert!(new.changed_keys(&Settings::default()).contains(&table), "{table}");
            reloader.hand_out(change(&new));
            assert!(told.try_recv().is_ok(), "{table} is ignored");
            assert_eq!(*reloader.live() == new, table != "realtime", "{table}");
        }
    }

    fn reloaded(mut reloader: Reloader, told: &Receiver<HotNews>) -> HotChange {
        reloader.start();
        while !reloader.step() {
            std::thread::yield_now();
        }
        let Ok(HotNews::Settings(change)) = told.try_recv() else { panic!("the hot loop is told nothing") };
        *change
    }

    #[test]
    fn a_model_and_a_profile_that_have_changed_under_the_same_path_are_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let (model, name) = (folder.path().join("model.toml"), WearerName::new("anna").unwrap());
        let toml = format!("[solver]\nmodel = {model:?}\n[wearer]\nname = \"bob\"\nfolder = {:?}\n", folder.path());
        let live = config::parse("test", &toml).unwrap();
        let read = || {
            let (reloader, told) = reloader(&toml, live.clone(), Some("anna"));
            reloaded(reloader, &told)
        };
        let nothing = read();
        assert!(nothing.model.is_none() && nothing.profile.is_none(), "what is missing stays as it is");
        let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/models/blendshapes.toml");
        std::fs::copy(shipped, &model).unwrap();
        let file = test_profile(7);
        Store::new(live.wearer.folder.as_str()).save(&name, &file).unwrap();
        let changed = read();
        assert!(changed.model.is_some());
        assert_eq!(changed.profile, Some(file.profile));
    }
}
