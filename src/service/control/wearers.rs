//! Lists, chooses and deletes the profiles of wearers.

use std::sync::Arc;

use facewire_face::Profile;
use facewire_packet::control::Reply;

use super::{Peers, Task, wait};
use crate::calibration::{Store, WearerName};
use crate::config::{Settings, WearerSettings};
use crate::pipeline::load_profile;
use crate::service::counters::Counters;
use crate::service::hot::HotChange;
use crate::service::reload::Mailbox;

pub(super) fn named(text: &str) -> Result<WearerName, String> {
    WearerName::new(text).ok_or_else(|| format!("no name of a wearer: give {}", WearerName::EXPECTED))
}

/// What it takes to put a profile in use, on any thread.
pub(super) struct InUse {
    hot: Arc<Mailbox<HotChange>>,
    counters: Arc<Counters>,
}

impl InUse {
    pub(super) fn of(peers: &Peers) -> Self {
        Self { hot: Arc::clone(&peers.hot), counters: Arc::clone(&peers.counters) }
    }

    pub(super) fn set(&self, profile: Profile, name: Option<WearerName>) {
        tracing::info!("wearer {}", name.as_ref().map_or("nobody", WearerName::as_str));
        self.hot.send(HotChange { profile: Some(profile), ..HotChange::default() });
        self.counters.set_wearer(name);
    }
}

pub(super) fn list(peers: &Peers, settings: &WearerSettings) -> Task {
    let in_use = peers.counters.wearer().map(|name| name.to_string());
    let store = Store::new(&settings.folder);
    wait::begin(&peers.loader, move || {
        Ok(Reply::Wearers { wearers: store.list()?, in_use, folder: store.folder().display().to_string() })
    })
}

pub(super) fn use_wearer(name: WearerName, peers: &Peers, settings: &Settings) -> Task {
    let in_use = InUse::of(peers);
    let solver = settings.solver.clone();
    let wearer = WearerSettings { name: name.to_string(), ..settings.wearer.clone() };
    wait::begin(&peers.loader, move || {
        let (profile, warning) = load_profile(&wearer, &solver)?;
        let holds = profile.fits(wearer.wears);
        in_use.set(profile, Some(name.clone()));
        let begin = if holds { "is in use" } else { "is chosen" };
        let warning = warning.map_or_else(String::new, |warning| format!("; {warning}"));
        Ok(Reply::Done(format!(
            "the profile of {name} {begin}; to use it after every start, set wearer.name = \"{name}\" in the settings{warning}"
        )))
    })
}

pub(super) fn use_nobody(peers: &Peers) -> Task {
    let in_use = InUse::of(peers);
    wait::begin(&peers.loader, move || {
        in_use.set(Profile::default(), None);
        Ok(Reply::Done("nobody's profile is in use, until the next start of the service".to_owned()))
    })
}

pub(super) fn delete(name: WearerName, peers: &Peers, settings: &WearerSettings) -> Task {
    let in_use = InUse::of(peers);
    let store = Store::new(&settings.folder);
    wait::begin(&peers.loader, move || {
        store.delete(&name)?;
        if in_use.counters.wearer().as_ref() == Some(&name) {
            in_use.set(Profile::default(), None);
        }
        Ok(Reply::Done(format!("the profile of {name} is deleted")))
    })
}
