//! How long to wait before what failed is tried again: a camera, a serial port, a host.

use std::time::Duration;

/// The longest wait.
pub const LONGEST: Duration = Duration::from_secs(1);
const FIRST: Duration = Duration::from_millis(100);

/// Attempts since the last success.
#[derive(Debug)]
pub struct BackOff {
    next: Duration,
}

impl Default for BackOff {
    fn default() -> Self {
        Self { next: FIRST }
    }
}

impl BackOff {
    /// How long to wait for the next attempt: twice as long as for the last, up to [`LONGEST`].
    pub fn wait(&mut self) -> Duration {
        let wait = self.next;
        self.next = (2 * wait).min(LONGEST);
        wait
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waits_double_from_100_ms_to_1_s() {
        let mut back_off = BackOff::default();
        let waits: Vec<u128> = (0..6).map(|_| back_off.wait().as_millis()).collect();
        assert_eq!(waits, [100, 200, 400, 800, 1000, 1000]);
    }
}
