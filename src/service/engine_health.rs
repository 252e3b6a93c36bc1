//! What to do about an engine whose inferences fail.

/// A single failure can be a moment without memory. After this many in a row, the networks are loaded again.
const FAILURES_BEFORE_REMEDY: u32 = 8;

/// The failures since the last good inference.
#[derive(Debug, Default)]
pub(super) struct EngineHealth {
    failures: u32,
    is_reloaded: bool,
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
        *self = Self::default();
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
        *self = Self { failures: 0, is_reloaded: true };
        Remedy::Reload
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_failures_reload_the_networks_and_eight_more_are_given_up() {
        let mut health = EngineHealth::default();
        let remedies: Vec<Remedy> = (0..16).map(|_| health.failed()).collect();
        let mut want = vec![Remedy::Wait; 16];
        (want[7], want[15]) = (Remedy::Reload, Remedy::GiveUp);
        assert_eq!(remedies, want);
    }

    #[test]
    fn a_good_inference_forgives_all_failures_before_it() {
        let mut health = EngineHealth::default();
        for _ in 0..5 {
            assert_ne!((0..15).map(|_| health.failed()).last(), Some(Remedy::GiveUp));
            health.ran();
        }
    }
}
