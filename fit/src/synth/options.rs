//! Options of `synth` and `film`, and the distributions of pictures that they define.

use std::{fmt::Write, path::PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use facewire::solve::BLENDSHAPES;

use super::{
    acting::Mix,
    expression::Coefficients,
    factors::{Factor, Without},
    recording::Recording,
    sample::{Distribution, TextureChoice, Variety},
    set::{JUDGE_EVERY, Set},
};
use crate::design::MODELLED;

/// Rig, textures and recordings to draw from.
#[derive(Debug, Clone, Args)]
pub struct Sources {
    /// Folder of the face rig
    #[arg(long, default_value = "../shared/rig")]
    pub rig: PathBuf,
    /// Recordings of ARKit coefficients (Live Link Face, CSV)
    #[arg(long, num_args = 1.., default_value = "../shared/curves/alex_rom_3.csv")]
    pub curves: Vec<PathBuf>,
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
    /// Frequencies of expressions: single shape, recorded frame, three to six shapes, face at rest
    #[arg(
        long,
        value_delimiter = ',',
        num_args = 1,
        default_value = "38,38,19,5",
        value_name = "ONE,RECORDED,COMBINED,REST"
    )]
    pub mix: Vec<f32>,
    /// Shapes to show alone, by ARKit name, separated by commas [default: all]
    #[arg(long, value_delimiter = ',')]
    pub shapes: Vec<String>,
    /// Turn every head by exactly these angles, to either side and up or down, instead of random angles
    #[arg(long, num_args = 2, value_names = ["YAW", "PITCH"])]
    pub turn_deg: Vec<f32>,
    /// Factors of variety to take away, separated by commas. Everything else stays as it was drawn
    #[arg(long, value_enum, value_delimiter = ',', value_name = "FACTORS")]
    pub without: Vec<Factor>,
    /// Take away the factors of light, camera and looks that the reference renderer of the rig does not have
    #[arg(long)]
    pub like_reference: bool,
}

impl Sources {
    /// Returns the set's frames of each recording.
    pub fn frames(&self, set: Set) -> Result<Vec<Vec<Coefficients>>> {
        let part = |path: &PathBuf| -> Result<Vec<Coefficients>> {
            let part = set.part(&Recording::load(path)?.frames).to_vec();
            ensure!(!part.is_empty(), "{} is too short to have frames for --set {}", path.display(), set.name());
            Ok(part)
        };
        self.curves.iter().map(part).collect()
    }

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
    pub fn distribution<'a>(&self, textures: TextureChoice, frames: &'a [Coefficients]) -> Result<Distribution<'a>> {
        let &[single, recorded, combined, rest] = self.mix.as_slice() else { bail!("--mix takes four numbers") };
        let valid = self.mix.iter().all(|share| *share >= 0.0) && self.mix.iter().sum::<f32>() > 0.0;
        ensure!(valid, "--mix takes numbers that are at least 0, and not all 0");
        Ok(Distribution {
            variety: Variety { textures, without: Without::new(&self.without, self.like_reference) },
            frames,
            mix: Mix { single, recorded, combined, rest },
            shapes: named(
                &BLENDSHAPES[..MODELLED].iter().map(|name| (*name).to_owned()).collect::<Vec<_>>(),
                &self.shapes,
            )?,
            turn_deg: <[f32; 2]>::try_from(self.turn_deg.as_slice()).ok(),
        })
    }

    /// Returns the settings that determine the pictures as text, for the provenance file.
    pub fn describe(&self, sources: &Sources, distribution: &Distribution) -> Result<String> {
        let (mut text, TextureChoice { skins, brows, eyes }) = (String::new(), &distribution.variety.textures);
        writeln!(text, "rig {}", sources.rig.display())?;
        writeln!(text, "skins {skins:?}, brows {brows:?}, eyes {eyes:?}")?;
        writeln!(text, "curves {:?}, {} frames, mix {:?}", sources.curves, distribution.frames.len(), self.mix)?;
        writeln!(text, "turn {:?}, shapes {:?}", distribution.turn_deg, self.shapes)?;
        writeln!(text, "without {:?}", distribution.variety.without.names())?;
        Ok(text)
    }
}

/// Parses the two numbers of `--size` to width and height.
pub fn picture_size(size: &[usize]) -> Result<[usize; 2]> {
    let &[width, height] = size else { bail!("--size specs two numbers") };
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
    fn the_judging_set_shares_no_texture_and_no_frame_with_the_training_set() {
        let sources = parsed(&[]).sources;
        let [train, judge] =
            [Set::Train, Set::Judge].map(|set| sources.textures(set, &rig([4, 9, 30])).expect("enough of each"));
        let kinds = [(train.skins, judge.skins), (train.brows, judge.brows), (train.eyes, judge.eyes)];
        for ((train, judge), count) in kinds.into_iter().zip([4, 9, 30]) {
            assert!(!train.is_empty() && !judge.is_empty() && train.iter().all(|number| !judge.contains(number)));
            assert_eq!(train.len() + judge.len(), count);
        }
        let frames: Vec<Coefficients> = (0_u16..1000).map(|frame| [f32::from(frame); COEFFS]).collect();
        assert!(Set::Train.part(&frames).iter().all(|frame| !Set::Judge.part(&frames).contains(frame)));
    }

    #[test]
    fn a_set_without_a_texture_or_a_frame_is_refused() {
        let sources = parsed(&[]).sources;
        for (counts, kind) in [([3, 4, 4], "skins"), ([4, 3, 4], "brows"), ([4, 4, 3], "eyes")] {
            let error = sources.textures(Set::Judge, &rig(counts)).err().expect("refused").to_string();
            assert!(error.contains(&format!("rig's 3 {kind}")) && error.contains("--set judge"), "{error}");
        }
        let named = parsed(&["--skins", "texture 1"]).sources;
        assert_eq!(named.textures(Set::Judge, &rig([3, 4, 4])).expect("named").skins, [1]);
        let folder = tempfile::tempdir().expect("a folder");
        let short = folder.path().join("short.csv");
        std::fs::write(&short, format!("{}\n{}\n", BLENDSHAPES.join(","), [".5"; COEFFS].join(","))).expect("written");
        let short = parsed(&["--curves", short.to_str().expect("a path")]).sources;
        assert!(short.frames(Set::Train).is_err_and(|error| error.to_string().contains("short.csv is too short")));
    }

    #[test]
    fn the_tongue_cannot_be_chosen_as_a_shape() {
        let distribution = |arguments: &[&str]| {
            let cli = parsed(arguments);
            cli.scenes
                .distribution(cli.sources.textures(Set::Train, &rig([4, 4, 4]))?, &[])
                .map(|distribution| distribution.shapes)
        };
        assert_eq!(distribution(&["--shapes", "eyeBlinkLeft"]).expect("known"), [0]);
        assert!(
            distribution(&["--shapes", "tongueOut"]).is_err_and(|error| error.to_string().contains("no tongueOut"))
        );
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
