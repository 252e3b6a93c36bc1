//! What to do about an engine whose inferences fail.

/// A single failure can be a moment without memory. After this many in a row, the networks are loaded again.
const FAILURES_BEFORE_REMEDY: u32 = 8;
/// After so many good inferences, loading the networks again counts as having helped: 10 s at 30 frames a second.
const GOOD_RUNS_BEFORE_TRUST: u32 = 300;

/// The failures since the last good inference, and whether the networks were loaded again because of earlier ones.
#[derive(Debug, Default)]
pub(super) struct EngineHealth {
    failures: u32,
    is_reloaded: bool,
    good_runs: u32,
}

/// What to do about a failed inference.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Remedy {
    /// Nothing yet: the next frame may do better.
    Wait,
    /// Load the networks again.
    Reload,
    /// Loading them again did not help.
    GiveUp,
}

impl EngineHealth {
    /// Counts a good inference.
    pub(super) fn ran(&mut self) {
        self.failures = 0;
        self.good_runs = self.good_runs.saturating_add(1);
        self.is_reloaded &= self.good_runs < GOOD_RUNS_BEFORE_TRUST;
    }

    /// Counts a failed inference and returns what to do about it.
    pub(super) fn failed(&mut self) -> Remedy {
        self.failures += 1;
        if self.failures < FAILURES_BEFORE_REMEDY {
            return Remedy::Wait;
        }
        if self.is_reloaded {
            return Remedy::GiveUp;
        }
        *self = Self { failures: 0, is_reloaded: true, good_runs: 0 };
        Remedy::Reload
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_failures_in_a_row_reload_the_networks_and_eight_more_soon_after_are_given_up() {
        let mut health = EngineHealth::default();
        for _ in 0..100 {
            assert!((0..7).all(|_| health.failed() == Remedy::Wait));
            health.ran();
        }
        assert_eq!((0..8).map(|_| health.failed()).last(), Some(Remedy::Reload));
        for (good_runs, remedy) in [(0, Remedy::GiveUp), (299, Remedy::GiveUp), (300, Remedy::Reload)] {
            let mut health = EngineHealth { is_reloaded: true, ..EngineHealth::default() };
            (0..good_runs).for_each(|_| health.ran());
            assert!((0..7).all(|_| health.failed() == Remedy::Wait));
            assert_eq!(health.failed(), remedy, "{good_runs}");
        }
    }
}
