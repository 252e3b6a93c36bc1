//! Options of `synth` and `film`, and the distributions of pictures that they define.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::{Args, ValueEnum};
use facewire_face::BLENDSHAPES;

use super::acting::{Expressions, Kind, Moments, Share};
use super::assets::TextureChoice;
use super::expression::Coefficients;
use super::sample::{Distribution, Variety};
use super::variety::{Condition, Factor, Without};
use crate::design::modelled;
use crate::output;
use crate::recording::CsvTable;

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
}

impl Sources {
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
            variety: Variety { textures, without, condition: self.condition },
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
             turn {:?}, shapes {shapes:?}\nwithout {:?}\ncondition {:?}\n",
            sources.rig.display(),
            sources.curves.curves,
            distribution.turn_deg,
            distribution.variety.without.names(),
            self.condition
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
const TRAIN_MIX: [Share; 9] = [
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
const JUDGE_MIX: [Share; 2] = [(Kind::Halves, 92.0), (Kind::Rest, 8.0)];

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

/// Reads a recording at 30 frames per second: a CSV file with a header of blendshape names, in any order and case.
fn recording(path: &Path) -> Result<Vec<Coefficients>> {
    let read = || {
        let frames = CsvTable::load(path)?.coefficients()?;
        ensure!(!frames.is_empty(), "there are no frames");
        Ok(frames.into_iter().map(|frame| frame.map(|value| (value as f32).clamp(0.0, 1.0))).collect())
    };
    read().with_context(|| format!("{} is not a recording of blendshapes", path.display()))
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, Parser};
    use facewire_face::COEFFS;

    use super::*;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        sources: Sources,
        #[command(flatten)]
        scenes: SceneOptions,
    }

    fn parsed(arguments: &[&str]) -> Cli {
        Cli::parse_from([&["synth"], arguments].concat())
    }

    fn rig(counts: [usize; 3]) -> [Vec<String>; 3] {
        counts.map(|count| (0..count).map(|number| format!("texture {number}")).collect())
    }

    #[test]
    fn the_judging_set_shares_no_texture_with_the_training_set_and_has_other_people() {
        let sources = parsed(&[]).sources;
        let [train, judge] =
            [Set::Train, Set::Judge].map(|set| sources.textures(set, &rig([4, 9, 30])).expect("enough of each"));
        for ((train, judge), count) in train.into_iter().zip(judge).zip([4, 9, 30]) {
            assert!(!train.is_empty() && !judge.is_empty() && train.iter().all(|number| !judge.contains(number)));
            assert_eq!(train.len() + judge.len(), count);
        }
        assert!(Set::Train.seed(1) != Set::Judge.seed(1) && Set::Judge.seed(1) != Set::All.seed(1));
    }

    #[test]
    fn a_set_without_a_texture_and_unknown_names_are_refused() {
        for (counts, kind) in [([3, 4, 4], "skins"), ([4, 3, 4], "brows"), ([4, 4, 3], "eyes")] {
            let error = parsed(&[]).sources.textures(Set::Judge, &rig(counts)).expect_err("refused").to_string();
            assert!(error.contains(&format!("rig's 3 {kind}")) && error.contains("--set judge"), "{error}");
        }
        let named = |name: &str| parsed(&["--skins", name]).sources.textures(Set::Judge, &rig([3, 4, 4]));
        assert_eq!(named("texture 1").expect("known")[0], [1]);
        assert!(named("other").expect_err("unknown").to_string().contains("texture 0, texture 1"));
        assert_eq!(picture_size(&[128, 2048]).expect("allowed"), [128, 2048]);
        assert!(picture_size(&[127, 400]).is_err() && picture_size(&[400, 2049]).is_err());
    }

    #[test]
    fn columns_of_a_recording_are_matched_by_name_and_what_is_not_a_number_is_refused_with_file_and_line() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("spec.csv");
        let mut names = BLENDSHAPES.map(|name| name[..1].to_uppercase() + &name[1..]);
        names.reverse();
        let values: Vec<String> = (0..COEFFS).map(|index| format!("{:.2}", index as f32 / 100.0)).collect();
        std::fs::write(&path, format!("Timecode,{}\n10:00,{}\n", names.join(","), values.join(","))).expect("written");
        let frames = recording(&path).expect("a recording");
        assert!((frames[0][0] - 0.51).abs() < 1e-6, "the first blendshape is in the last column");
        for wrong in ["NaN", "inf", "high"] {
            let (good, mut bad) = (["0.5"; COEFFS], ["0.5"; COEFFS]);
            bad[7] = wrong;
            std::fs::write(&path, [BLENDSHAPES, good, bad].map(|row| row.join(",")).join("\n")).expect("written");
            let error = format!("{:#}", recording(&path).expect_err("refused"));
            assert!(error.contains("spec.csv") && error.contains("line 3") && error.contains(wrong), "{error}");
        }
    }

    #[test]
    fn training_and_judging_share_no_recording_of_a_folder_and_named_recordings_are_all_used() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("README.md"), "no recording").expect("written");
        let path = folder.path().to_str().expect("a path");
        let recordings = |curves: &str, set: Set| parsed(&["--curves", curves]).sources.curves.recordings(set);
        let values = |curves: &str, set: Set| -> Vec<f32> {
            recordings(curves, set).expect("recordings").iter().map(|frames| frames[0][0]).collect()
        };
        for number in 0..5 {
            let text = format!("{}\n{}\n", BLENDSHAPES.join(","), vec![format!("0.{number}"); COEFFS].join(","));
            std::fs::write(folder.path().join(format!("take_{number}.csv")), text).expect("written");
            if number == 0 {
                let error = recordings(path, Set::Judge).expect_err("refused").to_string();
                assert!(error.contains("none of the 1 recordings") && error.contains("--set judge"), "{error}");
            }
        }
        assert_eq!(values(path, Set::Train), [0.0, 0.2, 0.3]);
        assert_eq!(values(path, Set::Judge), [0.1, 0.4]);
        assert_eq!(values(path, Set::All).len(), 5);
        assert_eq!(values(&format!("{path}/take_3.csv"), Set::Judge), [0.3]);
    }

    #[test]
    fn kinds_of_expressions_are_named_with_their_shares_and_the_help_shows_the_default_mixtures() {
        let given = parsed(&["--mix", "recorded=3,rest=0.5"]).scenes.mix;
        assert_eq!(given.mix(Set::Judge), [(Kind::Recorded, 3.0), (Kind::Rest, 0.5)]);
        assert_eq!(mix_text(given.mix(Set::Judge)), "recorded=3,rest=0.5");
        let wrong =
            [("5,3", "KIND=SHARE"), ("smile=1", "called smile"), ("rest=-1", "at least 0"), ("rest=NaN", "at least 0")];
        for (wrong, reason) in wrong {
            let error = Cli::try_parse_from(["synth", "--mix", wrong]).expect_err("refused").to_string();
            assert!(error.contains(reason), "{error}");
        }
        let none = parsed(&["--mix", "rest=0"]).scenes.mix.expressions(Set::Train, Moments::new(&[]));
        assert!(none.err().is_some_and(|error| error.to_string().contains("above 0")));
        let help = Cli::command().render_help().to_string().replace(['\n', ' '], "");
        assert!(help.contains(&mix_text(&TRAIN_MIX)) && help.contains(&mix_text(&JUDGE_MIX)), "{help}");
    }
}
