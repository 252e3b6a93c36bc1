//! Parts of textures, recordings and people, so that what a model is judged on is nothing that it was fitted on.

use clap::ValueEnum;

use super::expression::Coefficients;

/// Every so many-th skin, brow and eye texture is for judging.
pub const JUDGE_EVERY: usize = 4;
/// Of each recording, the part before the first share is for training, that after the second for judging.
const TRAIN_UNTIL: f32 = 0.72;
const JUDGE_FROM: f32 = 0.75;

/// Which textures, curves and people: what one set has, the other has not.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Set {
    /// For fitting
    Train,
    /// For judging: nothing of it is in the training set
    Judge,
    /// Everything, on people of its own
    All,
}

impl Set {
    /// Whether texture `index` of its kind belongs to the set.
    pub fn has(self, index: usize) -> bool {
        let judge = index % JUDGE_EVERY == JUDGE_EVERY - 1;
        self == Self::All || judge == (self == Self::Judge)
    }

    /// As it is given on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Judge => "judge",
            Self::All => "all",
        }
    }

    /// The set's part of a recording.
    pub fn part(self, frames: &[Coefficients]) -> &[Coefficients] {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a length")]
        let at = |share: f32| (share * frames.len() as f32) as usize;
        match self {
            Self::Train => &frames[..at(TRAIN_UNTIL)],
            Self::Judge => &frames[at(JUDGE_FROM)..],
            Self::All => frames,
        }
    }

    /// People of different sets are different though the seed is the same.
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
    fn sets_have_people_of_their_own_with_the_same_seed() {
        assert_ne!(Set::Train.seed(1), Set::Judge.seed(1));
        assert_ne!(Set::Judge.seed(1), Set::All.seed(1));
    }
}
