//! The task of a client that calibrates a wearer: it is shown how far the guide is. One calibration runs at a time.

use std::io;
use std::sync::mpsc::Receiver;

use facewire_packet::control::{Progress, Refusal, Reply};

use super::client::Client;
use super::wait::{Outcome, poll_outcome};
use super::wearers::{InUse, named};
use super::{DEFAULT_WEARER, Peers};
use crate::calibration::{Calibration, Guide, Observation, Store, WearerName};
use crate::clock::monotonic_us;
use crate::config::{Settings, WearerSettings};
use crate::pipeline::load_model;
use crate::service::observer::Observed;
use crate::service::{DISK_PATIENCE, Loader};

/// Least time between two messages of progress that differ only in the bars, microseconds.
const PROGRESS_US: u64 = 60_000;
const MODEL_CHANGED: &str =
    "no profile was made, and any former one stays. The blendshape model has changed: try again";

const WEARS_CHANGED: &str =
    "no profile was made, and any former one stays. The setting wearer.wears has changed: try again";

pub(super) struct Calibrating {
    wearer: WearerName,
    stage: Stage,
}

impl Calibrating {
    /// Begins a calibration of this wearer, or else of the one in use.
    pub(super) fn begin(wearer: Option<&str>, peers: &Peers, settings: &Settings) -> Outcome<Self> {
        let in_use = peers.counters.wearer();
        let name = named(wearer.unwrap_or_else(|| in_use.as_ref().map_or(DEFAULT_WEARER, WearerName::as_str)))?;
        tracing::info!("calibration of wearer {name} begins");
        let stage = Stage::load(&peers.loader, &name, settings);
        Ok(Self { wearer: name, stage })
    }

    /// Whether the guide wants to see frames.
    pub(super) fn is_guided(&self) -> bool {
        matches!(self.stage, Stage::Guide(_))
    }

    /// Adopts changed settings, and a model with this hash if it was read again.
    pub(super) fn adopt(&mut self, model: Option<u32>, loader: &Loader, settings: &Settings) {
        match &self.stage {
            Stage::Load(_) => self.stage = Stage::load(loader, &self.wearer, settings),
            // A profile of takes that two models have read would fit neither.
            Stage::Guide(guiding) if model.is_some_and(|model| model != guiding.guide.calibration.model) => {
                self.stage = Stage::End(Reply::Refused(MODEL_CHANGED.to_owned()));
            }
            Stage::Guide(guiding) if settings.wearer.wears != guiding.guide.wears() => {
                self.stage = Stage::End(Reply::Refused(WEARS_CHANGED.to_owned()));
            }
            _ => {}
        }
    }

    /// Goes on. Returns what the client is told at the end.
    pub(super) fn step(
        &mut self,
        client: &mut Client,
        peers: &mut Peers,
        settings: &WearerSettings,
    ) -> io::Result<Option<Reply>> {
        let next = match &mut self.stage {
            Stage::Load(guide) => poll_outcome(guide)
                .map(|guide| guide.flatten().map(|guide| Stage::Guide(Box::new(Guiding::new(guide))))),
            Stage::Guide(guiding) => guiding.follow(client, &mut peers.observed)?.map(|outcome| {
                let keep = |calibration| Stage::keep(self.wearer.clone(), calibration, peers, settings);
                outcome.map(keep).map_err(Refusal::end)
            }),
            Stage::Keep(kept) => poll_outcome(kept).map(|kept| kept.flatten().map(Stage::End)),
            Stage::End(_) => None,
        };
        if let Some(next) = next {
            self.stage = next.unwrap_or_else(|why| Stage::End(Reply::Refused(why)));
        }
        let Stage::End(reply) = &self.stage else { return Ok(None) };
        if let Reply::Refused(why) = reply {
            tracing::warn!("calibration of wearer {}: {why}", self.wearer);
        }
        Ok(Some(reply.clone()))
    }

    /// Waits for the profile if it is being written. Returns what the client is told of it.
    pub(super) fn finish(self) -> Option<Reply> {
        let Stage::Keep(kept) = self.stage else { return None };
        kept.recv_timeout(DISK_PATIENCE).ok()?.ok()
    }

    pub(super) fn end(&self) {
        if let Stage::Load(_) | Stage::Guide(_) = self.stage {
            tracing::info!("calibration of wearer {} cancelled", self.wearer);
        }
    }
}

/// How far a calibration is.
enum Stage {
    /// The loader reads the model, and checks whether a profile would be lost.
    Load(Receiver<Result<Guide, String>>),
    Guide(Box<Guiding>),
    /// The loader writes the profile.
    Keep(Receiver<Result<Reply, String>>),
    /// The client is told this.
    End(Reply),
}

impl Stage {
    fn load(loader: &Loader, name: &WearerName, settings: &Settings) -> Self {
        let name = name.clone();
        let solver = settings.solver.clone();
        let store = Store::new(&settings.wearer.folder);
        let wears = settings.wearer.wears;
        Self::Load(loader.begin(move || {
            if let Some(why) = store.why_not_replace(&name, wears) {
                return Err(why);
            }
            let model = load_model(&solver).map_err(|error| error.to_string())?;
            Ok(Guide::new(model, wears))
        }))
    }

    fn keep(name: WearerName, calibration: Calibration, peers: &Peers, settings: &WearerSettings) -> Self {
        let in_use = InUse::of(peers);
        let store = Store::new(&settings.folder);
        Self::Keep(peers.loader.begin(move || {
            let profile = calibration.profile.clone();
            let kept = store.keep(&name, calibration).map_err(|error| error.to_string())?;
            in_use.set(profile, Some(name));
            Ok(Reply::Calibrated(kept))
        }))
    }
}

pub(super) struct Guiding {
    pub(super) guide: Guide,
    /// When the last observation came, or the guide was told that none comes.
    pub(super) observed_us: u64,
    /// What the client was told last, and when.
    pub(super) told: Option<(Progress, u64)>,
}

impl Guiding {
    fn new(guide: Guide) -> Self {
        Self { guide, observed_us: monotonic_us(), told: None }
    }

    /// Shows the guide what the hot loop has seen. Returns the guide's outcome.
    fn follow(
        &mut self,
        client: &mut Client,
        observed: &mut Observed<Observation>,
    ) -> io::Result<Option<Result<Calibration, Refusal>>> {
        loop {
            let next = observed.take();
            self.step(client, next.as_ref(), monotonic_us())?;
            let outcome = self.guide.outcome();
            if next.is_none() || outcome.is_some() {
                return Ok(outcome);
            }
        }
    }

    /// Passes an observation on, or reports that none came for too long, and sends the progress to the client.
    pub(super) fn step(
        &mut self,
        client: &mut Client,
        observation: Option<&Observation>,
        now_us: u64,
    ) -> io::Result<()> {
        let silent_s = now_us.saturating_sub(self.observed_us) as f32 / 1e6;
        match observation {
            Some(observation) => self.guide.update(observation),
            None if silent_s > self.guide.gap_s() => self.guide.update(&Observation::nothing(now_us)),
            None => return Ok(()),
        }
        self.observed_us = now_us;
        let progress = self.guide.progress();
        let is_known = self.told.as_ref().is_some_and(|(told, told_us)| {
            now_us.saturating_sub(*told_us) < PROGRESS_US && told.says_the_same(&progress)
        });
        if !is_known && !client.is_behind() {
            client.send(&Reply::Progress(progress.clone()))?;
            self.told = Some((progress, now_us));
        }
        Ok(())
    }
}
