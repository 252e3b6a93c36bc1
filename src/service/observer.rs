//! What the hot loop shows a calibration: the newest observation, in a triple buffer, only while a calibration runs.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use triple_buffer::{Input, Output, triple_buffer};

use crate::calibration::Observation;
use crate::capture::Frame;
use crate::pipeline::Pipeline;

/// The end of the hot loop.
pub(super) struct Observer {
    is_wanted: Arc<AtomicBool>,
    newest: Input<Observation>,
}

/// The end of the calibration.
pub(super) struct Observed {
    is_wanted: Arc<AtomicBool>,
    newest: Output<Observation>,
}

/// Returns both ends. Nothing is wanted yet.
pub(super) fn channel() -> (Observer, Observed) {
    let (input, output) = triple_buffer(&Observation::nothing(0));
    let is_wanted = Arc::<AtomicBool>::default();
    (Observer { is_wanted: Arc::clone(&is_wanted), newest: input }, Observed { is_wanted, newest: output })
}

impl Observer {
    /// Publishes what a processed frame shows, if a calibration runs. Neither allocates nor waits.
    pub(super) fn publish(&mut self, pipeline: &Pipeline, frame: &Frame, is_dark: bool) {
        if self.is_wanted.load(Relaxed) {
            self.newest.write(pipeline.observe(frame, is_dark));
        }
    }
}

#[cfg(test)]
impl Observer {
    /// Publishes an observation and waits until it is taken. Returns `false` if nobody wants it.
    pub(super) fn hand(&mut self, observation: Observation) -> bool {
        self.newest.write(observation);
        while !self.newest.consumed() && self.is_wanted.load(Relaxed) {
            std::thread::yield_now();
        }
        self.is_wanted.load(Relaxed)
    }
}

impl Observed {
    /// Starts or stops asking for observations. What was published before is discarded.
    pub(super) fn ask(&mut self, is_wanted: bool) {
        self.is_wanted.store(is_wanted, Relaxed);
        self.newest.update();
    }

    /// Returns an observation that came since the last call.
    pub(super) fn take(&mut self) -> Option<&Observation> {
        self.newest.update().then(|| self.newest.peek_output_buffer())
    }
}
