//! Releases all servos, or has them follow the face again.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant, SystemTime};

use facewire_packet::control::Reply;

use super::wait::{Answer, poll_outcome};
use super::{Peers, Task};
use crate::clock::seconds_since_1970;
use crate::link::Panel;
use crate::service::kept::Kept;

/// How long a client waits for boards to acknowledge a release, and for the disk to keep it.
pub(in crate::service) const RELEASE_PATIENCE: Duration = Duration::from_millis(250);

/// The client waits until the sender has obeyed, all servo boards have acknowledged a release, and the disk has kept it, or until
/// the patience with them has ended.
pub(super) fn release(on: bool, peers: &Peers, kept: Kept) -> Task {
    let operator = Arc::clone(&peers.counters.traffic.operator);
    if !(on && operator.is_released.load(Relaxed)) {
        peers.counters.released_unix_s.store(seconds_since_1970(SystemTime::now()), Relaxed);
    }
    operator.is_released.store(on, Relaxed);
    peers.sender.unpark();
    let counters = Arc::clone(&peers.counters);
    let keeping = peers.keeper.begin(move || {
        let kept = kept.keep_released(on).map_err(|error| {
            let folder = kept.folder();
            let folder = folder.display();
            let trouble =
                format!("After a restart the service will not know whether servos are released: {folder}: {error}");
            tracing::warn!("{trouble}");
            trouble
        });
        *counters.release_not_kept.lock().unwrap_or_else(PoisonError::into_inner) = kept.clone().err();
        kept
    });
    if !on {
        let done = "servos follow the face again";
        tracing::info!("{done}, as an operator wants it");
        return Task::Wait(Box::new(move || {
            if operator.is_released.load(Relaxed) {
                return refused("an operator has released all servos meanwhile");
            }
            let has_arrived = !operator.released_at_links.load(Relaxed);
            has_arrived.then(|| (Reply::Done(done.to_owned()), Vec::new()))
        }));
    }
    tracing::info!("an operator releases all servos");
    let counters = Arc::clone(&peers.counters);
    let end = Instant::now() + peers.release_patience;
    let mut is_kept = None;
    Task::Wait(Box::new(move || {
        if !operator.is_released.load(Relaxed) {
            return refused("somebody has let servos move again meanwhile. Press STOP again");
        }
        let boards = counters.panels().into_iter().filter(|panel| panel.kind.moves_servos());
        let (reached, missed): (Vec<_>, Vec<_>) = boards.partition(|panel| panel.dials.has_released());
        let has_arrived = operator.released_at_links.load(Relaxed);
        is_kept = is_kept.take().or_else(|| poll_outcome(&keeping));
        let is_over = (has_arrived && missed.is_empty() && is_kept.is_some()) || Instant::now() >= end;
        is_over.then(|| (outcome(has_arrived, &reached, &missed, is_kept.as_ref()), Vec::new()))
    }))
}

fn refused(why: &str) -> Option<Answer> {
    Some((Reply::Refused(why.to_owned()), Vec::new()))
}

/// What the operator must know: which boards have not acknowledged the release, which ones cannot, and whether the release
/// outlives the service.
fn outcome(
    has_arrived: bool,
    reached: &[Arc<Panel>],
    missed: &[Arc<Panel>],
    is_kept: Option<&Result<Result<(), String>, String>>,
) -> Reply {
    if !has_arrived {
        tracing::warn!("servos are not released: the thread that sends is stuck");
        return Reply::Refused(
            "the service is stuck. Switch the supply of the servos off, and restart the service".to_owned(),
        );
    }
    let not_kept = match is_kept {
        Some(Ok(Ok(()))) => None,
        Some(Ok(Err(trouble)) | Err(trouble)) => Some(trouble.clone()),
        None => {
            Some("The disk has not kept this yet; if the service is restarted now, servos may move again".to_owned())
        }
    };
    if !missed.is_empty() {
        let named = missed.iter().map(|panel| match panel.trouble() {
            Some(trouble) => format!("{} ({trouble})", panel.name()),
            None => format!("{} (it does not answer)", panel.name()),
        });
        let named = named.collect::<Vec<_>>().join(", ");
        tracing::warn!("servos are not released: {named}");
        let mut told = format!(
            "not reached: {named}. Switch the supply of these servos off. They are released as soon as they are reached; the \
             others are stopped"
        );
        not_kept.iter().for_each(|trouble| told.extend([". ", trouble]));
        return Reply::Refused(told);
    }
    let is_silent = |panel: &&Arc<Panel>| !panel.kind.acknowledges();
    let (silent, sure): (Vec<_>, Vec<_>) = reached.iter().partition(is_silent);
    let mut done = Vec::new();
    if !sure.is_empty() || silent.is_empty() {
        done.push("servos get no pulses".to_owned());
    }
    done.extend(silent.iter().map(|panel| {
        let effect = panel.kind.at_stop().unwrap_or_default();
        format!("{}: {effect}; the board cannot confirm it", panel.name())
    }));
    done.extend(not_kept);
    Reply::Done(done.join(". "))
}
