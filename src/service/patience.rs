//! How long to wait before the next attempt at something better, such as a higher step. Each attempt that fails makes
//! the wait longer.

/// An attempt has failed if it is taken back within this multiple of the wait before it.
const PROOF: u64 = 6;
/// Factor by which a failed attempt multiplies the wait.
const GROWTH: u64 = 4;

/// The wait before the next attempt.
#[derive(Debug, Default)]
pub(super) struct Patience {
    wait_us: u64,
    /// When the last attempt was made, until it is taken back.
    attempted_us: Option<u64>,
}

impl Patience {
    /// The wait before the next attempt.
    pub(super) fn wait_us(&self) -> u64 {
        self.wait_us
    }

    /// Notes that an attempt has been made.
    pub(super) fn attempt(&mut self, now_us: u64) {
        self.attempted_us = Some(now_us);
    }

    /// Takes the last attempt back, if there was one. The wait grows if the attempt has failed, and becomes `least_us`
    /// again if it lasted. It is always from `least_us` to `longest_us`.
    pub(super) fn take_back(&mut self, now_us: u64, [least_us, longest_us]: [u64; 2]) {
        let growth = match self.attempted_us.take().map(|at_us| now_us.saturating_sub(at_us)) {
            Some(lasted_us) if lasted_us < PROOF * self.wait_us => GROWTH,
            Some(_) => 0,
            None => 1,
        };
        self.wait_us = (growth * self.wait_us).max(least_us).min(longest_us);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wait_grows_with_each_attempt_that_fails_and_is_the_least_one_after_an_attempt_that_lasts() {
        let mut patience = Patience::default();
        let mut now_us = 0;
        let mut wait_after = |lasted_us: Option<u64>| {
            if let Some(lasted_us) = lasted_us {
                patience.attempt(now_us);
                now_us += lasted_us;
            }
            patience.take_back(now_us, [10, 200]);
            patience.wait_us()
        };
        assert_eq!([None, None, Some(59), Some(1), Some(1), Some(1)].map(&mut wait_after), [10, 10, 40, 160, 200, 200]);
        assert_eq!([Some(1199), Some(1200)].map(&mut wait_after), [200, 10]);
    }
}
