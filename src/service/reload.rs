//! Reload on SIGHUP: new settings take effect whole or not at all, while the service runs.
//!
//! The loader's thread reads the settings and builds what they change, because loading networks may take seconds. The hot
//! loop and the sender take their parts between frames, and free what they replace; that may delay one frame.

use std::error::Error;
use std::sync::mpsc::{Receiver, TryRecvError};
use std::sync::{Arc, PoisonError, mpsc};
use std::thread::Thread;

use tracing::level_filters::LevelFilter;

use super::Loader;
use super::counters::Counters;
use super::hot::HotChange;
use super::kept::Kept;
use super::sender::Links;
use crate::calibration::model_hash;
use crate::config::{Faults, Settings};
use crate::pipeline::{is_same_profile, load_model, load_profile, load_tracker};
use facewire_packet::control::Reply;

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;
pub(super) type LoadSettings = Arc<dyn Fn() -> Result<Settings, Faults> + Send + Sync>;

pub(super) struct Change {
    settings: Settings,
    hot: HotChange,
    links: Links,
    warning: Option<String>,
}

impl Change {
    /// Builds the parts that differ from the current ones. The files of the model and of the wearer in use are read again
    /// even if their names stay, because they may have changed; the hot loop compares them.
    fn prepare(load_settings: &LoadSettings, live: &Settings, counters: &Counters) -> Outcome<Self> {
        let new = load_settings()?;
        let is_same_model = new.solver == live.solver;
        let tracker = (new.networks != live.networks).then(|| load_tracker(&new.networks)).transpose()?;
        let keeps_model = is_same_model && new.solver.model.is_empty();
        let model = replaced(keeps_model, is_same_model, "model", || load_model(&new.solver))?;
        let is_same_wearer = is_same_profile(&new.wearer, &live.wearer);
        let mut wearer = new.wearer.clone();
        if is_same_wearer {
            wearer.name = counters.wearer().map_or_else(String::new, |name| name.to_string());
        }
        let keeps_profile = is_same_wearer && wearer.name.is_empty();
        let load_profile = || load_profile(&wearer, &new.solver);
        let (profile, warning) = replaced(keeps_profile, is_same_wearer, "profile", load_profile)?.unzip();
        let hot = HotChange { settings: Some(new.clone()), tracker, model, profile };
        let links = Links::change(&new, counters.panels(), &counters.traffic)?;
        Ok(Self { settings: new, hot, links, warning: warning.flatten() })
    }
}

/// Loads a part. Keeps the current one if `keeps` is set, or if `is_same` is set and the part does not load.
fn replaced<T, E: Error>(
    keeps: bool,
    is_same: bool,
    what: &str,
    load: impl FnOnce() -> Result<T, E>,
) -> Result<Option<T>, E> {
    match (!keeps).then(load).transpose() {
        Err(error) if is_same => {
            tracing::warn!("{error}; the present {what} stays");
            Ok(None)
        }
        loaded => loaded,
    }
}

pub(super) struct Mailbox<T> {
    pub(super) changes: mpsc::Sender<T>,
    pub(super) thread: Thread,
}

impl<T> Mailbox<T> {
    /// Leaves a change for the thread and wakes it. A thread that has ended needs no change.
    pub(super) fn send(&self, change: T) {
        let _ = self.changes.send(change);
        self.thread.unpark();
    }
}

pub(super) struct Reloader {
    pub(super) live: Settings,
    /// The file of the settings.
    pub(super) config: Option<String>,
    pub(super) load_settings: LoadSettings,
    pub(super) set_level: Box<dyn Fn(LevelFilter)>,
    pub(super) hot: Arc<Mailbox<HotChange>>,
    pub(super) sender: Mailbox<Links>,
    /// The control thread takes the settings, and the hash of a model that was read, from here within a second.
    pub(super) control: mpsc::Sender<(Settings, Option<u32>)>,
    pub(super) counters: Arc<Counters>,
    pub(super) loader: Loader,
    pub(super) keeper: Loader,
    pub(super) kept: Kept,
    /// The change that the loader prepares.
    pub(super) change: Option<Receiver<Outcome<Change>>>,
    /// Who asks for a reload, and who waits for the end of this one.
    pub(super) asked: Receiver<mpsc::Sender<Reply>>,
    pub(super) askers: Vec<mpsc::Sender<Reply>>,
}

impl Reloader {
    pub(super) fn start(&mut self) {
        tracing::info!("reading the settings again");
        let load = Arc::clone(&self.load_settings);
        let live = self.live.clone();
        let counters = Arc::clone(&self.counters);
        self.change = Some(self.loader.begin(move || Change::prepare(&load, &live, &counters)));
    }

    /// Hands out the prepared change once it is ready. Returns whether it did.
    pub(super) fn step(&mut self) -> bool {
        let prepared = match self.change.as_ref().map(Receiver::try_recv) {
            None | Some(Err(TryRecvError::Empty)) => return false,
            Some(prepared) => prepared,
        };
        self.change = None;
        let refusal = match prepared {
            Ok(Ok(change)) => {
                let done = self.hand_out(change);
                self.tell(&Reply::Done(done));
                return true;
            }
            Ok(Err(refusal)) => refusal.to_string(),
            Err(_) => "the thread that read them panicked; please report it".to_owned(),
        };
        refusal.lines().for_each(|fault| tracing::error!("{fault}"));
        tracing::error!("settings refused: the current ones stay");
        self.tell(&Reply::Refused(refusal));
        false
    }

    /// Has the loader keep the settings in force, by which `facewire rest` releases servos if later ones have faults.
    pub(super) fn keep_settings(&self) {
        let has_servos = self.live.links.iter().any(|link| link.kind.moves_servos());
        let Some(config) = self.config.clone().filter(|_| has_servos) else { return };
        let kept = self.kept.clone();
        self.keeper.begin(move || kept.keep_settings_of(&config));
    }

    /// Answers all who wait, and keeps the refusal for those who ask later. One who has gone needs no answer.
    fn tell(&mut self, reply: &Reply) {
        let refusal = if let Reply::Refused(why) = reply { Some(why.clone()) } else { None };
        *self.counters.settings_refused.lock().unwrap_or_else(PoisonError::into_inner) = refusal;
        self.askers.drain(..).for_each(|asker| drop(asker.send(reply.clone())));
    }

    /// Hands out the change, and returns what has changed. Links look up their host names again on every reload, and a
    /// model or profile may have changed in its file, even if the settings are the same.
    fn hand_out(&mut self, Change { mut settings, hot, links, warning }: Change) -> String {
        let mut done = match &*settings.changed_keys(&self.live) {
            [] => "settings are unchanged".to_owned(),
            changed => format!("settings changed: {}", changed.join(", ")),
        };
        tracing::info!("{done}");
        let late = "[realtime] takes effect at the next start: restart the service to change it now";
        let late = (settings.realtime != self.live.realtime).then_some(late);
        for warning in warning.as_deref().into_iter().chain(late) {
            tracing::warn!("{warning}");
            done += &format!("\n{warning}");
        }
        settings.realtime = self.live.realtime.clone();
        (self.set_level)(settings.log.level);
        self.live = settings;
        self.keep_settings();
        let model = hot.model.as_ref().map(model_hash);
        self.hot.send(hot);
        self.counters.set_panels(links.panels());
        self.sender.send(links);
        // Without a control socket nobody reads it.
        let _ = self.control.send((self.live.clone(), model));
        done
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{Store, WearerName, test_profile};
    use crate::config;

    fn fixed(toml: &str) -> LoadSettings {
        let toml = toml.to_owned();
        Arc::new(move || config::parse("test", &toml))
    }

    /// Reloads these settings in place of the live ones. Returns the live ones then, what the hot loop is told, and the
    /// answer.
    fn reload(toml: &str, live: Settings) -> (Settings, Option<HotChange>, Reply) {
        let thread = std::thread::current();
        let (hot, told) = mpsc::channel();
        let (sender, _) = mpsc::channel();
        let (control, _) = mpsc::channel();
        let hot = Arc::new(Mailbox { changes: hot, thread: thread.clone() });
        let sender = Mailbox { changes: sender, thread };
        let load_settings = fixed(toml);
        let set_level = Box::new(|_| {});
        let [loader, keeper] = [(); 2].map(|()| Loader::start("fw-load").unwrap());
        let kept = Kept::inside("/nonexistent".into(), None);
        let counters = Arc::default();
        let change = None;
        let (asker, answer) = mpsc::channel();
        let asked = mpsc::channel().1;
        let askers = vec![asker];
        let config = None;
        let mut reloader = Reloader {
            live,
            config,
            load_settings,
            set_level,
            hot,
            sender,
            control,
            counters,
            loader,
            keeper,
            kept,
            change,
            asked,
            askers,
        };
        reloader.start();
        while reloader.change.is_some() {
            reloader.step();
            std::thread::yield_now();
        }
        let answer = answer.recv().expect("an answer");
        let refused = reloader.counters.settings_refused.lock().unwrap().clone();
        assert_eq!(refused, if let Reply::Refused(why) = &answer { Some(why.clone()) } else { None });
        (reloader.live, told.try_recv().ok(), answer)
    }

    #[test]
    fn a_change_of_any_table_takes_effect_or_waits_for_the_next_start() {
        for toml in ["board = \"pi4\"", "[hardware]\ntemperature_limit_c = 66", "[realtime]\npriority = 7"] {
            let new = config::parse("test", toml).unwrap();
            let (live, hot, answer) = reload(toml, Settings::default());
            assert!(new != Settings::default() && hot.unwrap().settings.as_ref() == Some(&new), "{toml}");
            assert_eq!(live == new, !toml.contains("realtime"), "{toml}");
            let Reply::Done(done) = answer else { panic!("{answer:?}") };
            assert!(done.starts_with("settings changed: ") && done.contains("restart") != (live == new), "{done}");
        }
    }

    #[test]
    fn who_asks_for_a_reload_that_is_refused_is_told_every_fault() {
        let (live, hot, answer) = reload("[camera]\nfps = 0\nwidth = 1\n", Settings::default());
        let Reply::Refused(faults) = answer else { panic!("{answer:?}") };
        assert_eq!((live, hot.is_none(), faults.lines().count()), (Settings::default(), true, 2), "{faults}");
    }

    #[test]
    fn a_model_and_a_profile_that_have_changed_under_the_same_path_are_read_again() {
        let folder = tempfile::tempdir().unwrap();
        let model = folder.path().join("model.toml");
        let name = WearerName::new("anna").unwrap();
        let toml = format!("[solver]\nmodel = {model:?}\n[wearer]\nname = \"bob\"\nfolder = {:?}\n", folder.path());
        let live = config::parse("test", &toml).unwrap();
        let counters = Counters::default();
        counters.set_wearer(Some(name.clone()));
        let prepare = || Change::prepare(&fixed(&toml), &live, &counters).unwrap();
        let missing = prepare().hot;
        assert!(missing.model.is_none() && missing.profile.is_none(), "what is missing stays as it is");
        let shipped = concat!(env!("CARGO_MANIFEST_DIR"), "/models/blendshapes.toml");
        std::fs::copy(shipped, &model).unwrap();
        let file = test_profile(7);
        Store::new(live.wearer.folder.as_str()).save(&name, &file).unwrap();
        let changed = prepare();
        assert_eq!((changed.hot.model.is_some(), changed.hot.profile), (true, Some(file.profile)));
        let warning = changed.warning.unwrap();
        assert!(warning.contains("anna") && !warning.contains("bob"), "that of the wearer in use: {warning}");
    }
}
