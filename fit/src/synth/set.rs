//! Disjoint sets of textures, recorded frames and people, so that a model is not judged on what it was fitted on.

use clap::ValueEnum;

use super::expression::Coefficients;

/// One in this many skin, brow and eye textures belongs to the judging set.
pub const JUDGE_EVERY: usize = 4;
/// Shares of each recording: the training set ends at the first, and the judging set begins at the second.
const TRAIN_UNTIL: f32 = 0.72;
const JUDGE_FROM: f32 = 0.75;

/// A set of textures, recorded frames and people. The training set and the judging set are disjoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Set {
    /// For fitting
    Train,
    /// For judging: shares nothing with the training set
    Judge,
    /// All textures and frames, but with people of its own
    All,
}

impl Set {
    /// Returns whether texture `index` of its kind belongs to the set.
    pub fn has(self, index: usize) -> bool {
        let judge = index % JUDGE_EVERY == JUDGE_EVERY - 1;
        self == Self::All || judge == (self == Self::Judge)
    }

    /// Returns the name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Judge => "judge",
            Self::All => "all",
        }
    }

    /// Returns the set's part of a recording.
    pub fn part(self, frames: &[Coefficients]) -> &[Coefficients] {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a length")]
        let at = |share: f32| (share * frames.len() as f32) as usize;
        match self {
            Self::Train => &frames[..at(TRAIN_UNTIL)],
            Self::Judge => &frames[at(JUDGE_FROM)..],
            Self::All => frames,
        }
    }

    /// Derives a seed so that different sets contain different people.
    pub fn seed(self, seed: u64) -> u64 {
        seed.wrapping_mul(3).wrapping_add(self as u64)
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these numbers are exact")]
mod tests {
    use facewire::solve::COEFFS;

    use super::*;

    #[test]
    fn training_and_judging_share_no_texture_and_no_frame() {
        assert!((0..13).all(|index| Set::Train.has(index) != Set::Judge.has(index)));
        assert_eq!((0..13).filter(|index| Set::Judge.has(*index)).count(), 3);
        let frames: Vec<Coefficients> = (0_u8..100).map(|index| [f32::from(index); COEFFS]).collect();
        let last = Set::Train.part(&frames).last().map_or(0.0, |frame| frame[0]);
        let first = Set::Judge.part(&frames).first().map_or(0.0, |frame| frame[0]);
        assert_eq!([last, first], [71.0, 75.0]);
    }

    #[test]
    fn sets_contain_different_people_for_the_same_seed() {
        assert_ne!(Set::Train.seed(1), Set::Judge.seed(1));
        assert_ne!(Set::Judge.seed(1), Set::All.seed(1));
    }
}
