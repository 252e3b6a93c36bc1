//! Options of `synth` and `film`, and the distributions of pictures that they define.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, ValueEnum};
use facewire_face::BLENDSHAPES;

use super::acting::{Expressions, Kind, Moments, Share};
use super::assets::TextureChoice;
use super::expression::Coefficients;
use super::sample::{Distribution, Variety};
use super::variety::{COVERED, Condition, Factor, Without};
use crate::output;
use crate::recording::CsvTable;
use crate::shapes::modelled;

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
    /// Share of pictures in which something covers a part of the face, unless a condition is chosen
    #[arg(long, value_name = "SHARE", default_value_t = COVERED, value_parser = share_of_one)]
    pub covered: f64,
}

impl Sources {
    /// Returns these options as the words of a command line.
    pub fn arguments(&self) -> Vec<String> {
        let path = |path: &PathBuf| path.display().to_string();
        let lists = [("--skins", &self.skins), ("--brows", &self.brows), ("--eyes", &self.eyes)];
        let lists = lists.into_iter().filter(|(_, list)| !list.is_empty());
        let textures = lists.flat_map(|(option, list)| [option.to_owned(), list.join(",")]);
        let curves = ["--curves".to_owned()].into_iter().chain(self.curves.curves.iter().map(path));
        ["--rig".to_owned(), path(&self.rig)].into_iter().chain(curves).chain(textures).collect()
    }

    /// Returns the indices of the skins, brows and eyes to draw from.
    pub fn textures(&self, set: Set, [skins, brows, eyes]: &[Vec<String>; 3]) -> Result<TextureChoice> {
        let skins = chosen(set, "skins", skins, &self.skins)?;
        Ok([skins, chosen(set, "brows", brows, &self.brows)?, chosen(set, "eyes", eyes, &self.eyes)?])
    }
}

impl SceneOptions {
    pub fn distribution(&self, set: Set, textures: TextureChoice, moments: Moments) -> Result<Distribution> {
        let without = Without::new(&self.without, self.like_reference);
        Ok(Distribution {
            variety: Variety { textures, without, condition: self.condition, covered: self.covered },
            expressions: self.mix.expressions(set, moments)?,
            turn_deg: <[f32; 2]>::try_from(self.turn_deg.as_slice()).ok(),
        })
    }

    /// Returns the settings that determine the pictures as text, for the provenance file.
    pub fn describe(&self, set: Set, sources: &Sources, distribution: &Distribution) -> String {
        let [skins, brows, eyes] = &distribution.variety.textures;
        let shapes: Vec<&str> = self.mix.shapes.iter().map(|shape| BLENDSHAPES[*shape]).collect();
        let (frames, mix) = (distribution.expressions.moments.frames.len(), mix_text(self.mix.mix(set)));
        format!(
            "rig {}\nskins {skins:?}, brows {brows:?}, eyes {eyes:?}\ncurves {:?}, {frames} frames, mix {mix}\n\
             turn {:?}, shapes {shapes:?}\nwithout {:?}\ncondition {:?}, covered {}\n",
            sources.rig.display(),
            sources.curves.curves,
            distribution.turn_deg,
            distribution.variety.without.names(),
            self.condition,
            self.covered
        )
    }
}

pub fn picture_size(size: &[usize]) -> Result<[usize; 2]> {
    let &[width, height] = size else { bail!("--size takes two numbers") };
    ensure!(width.min(height) >= 128 && width.max(height) <= 2048, "--size takes numbers from 128 to 2048");
    Ok([width, height])
}

/// Returns the indices of the wanted textures, or of the set's if none are wanted. An empty selection is an error.
fn chosen(set: Set, kind: &str, known: &[String], wanted: &[String]) -> Result<Vec<usize>> {
    if !wanted.is_empty() {
        let find = |name: &String| {
            let index = known.iter().position(|known| known == name);
            index.with_context(|| format!("no {name}: the names are {}", known.join(", ")))
        };
        return wanted.iter().map(find).collect();
    }
    let chosen: Vec<usize> = (0..known.len()).filter(|index| set.has(*index, [JUDGE_EVERY, JUDGE_EVERY - 1])).collect();
    ensure!(
        !chosen.is_empty(),
        "none of the rig's {} {kind} belongs to --set {}, which has one in {JUDGE_EVERY}: add some, or use --{kind}",
        known.len(),
        name_of(&set)
    );
    Ok(chosen)
}

/// One in this many skin, brow and eye textures belongs to the judging set.
const JUDGE_EVERY: usize = 4;
/// One in this many recordings, beginning with the second, belongs to the judging set.
const JUDGE_RECORDING_EVERY: usize = 3;

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
    /// Returns whether every `step`th index, beginning with `first`, is for judging and this set is, too; or neither.
    fn has(self, index: usize, [step, first]: [usize; 2]) -> bool {
        self == Self::All || (index % step == first) == (self == Self::Judge)
    }

    pub fn seed(self, seed: u64) -> u64 {
        seed.wrapping_mul(3).wrapping_add(self as u64)
    }
}

/// The kinds of expressions for fitting and for judging, unless `--mix` is given.
pub const TRAIN_MIX: [Share; 9] = [
    (Kind::Halves, 40.0),
    (Kind::Recorded, 6.0),
    (Kind::Composed, 12.0),
    (Kind::Speech, 4.0),
    (Kind::Grimace, 10.0),
    (Kind::Single, 9.0),
    (Kind::Combined, 4.0),
    (Kind::Gaze, 12.0),
    (Kind::Rest, 15.0),
];
pub const JUDGE_MIX: [Share; 2] = [(Kind::Halves, 92.0), (Kind::Rest, 8.0)];

#[derive(Debug, Clone, Args)]
pub struct Curves {
    /// Folder with recordings of ARKit coefficients (Live Link Face, CSV), of which each set has some; or the files to use
    #[arg(long, num_args = 1.., value_name = "DIR_OR_FILES", default_value = "../shared/curves")]
    pub curves: Vec<PathBuf>,
}

#[derive(Debug, Clone, Args)]
pub struct MixOptions {
    /// Relative frequencies of the kinds of expressions, like recorded=3,rest=1; kinds that are not named do not
    /// occur [default: halves=40,recorded=6,composed=12,speech=4,grimace=10,single=9,combined=4,gaze=12,rest=15 for fitting,
    /// halves=92,rest=8 for judging]
    #[arg(long, value_delimiter = ',', num_args = 1, value_name = "KIND=SHARE,...", value_parser = share)]
    mix: Vec<Share>,
    /// Shapes to show alone, by ARKit name, separated by commas [default: all]
    #[arg(long, value_delimiter = ',', value_parser = modelled)]
    shapes: Vec<usize>,
}

impl Curves {
    /// Returns the recordings of the set in the order of their names.
    pub fn recordings(&self, set: Set) -> Result<Vec<Vec<Coefficients>>> {
        let folder = match self.curves.as_slice() {
            [folder] if folder.is_dir() => folder.display(),
            files => return files.iter().map(|path| recording(path)).collect(),
        };
        let paths = output::files(&self.curves[0], &["csv"])?;
        ensure!(!paths.is_empty(), "{folder} has no recordings (CSV)");
        let own = paths.iter().enumerate().filter(|(index, _)| set.has(*index, [JUDGE_RECORDING_EVERY, 1]));
        let recordings = own.map(|(_, path)| recording(path)).collect::<Result<Vec<_>>>()?;
        ensure!(
            !recordings.is_empty(),
            "none of the {} recordings in {folder} belongs to --set {}, which has one in {JUDGE_RECORDING_EVERY}: add \
             some, or name files",
            paths.len(),
            name_of(&set)
        );
        Ok(recordings)
    }

    pub fn moments(&self, set: Set) -> Result<Moments> {
        Ok(Moments::new(&self.recordings(set)?))
    }
}

impl MixOptions {
    pub fn expressions(&self, set: Set, moments: Moments) -> Result<Expressions> {
        Expressions::new(moments, self.mix(set), self.shapes.clone()).context("--mix needs a kind with a share above 0")
    }

    pub fn mix(&self, set: Set) -> &[Share] {
        match set {
            _ if !self.mix.is_empty() => &self.mix,
            Set::Judge => &JUDGE_MIX,
            Set::Train | Set::All => &TRAIN_MIX,
        }
    }
}

/// Returns the name of a value on the command line.
pub fn name_of(value: &impl ValueEnum) -> String {
    value.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

pub fn mix_text(mix: &[Share]) -> String {
    mix.iter().map(|(kind, share)| format!("{}={share}", name_of(kind))).collect::<Vec<_>>().join(",")
}

fn share(text: &str) -> Result<Share, String> {
    let (name, number) = text.split_once('=').ok_or("write KIND=SHARE, for example rest=1")?;
    let kind = Kind::from_str(name, false).map_err(|_| format!("no kind of expression is called {name}"))?;
    let share = number.parse().ok().filter(|share: &f32| share.is_finite() && *share >= 0.0);
    share.map(|share| (kind, share)).ok_or_else(|| format!("{number} is not a number that is at least 0"))
}

fn share_of_one(text: &str) -> Result<f64, String> {
    let share = text.parse().ok().filter(|share| (0.0..=1.0).contains(share));
    share.ok_or_else(|| format!("{text} is not a number from 0 to 1"))
}

/// Reads a recording at 30 frames per second: a CSV file with a header of blendshape names, in any order and case.
pub fn recording(path: &Path) -> Result<Vec<Coefficients>> {
    let read = || {
        let frames = CsvTable::load(path)?.coefficients()?;
        ensure!(!frames.is_empty(), "there are no frames");
        Ok(frames.into_iter().map(|frame| frame.map(|value| (value as f32).clamp(0.0, 1.0))).collect())
    };
    read().with_context(|| format!("{} is not a recording of blendshapes", path.display()))
}
