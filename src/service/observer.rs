//! What the hot loop shows other threads, a calibration or a recording: the newest value, in a triple buffer, only while
//! somebody wants it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use triple_buffer::{Input, Output, triple_buffer};

/// The end through which the hot loop publishes.
pub(super) struct Observer<T: Send> {
    is_wanted: Arc<AtomicBool>,
    newest: Input<T>,
}

/// The end that reads the newest value.
pub(super) struct Observed<T: Send> {
    is_wanted: Arc<AtomicBool>,
    newest: Output<T>,
}

/// Returns both ends. Nothing is wanted yet.
pub(super) fn channel<T: Send + Clone>(nothing: &T) -> (Observer<T>, Observed<T>) {
    let (input, output) = triple_buffer(nothing);
    let is_wanted = Arc::<AtomicBool>::default();
    (Observer { is_wanted: Arc::clone(&is_wanted), newest: input }, Observed { is_wanted, newest: output })
}

impl<T: Send> Observer<T> {
    /// Publishes what `observe` returns, if somebody wants it. Neither allocates nor waits.
    pub(super) fn publish(&mut self, observe: impl FnOnce() -> T) {
        if self.is_wanted.load(Relaxed) {
            self.newest.write(observe());
        }
    }
}

#[cfg(test)]
impl<T: Send> Observer<T> {
    /// Publishes a value and waits until it is taken. Returns `false` if nobody wants it.
    pub(super) fn hand(&mut self, value: T) -> bool {
        self.newest.write(value);
        while !self.newest.consumed() && self.is_wanted.load(Relaxed) {
            std::thread::yield_now();
        }
        self.is_wanted.load(Relaxed)
    }
}

impl<T: Send> Observed<T> {
    /// Starts or stops asking for values. What was published before is discarded.
    pub(super) fn ask(&mut self, is_wanted: bool) {
        self.is_wanted.store(is_wanted, Relaxed);
        self.newest.update();
    }

    /// Returns a value that came since the last call.
    pub(super) fn take(&mut self) -> Option<&T> {
        self.newest.update().then(|| self.newest.peek_output_buffer())
    }
}
