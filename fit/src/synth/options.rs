//! Options of `synth` and `film`, and what they allow to be drawn.

use std::{fmt::Write, path::PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use facewire::solve::BLENDSHAPES;

use super::{
    acting::Mix,
    expression::Coefficients,
    recording::Recording,
    sample::{Choice, Wardrobe},
    set::{JUDGE_EVERY, Set},
};
use crate::design::MODELLED;

/// What people and real expressions are drawn from.
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
}

/// What the single pictures of `synth` show.
#[derive(Debug, Clone, Args)]
pub struct Scenes {
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

impl Sources {
    /// The set's part of each recording, one after another.
    pub fn frames(&self, set: Set) -> Result<Vec<Vec<Coefficients>>> {
        let part = |path: &PathBuf| -> Result<Vec<Coefficients>> {
            let part = set.part(&Recording::load(path)?.frames).to_vec();
            ensure!(!part.is_empty(), "{} is too short to have frames for --set {}", path.display(), set.name());
            Ok(part)
        };
        self.curves.iter().map(part).collect()
    }

    /// The textures that people may have.
    pub fn wardrobe(&self, set: Set, known: &[Vec<String>; 3]) -> Result<Wardrobe> {
        let [skins, brows, eyes] = known;
        Ok(Wardrobe {
            skins: chosen(set, "skins", skins, &self.skins)?,
            brows: chosen(set, "brows", brows, &self.brows)?,
            eyes: chosen(set, "eyes", eyes, &self.eyes)?,
        })
    }
}

impl Scenes {
    /// What may be drawn.
    pub fn choice<'a>(&self, wardrobe: Wardrobe, frames: &'a [Coefficients]) -> Result<Choice<'a>> {
        let &[single, recorded, combined, rest] = self.mix.as_slice() else { bail!("--mix takes four numbers") };
        let sound = self.mix.iter().all(|share| *share >= 0.0) && self.mix.iter().sum::<f32>() > 0.0;
        ensure!(sound, "--mix takes shares that are not negative and not all 0");
        Ok(Choice {
            wardrobe,
            frames,
            mix: Mix { single, recorded, combined, rest },
            shapes: named(
                &BLENDSHAPES[..MODELLED].iter().map(|name| (*name).to_owned()).collect::<Vec<_>>(),
                &self.shapes,
            )?,
            turn_deg: <[f32; 2]>::try_from(self.turn_deg.as_slice()).ok(),
        })
    }

    /// What decides the pictures, as text.
    pub fn describe(&self, sources: &Sources, choice: &Choice) -> Result<String> {
        let (mut text, Wardrobe { skins, brows, eyes }) = (String::new(), &choice.wardrobe);
        writeln!(text, "rig {}", sources.rig.display())?;
        writeln!(text, "skins {skins:?}, brows {brows:?}, eyes {eyes:?}")?;
        writeln!(text, "curves {:?}, {} frames, mix {:?}", sources.curves, choice.frames.len(), self.mix)?;
        writeln!(text, "turn {:?}, shapes {:?}", choice.turn_deg, self.shapes)?;
        Ok(text)
    }
}

/// Columns and rows of pictures, from the two numbers of `--size`.
pub fn picture_size(size: &[usize]) -> Result<[usize; 2]> {
    let &[width, height] = size else { bail!("--size takes two numbers") };
    ensure!(width.min(height) >= 128 && width.max(height) <= 2048, "--size takes 128 to 2048");
    Ok([width, height])
}

/// Numbers of the textures of a `kind` that are wanted, or else of the set's. Never none: another set's would be taken.
fn chosen(set: Set, kind: &str, known: &[String], wanted: &[String]) -> Result<Vec<usize>> {
    if !wanted.is_empty() {
        return named(known, wanted);
    }
    let chosen: Vec<usize> = (0..known.len()).filter(|index| set.has(*index)).collect();
    ensure!(
        !chosen.is_empty(),
        "of the rig's {} {kind} none is for --set {}, which has every {JUDGE_EVERY}th; add some, or name them with --{kind}",
        known.len(),
        set.name()
    );
    Ok(chosen)
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
    use clap::Parser;
    use facewire::solve::COEFFS;

    use super::*;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        sources: Sources,
        #[command(flatten)]
        scenes: Scenes,
    }

    fn parsed(arguments: &[&str]) -> Cli {
        Cli::parse_from([&["synth"], arguments].concat())
    }

    /// Names of so many textures of each kind.
    fn rig(counts: [usize; 3]) -> [Vec<String>; 3] {
        counts.map(|count| (0..count).map(|number| format!("texture {number}")).collect())
    }

    #[test]
    fn judging_has_no_skin_brow_eye_or_frame_of_training() {
        let sources = parsed(&[]).sources;
        let [train, judge] =
            [Set::Train, Set::Judge].map(|set| sources.wardrobe(set, &rig([4, 9, 30])).expect("enough of each"));
        let kinds = [(train.skins, judge.skins), (train.brows, judge.brows), (train.eyes, judge.eyes)];
        for ((train, judge), count) in kinds.into_iter().zip([4, 9, 30]) {
            assert!(!train.is_empty() && !judge.is_empty() && train.iter().all(|number| !judge.contains(number)));
            assert_eq!(train.len() + judge.len(), count);
        }
        let frames: Vec<Coefficients> = (0_u16..1000).map(|frame| [f32::from(frame); COEFFS]).collect();
        assert!(Set::Train.part(&frames).iter().all(|frame| !Set::Judge.part(&frames).contains(frame)));
    }

    #[test]
    fn set_without_a_texture_or_a_frame_is_refused() {
        let sources = parsed(&[]).sources;
        for (counts, kind) in [([3, 4, 4], "skins"), ([4, 3, 4], "brows"), ([4, 4, 3], "eyes")] {
            let error = sources.wardrobe(Set::Judge, &rig(counts)).err().expect("refused").to_string();
            assert!(error.contains(&format!("rig's 3 {kind}")) && error.contains("--set judge"), "{error}");
        }
        let named = parsed(&["--skins", "texture 1"]).sources;
        assert_eq!(named.wardrobe(Set::Judge, &rig([3, 4, 4])).expect("named").skins, [1]);
        let folder = tempfile::tempdir().expect("a folder");
        let short = folder.path().join("short.csv");
        std::fs::write(&short, format!("{}\n{}\n", BLENDSHAPES.join(","), [".5"; COEFFS].join(","))).expect("written");
        let short = parsed(&["--curves", short.to_str().expect("a path")]).sources;
        assert!(short.frames(Set::Train).is_err_and(|error| error.to_string().contains("short.csv is too short")));
    }

    #[test]
    fn tongue_cannot_be_asked_for() {
        let choice = |arguments: &[&str]| {
            let cli = parsed(arguments);
            cli.scenes.choice(cli.sources.wardrobe(Set::Train, &rig([4, 4, 4]))?, &[]).map(|choice| choice.shapes)
        };
        assert_eq!(choice(&["--shapes", "eyeBlinkLeft"]).expect("known"), [0]);
        assert!(choice(&["--shapes", "tongueOut"]).is_err_and(|error| error.to_string().contains("no tongueOut")));
    }

    #[test]
    fn pictures_are_neither_tiny_nor_huge() {
        assert_eq!(picture_size(&[128, 2048]).expect("allowed"), [128, 2048]);
        assert!(picture_size(&[127, 400]).is_err() && picture_size(&[400, 2049]).is_err());
    }

    #[test]
    fn unknown_names_are_refused_with_the_known_ones() {
        let known = ["a".to_owned(), "b".to_owned()];
        assert_eq!(chosen(Set::Judge, "skins", &known, &["b".to_owned()]).expect("known"), [1]);
        let error = chosen(Set::All, "skins", &known, &["c".to_owned()]).expect_err("unknown");
        assert!(error.to_string().contains("a, b"));
    }
}
