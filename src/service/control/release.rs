//! Releases all servos, or has them follow the face again.

use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use facewire_packet::control::Reply;

use super::{Peers, Task};
use crate::calibration::Store;
use crate::config::WearerSettings;

/// This file beside the profiles holds the boot identifier if an operator has released all servos since that boot.
const RELEASED: &str = "released";
const BOOT_ID: &str = "/proc/sys/kernel/random/boot_id";

/// Whether an operator has released all servos since the machine was started.
pub(in crate::service) fn was_released(wearer: &WearerSettings) -> bool {
    let released_in = fs::read(Store::new(&wearer.folder).folder().join(RELEASED));
    released_in.is_ok_and(|boot| fs::read(BOOT_ID).is_ok_and(|now| now == boot))
}

fn note_released(folder: &Path, on: bool) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(folder)?;
    fs::write(folder.join(RELEASED), if on { fs::read(BOOT_ID)? } else { Vec::new() })
}

/// The client waits until the sender has obeyed.
pub(super) fn release(on: bool, peers: &Peers, wearer: &WearerSettings) -> Task {
    let operator = Arc::clone(&peers.counters.traffic.operator);
    operator.is_released.store(on, Relaxed);
    peers.sender.unpark();
    let store = Store::new(&wearer.folder);
    peers.loader.begin(move || {
        if let Err(error) = note_released(store.folder(), on) {
            tracing::warn!("a restarted service will not know whether servos are released: {error}");
        }
    });
    let done = if on { "servos get no pulses" } else { "servos follow the face again" };
    tracing::info!("{done}, as an operator wants it");
    Task::Wait(Box::new(move || {
        let is_told = operator.told_released.load(Relaxed) == operator.is_released.load(Relaxed);
        is_told.then(|| (Reply::Done(done.to_owned()), Vec::new()))
    }))
}
