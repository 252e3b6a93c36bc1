//! How new settings reach a running thread: the supervisor leaves them, the thread takes them when no frame waits.
//!
//! The thread looks at a flag; only when it is up does it try the lock, and never waits for it. What it leaves in
//! place of the new goes back to the supervisor.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A place for one change on its way to a thread.
#[derive(Debug)]
pub(super) struct Exchange<T> {
    waiting: AtomicBool,
    slot: Mutex<Option<T>>,
}

impl<T> Default for Exchange<T> {
    fn default() -> Self {
        Self { waiting: AtomicBool::new(false), slot: Mutex::new(None) }
    }
}

impl<T> Exchange<T> {
    /// Leaves a change for the thread. One that it did not take yet is lost.
    pub(super) fn offer(&self, change: T) {
        *self.lock() = Some(change);
        self.waiting.store(true, Ordering::Release);
    }

    /// Whether the thread has not taken the change yet.
    pub(super) fn is_waiting(&self) -> bool {
        self.waiting.load(Ordering::Acquire)
    }

    /// Lets the thread take what waits, by swapping it with what it had.
    pub(super) fn take(&self, swap: impl FnOnce(&mut T)) {
        if !self.is_waiting() {
            return;
        }
        let Ok(mut slot) = self.slot.try_lock() else { return };
        slot.as_mut().map(swap);
        self.waiting.store(false, Ordering::Release);
    }

    /// What the thread left, to be freed.
    pub(super) fn left(&self) -> Option<T> {
        self.lock().take()
    }

    fn lock(&self) -> MutexGuard<'_, Option<T>> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::mem::swap;

    use super::*;

    #[test]
    fn a_change_is_taken_once_and_the_old_stays_behind_to_be_freed() {
        let (exchange, mut mine) = (Exchange::default(), "old");
        exchange.take(|change| swap(change, &mut mine));
        assert_eq!(mine, "old", "nothing was offered");
        exchange.offer("new");
        assert!(exchange.is_waiting());
        exchange.take(|change| swap(change, &mut mine));
        exchange.take(|change| swap(change, &mut mine));
        assert_eq!((mine, exchange.is_waiting()), ("new", false));
        assert_eq!((exchange.left(), exchange.left()), (Some("old"), None));
    }

    #[test]
    fn a_thread_does_not_wait_for_a_supervisor_that_holds_the_lock() {
        let exchange = Exchange::default();
        exchange.offer(1);
        let held = exchange.lock();
        exchange.take(|_| unreachable!());
        drop(held);
        assert!(exchange.is_waiting(), "it is taken next time");
    }
}
