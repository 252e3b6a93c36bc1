//! The times of pictures, as they come from Python.

use std::time::Duration;

use pyo3::PyResult;
use pyo3::exceptions::PyValueError;

/// A video has no such gap between all of its first pictures, but one whose times are in milliseconds does, up to 200 frames a
/// second.
const LONG_STEP: Duration = Duration::from_secs(5);
/// Times with so many long steps at the beginning are refused.
const LONG_STEPS: u32 = 5;

/// The times that a tracker was given since it was made or reset.
#[derive(Default)]
pub struct Times {
    last: Option<Last>,
    long_steps: u32,
    has_short_step: bool,
}

/// The time of the last picture.
#[derive(Clone, Copy)]
struct Last {
    time: Duration,
    is_given: bool,
}

impl Times {
    /// Returns the time of the next picture: the given one in seconds, or `now`.
    pub fn next(&mut self, time_s: Option<f64>, now: Duration) -> PyResult<Duration> {
        let time = match time_s {
            None => now,
            Some(time_s) => given(time_s)?,
        };
        if let Some(last) = self.last {
            self.check(last, time, time_s)?;
        }
        self.last = Some(Last { time, is_given: time_s.is_some() });
        Ok(time)
    }

    /// Takes times for seconds, however far apart they are.
    pub fn trust(&mut self) {
        self.has_short_step = true;
    }

    fn check(&mut self, last: Last, time: Duration, time_s: Option<f64>) -> PyResult<()> {
        if last.is_given != time_s.is_some() {
            return wrong("give time_s for every picture or for none; call reset() before a change".to_owned());
        }
        // Two threads that took turns may have read the clock in the other order.
        let Some(time_s) = time_s else { return Ok(()) };
        let Some(step) = time.checked_sub(last.time) else {
            return wrong(format!(
                "time_s went back from {} to {time_s}: give pictures in the order of their times, of a clock that is never set \
                 back (time.monotonic()), and call reset() before another video",
                last.time.as_secs_f64()
            ));
        };
        self.has_short_step |= step < LONG_STEP;
        self.long_steps = if self.has_short_step { 0 } else { self.long_steps + 1 };
        if self.long_steps < LONG_STEPS {
            return Ok(());
        }
        self.long_steps -= 1;
        // A short step after this one shows that the times were right.
        self.last = Some(Last { time, is_given: true });
        wrong(format!(
            "the first pictures are {} seconds apart: time_s seems to be in milliseconds; divide it by 1000, or make the \
             tracker with stills=True if the pictures are so far apart",
            step.as_secs_f64()
        ))
    }
}

fn given(time_s: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(time_s)
        .map_err(|_| PyValueError::new_err(format!("time_s is {time_s}; give seconds, not below 0")))
}

fn wrong<T>(message: String) -> PyResult<T> {
    Err(PyValueError::new_err(message))
}
