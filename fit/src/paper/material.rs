//! What the page of the paper is made from: rendered pictures and clips, and the curves that facewire finds in them.

use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use clap::Parser;
use facewire_face::{BLENDSHAPES, Model};

use super::page::PaperArgs;
use crate::judge::set::Clip;
use crate::output;
use crate::shapes::index_of;
use crate::statistics::{autocorrelation, mean};
use crate::synth::{film, run as synth, script::RATE};

/// Frames at the start of every clip in which the face is at rest.
pub const REST_FRAMES: usize = 10;

#[derive(Parser)]
struct Synth {
    #[command(flatten)]
    options: synth::Options,
}

#[derive(Parser)]
struct Film {
    #[command(flatten)]
    options: film::Options,
}

pub struct Material {
    /// Pictures of many people, and of one with one expression at a time.
    pub people: PathBuf,
    pub avatar: PathBuf,
    /// Folders of clips: people who follow recordings, and one whose coefficients follow a sine.
    pub clips: PathBuf,
    pub sines: PathBuf,
    /// The commands that rendered what was not given.
    pub commands: Vec<String>,
}

impl Material {
    /// Renders what is not given, or finds it from an earlier run of the same command.
    pub fn of(args: &PaperArgs) -> Result<Self> {
        let mut commands = Vec::new();
        let mut make = |given: &Option<PathBuf>, name: &str, file: &str, command: &str, options: String| {
            if let Some(path) = given {
                return Ok(path.clone());
            }
            let folder = args.made.join(name);
            let out = folder.join(file);
            let mut words = vec![command.to_owned(), out.display().to_string()];
            words.extend(options.split_whitespace().map(str::to_owned));
            words.extend(args.sources.arguments());
            commands.push(format!("facewire-fit {}", words.join(" ")));
            render(&folder, command, &words).with_context(|| format!("cannot make {name}"))?;
            Ok::<_, anyhow::Error>(out)
        };
        let [people, avatar, clips, sines] = args.scale();
        let people = make(&args.dataset, "people", "faces.npz", "synth", people)?;
        let avatar = make(&args.avatar, "avatar", "faces.npz", "synth", avatar)?;
        let clips = make(&args.clips, "clips", "", "film", clips)?;
        let sines = make(&args.sines, "sines", "", "film", sines)?;
        Ok(Self { people, avatar, clips, sines, commands })
    }
}

/// Runs a command that renders into a folder, unless it has run there before.
fn render(folder: &Path, command: &str, words: &[String]) -> Result<()> {
    let note = format!("{}\nsynth edition {}", words.join(" "), synth::EDITION);
    once(folder, &note, || match command {
        "film" => film::run(&Film::try_parse_from(words)?.options),
        _ => synth::run(&Synth::try_parse_from(words)?.options),
    })
}

/// Fills a folder by `make` and leaves a note there, unless the same note says that the folder is complete. If the note is
/// another one or says that a run is unfinished, the contents of the folder are removed first.
pub fn once(folder: &Path, note: &str, make: impl FnOnce() -> Result<()>) -> Result<()> {
    let file = folder.join("command.txt");
    if std::fs::read_to_string(&file).is_ok_and(|made| made == note) {
        eprintln!("{}: made before", folder.display());
        return Ok(());
    }
    eprintln!("{note}");
    if file.exists() {
        std::fs::remove_dir_all(folder).with_context(|| format!("cannot remove {}", folder.display()))?;
    }
    std::fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    let is_empty = folder.read_dir()?.next().is_none();
    ensure!(is_empty, "{} has files, but no command.txt: remove the folder, or name another one", folder.display());
    output::write(&file, format!("unfinished: {note}"))?;
    make()?;
    output::write(&file, note)
}

/// A coefficient in clips, one after the other: before the corrective terms, and the truth.
pub struct Signal {
    pub blendshape: &'static str,
    pub raw: Vec<f64>,
    pub truth: Vec<f64>,
    /// The frames of each clip, which begin at rest for so many frames.
    pub clips: Vec<Range<usize>>,
    pub rest_frames: usize,
}

impl Signal {
    /// Solves clips by a model, with the neutral face not known. A frame without a face repeats the frame before.
    pub fn of(blendshape: &'static str, clips: &[Clip], model: &Model) -> Self {
        let shape = index_of(blendshape);
        let mut signal =
            Self { blendshape, raw: Vec::new(), truth: Vec::new(), clips: Vec::new(), rest_frames: REST_FRAMES };
        for clip in clips {
            let first = signal.raw.len();
            let mut last = 0.0;
            for shown in clip.shown(model, None) {
                last = shown.solution.map_or(last, |solution| f64::from(solution.raw.0[shape]));
                signal.raw.push(last);
            }
            signal.truth.extend(clip.truth.coefficients.iter().map(|frame| frame[shape]));
            signal.clips.push(first..signal.raw.len());
        }
        signal
    }

    fn mean_where(&self, values: &[f64], wanted: impl Fn(f64) -> bool) -> f64 {
        mean(values.iter().zip(&self.truth).filter(|(_, truth)| wanted(**truth)).map(|own| *own.0))
    }

    /// The mean of `values` where the truth is above 0.9.
    pub fn shut(&self, values: &[f64]) -> f64 {
        self.mean_where(values, |truth| truth > crate::curves::SHUT)
    }

    /// The mean of `values` where the truth is below 0.1.
    pub fn open(&self, values: &[f64]) -> f64 {
        self.mean_where(values, |truth| truth < crate::curves::OPEN)
    }

    /// Autocorrelations from lag 0, averaged over the clips in which the values vary.
    pub fn autocorrelation(&self, values: &[f64], lags: usize) -> Vec<f64> {
        let of_clip = |clip: &Range<usize>| autocorrelation(&values[clip.clone()], lags);
        let varying: Vec<Vec<f64>> = self.clips.iter().map(of_clip).filter(|own| own[0] > 0.0).collect();
        (0..=lags).map(|lag| mean(varying.iter().map(|own| own[lag]))).collect()
    }

    /// The frames of six seconds of a clip, or as many as the shortest clip has, in which the truth moves most.
    pub fn lively(&self) -> Range<usize> {
        let shortest = self.clips.iter().map(ExactSizeIterator::len).min().unwrap_or(0);
        let length = (6 * RATE as usize).min(shortest);
        let motion = |first: usize| -> f64 {
            self.truth[first..first + length].windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum()
        };
        let starts = self.clips.iter().flat_map(|clip| (clip.start..=clip.end - length).step_by(15));
        let first = starts.max_by(|a, b| motion(*a).total_cmp(&motion(*b))).unwrap_or(0);
        first..first + length
    }

    /// The values of some frames over time in seconds.
    pub fn timed(&self, values: &[f64], frames: &Range<usize>) -> Vec<(f64, f64)> {
        let own = values[frames.clone()].iter().enumerate();
        own.map(|(frame, value)| (frame as f64 / f64::from(RATE), *value)).collect()
    }
}

/// The names of the blendshapes that a table of the paper has.
pub fn known(name: &str) -> &'static str {
    BLENDSHAPES[index_of(name)]
}
