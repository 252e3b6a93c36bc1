//! Options that define expressions: recordings, and how often each kind of expression occurs.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::{Args, ValueEnum};
use facewire::solve::BLENDSHAPES;

use super::{
    acting::{Expressions, Kind, Share},
    composing::Moments,
    expression::Coefficients,
    recording::{self, Recording},
    set::{JUDGE_RECORDING_EVERY, Set},
};
use crate::design::MODELLED;

/// The kinds of expressions for fitting and for judging, unless `--mix` is given.
const TRAIN_MIX: [Share; 8] = [
    (Kind::Halves, 40.0),
    (Kind::Recorded, 6.0),
    (Kind::Composed, 12.0),
    (Kind::Speech, 4.0),
    (Kind::Grimace, 10.0),
    (Kind::Single, 9.0),
    (Kind::Combined, 4.0),
    (Kind::Rest, 15.0),
];
const JUDGE_MIX: [Share; 2] = [(Kind::Halves, 92.0), (Kind::Rest, 8.0)];

/// Recordings to draw from.
#[derive(Debug, Clone, Args)]
pub struct Curves {
    /// Folder with recordings of ARKit coefficients (Live Link Face, CSV), of which each set has some; or the files to use
    #[arg(long, num_args = 1.., value_name = "DIR_OR_FILES", default_value = "../shared/curves")]
    pub curves: Vec<PathBuf>,
}

/// Kinds of expressions and their frequencies.
#[derive(Debug, Clone, Args)]
pub struct MixOptions {
    /// Relative frequencies of the kinds of expressions, like recorded=3,rest=1; kinds that are not named do not
    /// occur [default: halves=40,recorded=6,composed=12,speech=4,grimace=10,single=9,combined=4,rest=15 for fitting,
    /// halves=92,rest=8 for judging]
    #[arg(long, value_delimiter = ',', num_args = 1, value_name = "KIND=SHARE,...", value_parser = share)]
    mix: Vec<Share>,
    /// Shapes to show alone, by ARKit name, separated by commas [default: all]
    #[arg(long, value_delimiter = ',')]
    pub shapes: Vec<String>,
}

impl Curves {
    /// Returns the recordings to draw from: those of the set in a folder, or all if they are named.
    pub fn recordings(&self, set: Set) -> Result<Vec<Vec<Coefficients>>> {
        let load = |path: &PathBuf| Ok(Recording::load(path)?.frames);
        let [folder] = self.curves.as_slice() else { return self.curves.iter().map(load).collect() };
        if !folder.is_dir() {
            return Ok(vec![load(folder)?]);
        }
        let paths = recording::in_folder(folder)?;
        let own = paths.iter().enumerate().filter(|(index, _)| set.has_recording(*index)).map(|(_, path)| path);
        let recordings = own.map(load).collect::<Result<Vec<_>>>()?;
        ensure!(
            !recordings.is_empty(),
            "none of the {} recordings in {} belongs to --set {}, which has one in {JUDGE_RECORDING_EVERY}: add some, or name files",
            paths.len(),
            folder.display(),
            set.name()
        );
        Ok(recordings)
    }

    /// Returns the recorded frames to draw from.
    pub fn moments(&self, set: Set) -> Result<Moments> {
        Ok(Moments::new(&self.recordings(set)?))
    }
}

impl MixOptions {
    /// Returns the sampler of expressions.
    pub fn expressions(&self, set: Set, moments: Moments) -> Result<Expressions> {
        Expressions::new(moments, self.mix(set), self.shapes()?).context("--mix needs a kind with a share above 0")
    }

    /// Returns the kinds of expressions with their frequencies.
    pub fn mix(&self, set: Set) -> &[Share] {
        match set {
            _ if !self.mix.is_empty() => &self.mix,
            Set::Judge => &JUDGE_MIX,
            Set::Train | Set::All => &TRAIN_MIX,
        }
    }

    fn shapes(&self) -> Result<Vec<usize>> {
        let find = |name: &String| BLENDSHAPES[..MODELLED].iter().position(|known| known == name);
        let known = || BLENDSHAPES[..MODELLED].join(", ");
        let named = |name| find(name).with_context(|| format!("no {name}: the names are {}", known()));
        self.shapes.iter().map(named).collect()
    }
}

/// Returns a mixture as `--mix` takes it.
pub fn mix_text(mix: &[Share]) -> String {
    mix.iter().map(|(kind, share)| format!("{}={share}", kind.name())).collect::<Vec<_>>().join(",")
}

/// Parses a kind of expression with its frequency.
fn share(text: &str) -> Result<Share, String> {
    let (name, number) = text.split_once('=').ok_or("write KIND=SHARE, for example rest=1")?;
    let kind = Kind::from_str(name, false).map_err(|_| format!("no kind of expression is called {name}"))?;
    let share = number.parse().ok().filter(|share: &f32| share.is_finite() && *share >= 0.0);
    share.map(|share| (kind, share)).ok_or_else(|| format!("{number} is not a number that is at least 0"))
}

#[cfg(test)]
#[allow(clippy::float_cmp, reason = "these numbers are exact")]
mod tests {
    use std::path::Path;

    use clap::{CommandFactory, Parser};
    use facewire::solve::COEFFS;

    use super::*;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        curves: Curves,
        #[command(flatten)]
        mix: MixOptions,
    }

    fn parsed(arguments: &[&str]) -> Cli {
        Cli::parse_from([&["synth"], arguments].concat())
    }

    /// Writes recordings of one frame, each with another value.
    fn write_recordings(folder: &Path, count: usize) {
        for number in 0..count {
            let values = vec![format!("0.{number}"); COEFFS].join(",");
            let text = format!("{}\n{values}\n", BLENDSHAPES.join(","));
            std::fs::write(folder.join(format!("take_{number}.csv")), text).expect("written");
        }
    }

    #[test]
    fn training_and_judging_share_no_recording_of_a_folder_and_named_recordings_are_all_used() {
        let folder = tempfile::tempdir().expect("a folder");
        write_recordings(folder.path(), 5);
        std::fs::write(folder.path().join("README.md"), "no recording").expect("written");
        let values = |curves: &str, set: Set| -> Vec<f32> {
            let recordings = parsed(&["--curves", curves]).curves.recordings(set).expect("recordings");
            recordings.iter().map(|frames| frames[0][0]).collect()
        };
        let path = folder.path().to_str().expect("a path");
        assert_eq!(values(path, Set::Train), [0.0, 0.2, 0.3]);
        assert_eq!(values(path, Set::Judge), [0.1, 0.4]);
        assert_eq!(values(path, Set::All).len(), 5);
        assert_eq!(values(&format!("{path}/take_3.csv"), Set::Judge), [0.3]);
    }

    #[test]
    fn a_set_without_a_recording_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        write_recordings(folder.path(), 1);
        let few = parsed(&["--curves", folder.path().to_str().expect("a path")]).curves;
        let error = few.recordings(Set::Judge).expect_err("refused").to_string();
        assert!(error.contains("none of the 1 recordings") && error.contains("--set judge"), "{error}");
    }

    #[test]
    fn kinds_of_expressions_are_named_with_their_shares() {
        let given = parsed(&["--mix", "recorded=3,rest=0.5"]).mix;
        assert_eq!(given.mix(Set::Judge), [(Kind::Recorded, 3.0), (Kind::Rest, 0.5)]);
        assert_eq!(mix_text(given.mix(Set::Judge)), "recorded=3,rest=0.5");
        for (wrong, reason) in [
            ("38,38,19,5", "KIND=SHARE"),
            ("smile=1", "called smile"),
            ("rest=-1", "at least 0"),
            ("rest=NaN", "at least 0"),
        ] {
            let error = Cli::try_parse_from(["synth", "--mix", wrong]).expect_err("refused").to_string();
            assert!(error.contains(reason), "{error}");
        }
        let none = parsed(&["--mix", "rest=0"]).mix.expressions(Set::Train, Moments::new(&[]));
        assert!(none.err().is_some_and(|error| error.to_string().contains("above 0")));
    }

    #[test]
    fn the_help_shows_the_default_mixtures() {
        let help = Cli::command().render_help().to_string().replace(['\n', ' '], "");
        assert!(help.contains(&mix_text(&TRAIN_MIX)) && help.contains(&mix_text(&JUDGE_MIX)), "{help}");
    }

    #[test]
    fn the_tongue_cannot_be_chosen_as_a_shape() {
        let shapes = |name: &str| parsed(&["--shapes", name]).mix.shapes();
        assert_eq!(shapes("eyeBlinkLeft").expect("known"), [0]);
        assert!(shapes("tongueOut").is_err_and(|error| error.to_string().contains("no tongueOut")));
    }
}
