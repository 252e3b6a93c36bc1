//! The handover of a device from a link that a reload has replaced to the new one.

use std::thread;
use std::time::{Duration, Instant};

use super::background::Shared;

/// How long a new link waits in silence for the link that it replaces to close the device.
pub const HANDOVER: Duration = Duration::from_secs(2);
/// Time between two attempts to claim the device during a handover.
const RETRY_PERIOD: Duration = Duration::from_millis(2);

/// The time after the start of a link in which the link that it replaces may still hold the device.
#[derive(Debug)]
pub struct Handover {
    end: Instant,
}

impl Handover {
    /// Begins now, because the link is new.
    pub fn begin() -> Self {
        Self { end: Instant::now() + HANDOVER }
    }

    /// Claims a device. While another link holds it, tries again until the handover ends. Returns `None` when told to
    /// stop.
    ///
    /// # Errors
    /// Returns the error of the last attempt.
    pub fn claim<T, E>(
        &self,
        shared: &Shared,
        is_held: impl Fn(&E) -> bool,
        mut attempt: impl FnMut() -> Result<T, E>,
    ) -> Result<Option<T>, E> {
        while !shared.stopping() {
            match attempt() {
                Ok(claim) => return Ok(Some(claim)),
                Err(error) if is_held(&error) && Instant::now() < self.end => thread::park_timeout(RETRY_PERIOD),
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_device_that_another_link_holds_is_waited_for_up_to_the_end_and_other_errors_are_told_at_once() {
        let (handover, over, shared) = (Handover::begin(), Handover { end: Instant::now() }, Shared::default());
        let mut attempts = 0;
        let claim = handover.claim(
            &shared,
            |held| *held,
            || {
                attempts += 1;
                if attempts < 3 { Err(true) } else { Ok(attempts) }
            },
        );
        assert_eq!(claim, Ok(Some(3)));
        let refused = |handover: &Handover, error: bool| {
            let mut attempts = 0;
            let claimed: Result<Option<()>, bool> = handover.claim(
                &shared,
                |held| *held,
                || {
                    attempts += 1;
                    Err(error)
                },
            );
            (claimed, attempts)
        };
        assert_eq!(refused(&handover, false), (Err(false), 1));
        assert_eq!(refused(&over, true), (Err(true), 1));
    }
}
