//! Prints the progress of a long run on standard error.

use std::time::Instant;

/// Seconds between lines.
const PROGRESS_S: f64 = 5.0;

/// Number of pictures to make and already made.
pub struct Progress {
    started: Instant,
    said: Instant,
    wanted: usize,
    done: usize,
    /// Pictures among `done` that an earlier run made.
    resumed: usize,
}

impl Progress {
    /// Begins a run.
    pub fn new(wanted: usize) -> Self {
        let now = Instant::now();
        Self { started: now, said: now, wanted, done: 0, resumed: 0 }
    }

    /// Returns the number of pictures made in this run.
    pub fn made(&self) -> usize {
        self.done - self.resumed
    }

    /// Counts pictures and prints the progress at intervals.
    pub fn count(&mut self, pictures: usize, resumed: bool) {
        self.done += pictures;
        self.resumed += if resumed { pictures } else { 0 };
        if self.said.elapsed().as_secs_f64() > PROGRESS_S {
            self.said = Instant::now();
            eprintln!("{}", self.line());
        }
    }

    /// Returns a line with the pictures made, pictures per second, and the remaining time.
    pub fn line(&self) -> String {
        let rate = self.made() as f64 / self.started.elapsed().as_secs_f64();
        let left = self.wanted.saturating_sub(self.done) as f64 / rate.max(1e-9);
        let left =
            if rate > 0.0 { format!("{:.0} min left", left / 60.0) } else { "remaining time unknown".to_owned() };
        format!("{} of {} pictures, {rate:.1} a second, {left}", self.done, self.wanted)
    }
}
