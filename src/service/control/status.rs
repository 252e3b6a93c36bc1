//! What the service answers when it is asked how it is.

use std::sync::PoisonError;
use std::sync::atomic::Ordering::Relaxed;

use facewire_packet::control::Status;

use crate::config::Settings;
use crate::service::counters::Counters;
use crate::service::metrics;

/// The service runs by these settings, of which `config` names the file.
pub(super) fn status(counters: &Counters, settings: &Settings, config: Option<&str>) -> Status {
    let operator = &counters.traffic.operator;
    let is_released = operator.is_released.load(Relaxed);
    Status {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        metrics: metrics::page(counters),
        wearer: counters.wearer().map(|name| name.to_string()),
        config: config.map(str::to_owned),
        settings_refused: counters.settings_refused.lock().unwrap_or_else(PoisonError::into_inner).clone(),
        released: is_released,
        released_unix_s: is_released.then(|| counters.released_unix_s.load(Relaxed)),
        release_not_kept: counters
            .release_not_kept
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone()
            .filter(|_| is_released),
        driven: operator.is_driven.load(Relaxed),
        picture: settings.console.picture,
        links: counters.panels().iter().map(|panel| panel.status()).collect(),
    }
}
