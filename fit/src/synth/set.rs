//! Disjoint sets of textures, recordings and people, so that a model is not judged on what it was fitted on.

use clap::ValueEnum;

/// One in this many skin, brow and eye textures belongs to the judging set.
pub const JUDGE_EVERY: usize = 4;
/// One in this many recordings, beginning with the second, belongs to the judging set.
pub const JUDGE_RECORDING_EVERY: usize = 3;

/// A set of textures, recordings and people. The training set and the judging set are disjoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Set {
    /// For fitting
    Train,
    /// For judging: shares nothing with the training set
    Judge,
    /// All textures and recordings, but with people of its own
    All,
}

impl Set {
    /// Returns whether texture `index` of its kind belongs to the set.
    pub fn has(self, index: usize) -> bool {
        self.is_chosen(index % JUDGE_EVERY == JUDGE_EVERY - 1)
    }

    /// Returns whether recording `index` belongs to the set.
    pub fn has_recording(self, index: usize) -> bool {
        self.is_chosen(index % JUDGE_RECORDING_EVERY == 1)
    }

    fn is_chosen(self, for_judging: bool) -> bool {
        self == Self::All || for_judging == (self == Self::Judge)
    }

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Judge => "judge",
            Self::All => "all",
        }
    }

    /// Derives a seed so that different sets contain different people.
    pub fn seed(self, seed: u64) -> u64 {
        seed.wrapping_mul(3).wrapping_add(self as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn training_and_judging_share_no_texture_and_no_recording() {
        assert!((0..13).all(|index| Set::Train.has(index) != Set::Judge.has(index)));
        assert_eq!((0..13).filter(|index| Set::Judge.has(*index)).count(), 3);
        assert!((0..9).all(|index| Set::Train.has_recording(index) != Set::Judge.has_recording(index)));
        assert_eq!((0..5).filter(|index| Set::Judge.has_recording(*index)).collect::<Vec<_>>(), [1, 4]);
        assert!((0..9).all(|index| Set::All.has(index) && Set::All.has_recording(index)));
    }

    #[test]
    fn sets_contain_different_people_for_the_same_seed() {
        assert_ne!(Set::Train.seed(1), Set::Judge.seed(1));
        assert_ne!(Set::Judge.seed(1), Set::All.seed(1));
    }
}
