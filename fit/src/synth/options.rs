//! Options of `synth` and `film`, and what they allow to be drawn.

use std::{fmt::Write, path::PathBuf};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use facewire::solve::BLENDSHAPES;

use super::{acting::Mix, expression::Coefficients, kit::Kit, recording::Recording, sample::Choice};

/// Every so many-th skin, brow and eye texture is for judging.
const JUDGE_EVERY: usize = 4;
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

/// What people, expressions and rooms are drawn from.
#[derive(Debug, Clone, Args)]
pub struct Sources {
    /// Folder of the face rig
    #[arg(long, default_value = "../shared/rig")]
    pub rig: PathBuf,
    /// Recordings of ARKit coefficients (Live Link Face, CSV)
    #[arg(long, num_args = 1.., default_value = "../shared/curves/alex_rom_3.csv")]
    pub curves: Vec<PathBuf>,
    /// Skins to draw from instead of the set's, by file name without its ending, comma between
    #[arg(long, value_delimiter = ',')]
    pub skins: Vec<String>,
    /// Brows, likewise
    #[arg(long, value_delimiter = ',')]
    pub brows: Vec<String>,
    /// Eyes, likewise
    #[arg(long, value_delimiter = ',')]
    pub eyes: Vec<String>,
    /// Shares of expressions: one shape, recorded frames, three to six shapes, none
    #[arg(
        long,
        value_delimiter = ',',
        num_args = 1,
        default_value = "38,38,19,5",
        value_name = "ONE,RECORDED,COMBINED,REST"
    )]
    pub mix: Vec<f32>,
    /// Shapes that show alone instead of all, by ARKit name, comma between
    #[arg(long, value_delimiter = ',')]
    pub shapes: Vec<String>,
    /// Turn heads by just so many degrees to either side and up or down, in place of at random
    #[arg(long, num_args = 2, value_names = ["YAW", "PITCH"])]
    pub turn_deg: Vec<f32>,
}

impl Set {
    /// Whether texture `index` of its kind belongs to the set.
    fn has(self, index: usize) -> bool {
        let judge = index % JUDGE_EVERY == JUDGE_EVERY - 1;
        self == Self::All || judge == (self == Self::Judge)
    }

    /// The set's part of a recording.
    fn part(self, frames: &[Coefficients]) -> &[Coefficients] {
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

impl Sources {
    /// The set's part of each recording, one after another.
    pub fn frames(&self, set: Set) -> Result<Vec<Vec<Coefficients>>> {
        self.curves.iter().map(|path| Ok(set.part(&Recording::load(path)?.frames).to_vec())).collect()
    }

    /// What may be drawn.
    pub fn choice<'a>(&self, set: Set, kit: &Kit, frames: &'a [Coefficients]) -> Result<Choice<'a>> {
        let [skins, brows, eyes] = &kit.names;
        let &[single, recorded, combined, rest] = self.mix.as_slice() else { bail!("--mix takes four numbers") };
        let sound = self.mix.iter().all(|share| *share >= 0.0) && self.mix.iter().sum::<f32>() > 0.0;
        anyhow::ensure!(sound, "--mix takes shares that are not negative and not all 0");
        Ok(Choice {
            skins: chosen(set, skins, &self.skins)?,
            brows: chosen(set, brows, &self.brows)?,
            eyes: chosen(set, eyes, &self.eyes)?,
            frames,
            mix: Mix { single, recorded, combined, rest },
            shapes: named(&BLENDSHAPES.map(str::to_owned), &self.shapes)?,
            turn_deg: <[f32; 2]>::try_from(self.turn_deg.as_slice()).ok(),
        })
    }

    /// What decides the pictures, as text.
    pub fn describe(&self, choice: &Choice) -> Result<String> {
        let mut text = String::new();
        writeln!(text, "rig {}", self.rig.display())?;
        writeln!(text, "skins {:?}, brows {:?}, eyes {:?}", choice.skins, choice.brows, choice.eyes)?;
        writeln!(text, "curves {:?}, {} frames, mix {:?}", self.curves, choice.frames.len(), self.mix)?;
        writeln!(text, "turn {:?}, shapes {:?}", choice.turn_deg, self.shapes)?;
        Ok(text)
    }
}

fn chosen(set: Set, known: &[String], wanted: &[String]) -> Result<Vec<usize>> {
    if wanted.is_empty() {
        return Ok((0..known.len()).filter(|index| set.has(*index)).collect());
    }
    named(known, wanted)
}

fn named(known: &[String], wanted: &[String]) -> Result<Vec<usize>> {
    let find = |name: &String| {
        known
            .iter()
            .position(|known| known == name)
            .with_context(|| format!("no {name}; there are {}", known.join(", ")))
    };
    wanted.iter().map(find).collect()
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

    #[test]
    fn unknown_names_are_refused_with_the_known_ones() {
        let known = ["a".to_owned(), "b".to_owned()];
        assert_eq!(chosen(Set::Judge, &known, &["b".to_owned()]).expect("known"), [1]);
        let error = chosen(Set::All, &known, &["c".to_owned()]).expect_err("unknown");
        assert!(error.to_string().contains("a, b"));
    }
}
