//! How far a long run is, on standard error.

use std::time::Instant;

/// Seconds between lines.
const PROGRESS_S: f64 = 5.0;

/// Pictures wanted and done.
pub struct Progress {
    started: Instant,
    said: Instant,
    wanted: usize,
    done: usize,
    /// Of those done, the ones of an earlier run.
    resumed: usize,
}

impl Progress {
    /// Of a run that begins now.
    pub fn new(wanted: usize) -> Self {
        let now = Instant::now();
        Self { started: now, said: now, wanted, done: 0, resumed: 0 }
    }

    /// Pictures made in this run.
    pub fn made(&self) -> usize {
        self.done - self.resumed
    }

    /// Counts pictures, and says so from time to time.
    pub fn note(&mut self, pictures: usize, resumed: bool) {
        self.done += pictures;
        self.resumed += if resumed { pictures } else { 0 };
        if self.said.elapsed().as_secs_f64() > PROGRESS_S {
            self.said = Instant::now();
            eprintln!("{}", self.line());
        }
    }

    /// Pictures done, how many a second, and the time left.
    pub fn line(&self) -> String {
        let rate = self.made() as f64 / self.started.elapsed().as_secs_f64();
        let left = self.wanted.saturating_sub(self.done) as f64 / rate.max(1e-9);
        let left = if rate > 0.0 { format!("{:.0} min left", left / 60.0) } else { "time left not known".to_owned() };
        format!("{} of {} pictures, {rate:.1} a second, {left}", self.done, self.wanted)
    }
}
