//! What the hot loop and the sender show to a calibration, a recording or a watcher: a value for each frame or packet, in a
//! bounded ring, only on request.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// Most values that wait in a ring, of some 6 kB each. The reader comes every 10 ms, and a recording should lose no frame.
const WAITING: usize = 32;

#[derive(Debug, Default)]
struct Shared {
    is_wanted: AtomicBool,
    lost: AtomicU64,
}

pub(super) struct Observer<T> {
    shared: Arc<Shared>,
    ring: SyncSender<T>,
}

pub(super) struct Observed<T> {
    shared: Arc<Shared>,
    ring: Receiver<T>,
}

pub(super) fn channel<T>() -> (Observer<T>, Observed<T>) {
    let (sender, receiver) = sync_channel(WAITING);
    let shared = Arc::<Shared>::default();
    (Observer { shared: Arc::clone(&shared), ring: sender }, Observed { shared, ring: receiver })
}

impl<T> Observer<T> {
    /// Publishes what `observe` returns, if somebody wants it. Neither allocates nor waits: a value without room is lost.
    pub(super) fn publish(&mut self, observe: impl FnOnce() -> T) {
        if self.shared.is_wanted.load(Relaxed) && self.ring.try_send(observe()).is_err() {
            self.shared.lost.fetch_add(1, Relaxed);
        }
    }
}

impl<T> Observed<T> {
    /// Says whether values are wanted. When that changes, what was published before is discarded.
    pub(super) fn ask(&mut self, is_wanted: bool) {
        if self.shared.is_wanted.swap(is_wanted, Relaxed) != is_wanted {
            self.ring.try_iter().for_each(drop);
            self.shared.lost.store(0, Relaxed);
        }
    }

    pub(super) fn take(&mut self) -> Option<T> {
        self.ring.try_recv().ok()
    }

    /// Returns the newest value, and discards the others.
    pub(super) fn newest(&mut self) -> Option<T> {
        self.ring.try_iter().last()
    }

    pub(super) fn lost(&self) -> u64 {
        self.shared.lost.load(Relaxed)
    }
}
