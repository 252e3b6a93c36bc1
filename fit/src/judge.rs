//! `facewire-fit judge`: how good a model is by facewire's own solver, and how sure that is.

pub mod figures;
pub mod gaze;
pub mod set;
pub mod tables;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use facewire_face::Model;

use self::figures::{Judged, Judgement, Rivals};
use self::set::Set;
use crate::dataset::{Appearances, Sample};
use crate::output;

const AFTER_HELP: &str = "\
Figures, of all pictures of all people together:
  r      Pearson's correlation of estimate and truth
  MSE    mean squared error
  bias   mean error, estimate minus truth
  gain   standard deviation of the estimates divided by that of the truth
  slope  slope of the straight line through the estimates over the truth: gain times r
A SET that is a folder holds clips: NAME.avi with its truth in NAME.csv, each of another person, as `film` makes them. They
are tracked by every stage of `facewire track`, with and without --neutral. Clips also have the jitter: the root mean square
of the steps from frame to frame, over the frames at which the truth has stayed within 0.01 for 6 frames.
The MSE is the sum of three parts. Bias: what subtracting each person's mean error would remove. Gain: what scaling each
person's estimates by the best factor would remove after that. Rest: the remainder.
A blendshape is at rest in the pictures in which its true coefficient is at most 0.02, and moves in the others.
`+-` and `a .. b` are 95 % confidence intervals by the bootstrap over people: whole people are drawn, with replacement.
Two models are compared on the same draws. A difference whose interval excludes 0 is marked `*`.

Examples:
  facewire-fit judge faces/judge/faces.npz --all-subjects
  facewire-fit judge faces/judge/faces.npz --all-subjects --model new.toml --against models/blendshapes.toml
  facewire-fit judge faces.npz clips/ --model new.toml --against old.toml --page new-against-old.html
  facewire-fit judge faces.npz clips/ --json figures.json --csv people.csv";

#[derive(Debug, Args)]
#[command(after_help = AFTER_HELP)]
pub struct JudgeArgs {
    /// Landmarks with true coefficients (npz archives with names.json beside them), or folders of clips
    #[arg(required = true, value_name = "SET")]
    sets: Vec<PathBuf>,
    /// A model to judge instead of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Judge the built-in formulas of the paper, those of `solver.method = "paper"`
    #[arg(long, conflicts_with = "model")]
    paper: bool,
    /// Another model to compare it with, on the same faces
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
    /// HTML page that compares both models
    #[arg(long, value_name = "FILE", requires = "against")]
    page: Option<PathBuf>,
    /// Judge on all subjects of datasets: only for data that the model was not fitted on
    #[arg(long)]
    all_subjects: bool,
    /// Number of frames at the start of each clip in which the face is at rest
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    neutral_frames: u32,
    /// Draws of people for the confidence intervals
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u64).range(40..=100_000))]
    resamples: u64,
    /// JSON file for all figures with their intervals
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// CSV file for the figures of every person and blendshape
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
}

pub fn run(args: &JudgeArgs) -> Result<()> {
    [&args.json, &args.csv, &args.page].into_iter().flatten().try_for_each(|path| output::check(path))?;
    let model = if args.paper { Model::embedded_formulas() } else { load_model(args.model.as_deref())? };
    let against = args.against.as_deref().map(Model::load).transpose()?;
    let models: Vec<&Model> = [&model].into_iter().chain(&against).collect();
    let mut judged = Vec::new();
    for path in &args.sets {
        let set = Set::load(path, args.all_subjects, args.neutral_frames)?;
        let one = judge(&set, &models, args.resamples)?;
        print!("{}", tables::text(&one)?);
        judged.push(one);
    }
    println!("model in memory: {} bytes", model.to_bytes().len());
    if let Some(path) = &args.page {
        let name = |path: &PathBuf| path.display().to_string();
        let names = [&args.model, &args.against].map(|path| path.as_ref().map_or_else(|| "built in".to_owned(), name));
        let (sections, body) = tables::page(&judged, &names)?;
        let contents = [("overview", "Overview"), ("guide", "How to read it")];
        output::write_page(path, "Two models on the same people", &contents, &sections, &body)?;
    }
    output::write_json(args.json.as_deref(), &tables::json(&judged))?;
    args.csv.as_deref().map_or(Ok(()), |path| output::write(path, tables::csv(&judged)))
}

pub fn judge_fitted(name: String, samples: Vec<Sample>, appearances: Option<Appearances>, model: &Model) -> Result<()> {
    let judged = judge(&Set::of(name, samples, appearances, false)?, &[model], 1000)?;
    print!("{}", tables::text(&judged)?);
    Ok(())
}

pub fn load_model(path: Option<&Path>) -> Result<Model> {
    Ok(path.map_or_else(|| Ok(Model::embedded()), Model::load)?)
}

fn judge(set: &Set, models: &[&Model], resamples: u64) -> Result<Judged> {
    let rivals = |neutral_known| -> Result<Rivals> {
        let people = set.people(models, neutral_known)?;
        let mut judgements = people.into_iter().map(|people| Judgement::new(people, resamples));
        let model = judgements.next().context("there is a model")?;
        Ok(Rivals { model, against: judgements.next() })
    };
    Ok(Judged { set: set.name.clone(), notes: set.notes()?, neutral: [rivals(true)?, rivals(false)?] })
}
