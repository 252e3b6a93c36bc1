//! Keeps an impairment from coming and going with every look.

/// What one look says about an impairment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Verdict {
    /// It is present.
    Poor,
    /// It may be present or not: the value lies between the thresholds.
    Between,
    /// It is not present.
    Fine,
    /// There is nothing to judge, for example no face.
    Unknown,
}

impl Verdict {
    /// Judges a value that is poor below the first threshold, and fine from the second on.
    pub(super) fn of_great(value: f32, [poor, fine]: [f32; 2]) -> Self {
        if value < poor {
            Self::Poor
        } else if value < fine {
            Self::Between
        } else {
            Self::Fine
        }
    }

    /// Judges a value that is poor above the first threshold, and fine up to the second.
    pub(super) fn of_small(value: f32, thresholds: [f32; 2]) -> Self {
        Self::of_great(-value, thresholds.map(|threshold| -threshold))
    }

    /// The worse of two verdicts.
    pub(super) fn or(self, other: Self) -> Self {
        self.min(other)
    }
}

/// Longest time that one look stands for, microseconds. Looks at the clip come every 0.3 s, those at a slow camera and
/// at what it delivers every 1.5 s.
const MAX_STEP_US: u64 = 2_000_000;
/// An impairment that cannot be judged passes in this many times the time.
const UNKNOWN_TIMES: u64 = 4;

/// An impairment over time. It begins when looks have said so for the time `hold_us` more than they have denied it, and
/// ends likewise.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Steady {
    /// From 0 to `hold_us`.
    evidence_us: u64,
    last_us: Option<u64>,
    is_present: bool,
}

impl Steady {
    /// Adds a look at the time `now_us`, and returns whether the impairment is present.
    pub(super) fn update(&mut self, verdict: Verdict, now_us: u64, hold_us: u64) -> bool {
        let since_us = now_us.saturating_sub(self.last_us.replace(now_us).unwrap_or(now_us)).min(MAX_STEP_US);
        self.evidence_us = match verdict {
            Verdict::Poor => (self.evidence_us + since_us).min(hold_us),
            Verdict::Between => self.evidence_us,
            Verdict::Fine => self.evidence_us.saturating_sub(since_us),
            Verdict::Unknown => self.evidence_us.saturating_sub(since_us / UNKNOWN_TIMES),
        };
        if self.evidence_us == hold_us {
            self.is_present = true;
        } else if self.evidence_us == 0 {
            self.is_present = false;
        }
        self.is_present
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOLD_US: u64 = 3_000_000;
    /// Time between two looks.
    const STEP_US: u64 = 250_000;

    /// Returns after how many looks the impairment changed.
    fn changes(verdicts: impl IntoIterator<Item = Verdict>) -> Vec<usize> {
        let (mut steady, mut was_present, mut changes) = (Steady::default(), false, Vec::new());
        for (look, verdict) in verdicts.into_iter().enumerate() {
            let is_present = steady.update(verdict, 5_000_000 + look as u64 * STEP_US, HOLD_US);
            if is_present != was_present {
                changes.push(look);
            }
            was_present = is_present;
        }
        changes
    }

    fn looks(verdict: Verdict, count: usize) -> impl Iterator<Item = Verdict> {
        std::iter::repeat_n(verdict, count)
    }

    #[test]
    fn an_impairment_comes_after_three_seconds_and_goes_after_three() {
        let verdicts = looks(Verdict::Poor, 20).chain(looks(Verdict::Fine, 20));
        assert_eq!(changes(verdicts), [12, 31]);
    }

    #[test]
    fn looks_that_alternate_change_nothing() {
        let flicker = |count| (0..count).map(|look| if look % 2 == 0 { Verdict::Poor } else { Verdict::Fine });
        assert!(changes(flicker(200)).is_empty());
        assert_eq!(changes(looks(Verdict::Poor, 13).chain(flicker(200))), [12]);
        assert_eq!(changes(looks(Verdict::Poor, 13).chain(looks(Verdict::Between, 200))), [12]);
    }

    #[test]
    fn an_impairment_of_a_face_that_left_passes_within_12_s() {
        assert_eq!(changes(looks(Verdict::Poor, 13).chain(looks(Verdict::Unknown, 100))), [12, 60]);
    }

    #[test]
    fn a_pause_counts_as_two_seconds_at_most() {
        let mut steady = Steady::default();
        assert!(!steady.update(Verdict::Poor, 0, HOLD_US));
        assert!(!steady.update(Verdict::Poor, 86_400_000_000, HOLD_US));
    }
}
