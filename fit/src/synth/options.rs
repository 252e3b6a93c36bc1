//! Options of `synth` and `film`, and the distributions of pictures that they define.

use std::{fmt::Write, path::PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;

use super::{
    acting_options::{Curves, MixOptions, mix_text},
    composing::Moments,
    conditions::Condition,
    factors::{Factor, Without},
    sample::{Distribution, TextureChoice, Variety},
    set::{JUDGE_EVERY, Set},
};

/// Rig, textures and recordings to draw from.
#[derive(Debug, Clone, Args)]
pub struct Sources {
    /// Folder of the face rig
    #[arg(long, default_value = "../shared/rig")]
    pub rig: PathBuf,
    #[command(flatten)]
    pub curves: Curves,
    /// Skins, by file name without extension, separated by commas [default: those of the set]
    #[arg(long, value_delimiter = ',')]
    pub skins: Vec<String>,
    /// Brows, likewise
    #[arg(long, value_delimiter = ',')]
    pub brows: Vec<String>,
    /// Eyes, likewise
    #[arg(long, value_delimiter = ',')]
    pub eyes: Vec<String>,
}

/// Contents of the single pictures of `synth`.
#[derive(Debug, Clone, Args)]
pub struct SceneOptions {
    #[command(flatten)]
    pub mix: MixOptions,
    /// Turn every head by exactly these angles, to either side and up or down, instead of random angles
    #[arg(long, num_args = 2, value_names = ["YAW", "PITCH"])]
    pub turn_deg: Vec<f32>,
    /// Factors of variety to take away, separated by commas. Everything else stays as it was drawn
    #[arg(long, value_enum, value_delimiter = ',', value_name = "FACTORS")]
    pub without: Vec<Factor>,
    /// Take away the factors of light, camera and looks that the reference renderer of the rig does not have
    #[arg(long)]
    pub like_reference: bool,
    /// Take all pictures under one condition, and under no other. Without this option, some conditions occur rarely
    #[arg(long, value_enum, value_name = "NAME")]
    pub condition: Option<Condition>,
}

impl Sources {
    /// Returns the textures to draw from.
    pub fn textures(&self, set: Set, known: &[Vec<String>; 3]) -> Result<TextureChoice> {
        let [skins, brows, eyes] = known;
        Ok(TextureChoice {
            skins: chosen(set, "skins", skins, &self.skins)?,
            brows: chosen(set, "brows", brows, &self.brows)?,
            eyes: chosen(set, "eyes", eyes, &self.eyes)?,
        })
    }
}

impl SceneOptions {
    /// Returns the distribution of pictures that the options define.
    pub fn distribution(&self, set: Set, textures: TextureChoice, moments: Moments) -> Result<Distribution> {
        Ok(Distribution {
            variety: Variety {
                textures,
                without: Without::new(&self.without, self.like_reference),
                condition: self.condition,
            },
            expressions: self.mix.expressions(set, moments)?,
            turn_deg: <[f32; 2]>::try_from(self.turn_deg.as_slice()).ok(),
        })
    }

    /// Returns the settings that determine the pictures as text, for the provenance file.
    pub fn describe(&self, set: Set, sources: &Sources, distribution: &Distribution) -> Result<String> {
        let (mut text, TextureChoice { skins, brows, eyes }) = (String::new(), &distribution.variety.textures);
        writeln!(text, "rig {}", sources.rig.display())?;
        writeln!(text, "skins {skins:?}, brows {brows:?}, eyes {eyes:?}")?;
        let (frames, mix) = (distribution.expressions.frames().len(), mix_text(self.mix.mix(set)));
        writeln!(text, "curves {:?}, {frames} frames, mix {mix}", sources.curves.curves)?;
        writeln!(text, "turn {:?}, shapes {:?}", distribution.turn_deg, self.mix.shapes)?;
        writeln!(text, "without {:?}", distribution.variety.without.names())?;
        writeln!(text, "condition {:?}", self.condition)?;
        Ok(text)
    }
}

/// Parses the two numbers of `--size` to width and height.
pub fn picture_size(size: &[usize]) -> Result<[usize; 2]> {
    let &[width, height] = size else { bail!("--size takes two numbers") };
    ensure!(width.min(height) >= 128 && width.max(height) <= 2048, "--size takes numbers from 128 to 2048");
    Ok([width, height])
}

/// Returns the indices of the wanted textures, or of the set's if none are wanted. An empty selection is an error.
fn chosen(set: Set, kind: &str, known: &[String], wanted: &[String]) -> Result<Vec<usize>> {
    if !wanted.is_empty() {
        return named(known, wanted);
    }
    let chosen: Vec<usize> = (0..known.len()).filter(|index| set.has(*index)).collect();
    ensure!(
        !chosen.is_empty(),
        "none of the rig's {} {kind} belongs to --set {}, which has one in {JUDGE_EVERY}: add some, or use --{kind}",
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
            .with_context(|| format!("no {name}: the names are {}", known.join(", ")))
    };
    wanted.iter().map(find).collect()
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Cli {
        #[command(flatten)]
        sources: Sources,
        #[command(flatten)]
        scenes: SceneOptions,
    }

    fn parsed(arguments: &[&str]) -> Cli {
        Cli::parse_from([&["synth"], arguments].concat())
    }

    /// Returns the names of this many textures of each kind.
    fn rig(counts: [usize; 3]) -> [Vec<String>; 3] {
        counts.map(|count| (0..count).map(|number| format!("texture {number}")).collect())
    }

    #[test]
    fn the_judging_set_shares_no_texture_with_the_training_set() {
        let sources = parsed(&[]).sources;
        let [train, judge] =
            [Set::Train, Set::Judge].map(|set| sources.textures(set, &rig([4, 9, 30])).expect("enough of each"));
        let kinds = [(train.skins, judge.skins), (train.brows, judge.brows), (train.eyes, judge.eyes)];
        for ((train, judge), count) in kinds.into_iter().zip([4, 9, 30]) {
            assert!(!train.is_empty() && !judge.is_empty() && train.iter().all(|number| !judge.contains(number)));
            assert_eq!(train.len() + judge.len(), count);
        }
    }

    #[test]
    fn a_set_without_a_texture_is_refused() {
        let sources = parsed(&[]).sources;
        for (counts, kind) in [([3, 4, 4], "skins"), ([4, 3, 4], "brows"), ([4, 4, 3], "eyes")] {
            let error = sources.textures(Set::Judge, &rig(counts)).err().expect("refused").to_string();
            assert!(error.contains(&format!("rig's 3 {kind}")) && error.contains("--set judge"), "{error}");
        }
        let named = parsed(&["--skins", "texture 1"]).sources;
        assert_eq!(named.textures(Set::Judge, &rig([3, 4, 4])).expect("named").skins, [1]);
    }

    #[test]
    fn picture_sizes_are_limited_to_128_to_2048() {
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
