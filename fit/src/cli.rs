//! The command line.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::Result;
use clap::{Parser, Subcommand};

use crate::{compare, dataset, evaluate, judge, output, paper, report, segments, synth, train, tune, wearers};

#[derive(Parser)]
#[command(version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Fit the model, score it on held-out subjects, and write it. If all datasets have `features`, the model also reads them
    Train {
        /// Landmarks with true coefficients (npz archives with names.json beside them). Subjects with the same number count
        /// as one person if `synth` made both datasets with the same seed and `--set`, because these show the same people, or if it made
        /// neither. A dataset that is named twice counts twice
        #[arg(required = true)]
        datasets: Vec<PathBuf>,
        /// The model file to write
        #[arg(long, default_value = "models/blendshapes.toml")]
        out: PathBuf,
        /// Passes over the training data
        #[arg(long, default_value_t = train::EPOCHS, value_parser = clap::value_parser!(u32).range(1..))]
        epochs: u32,
        /// Keep the landmark part of this model file, and fit only the part that reads `features`, in a few minutes
        #[arg(long, value_name = "FILE")]
        keep: Option<PathBuf>,
    },
    /// Compare kinds of regression model on every blendshape, and choose one of them within a budget
    Fit(compare::FitArgs),
    /// Compare the curves in a CSV file of `facewire track` with true curves, or with those of another tracker
    Evaluate(evaluate::EvaluateArgs),
    /// Print how good a model is on people with true coefficients, by facewire's own solver, and how sure that is
    Judge(judge::JudgeArgs),
    /// Write the statistics of every blendshape and kind of model as one HTML page with charts
    Report(report::ReportArgs),
    /// Make every table and figure of the paper in its order, ours beside its figures, as one HTML page
    Paper(Box<paper::page::PaperArgs>),
    /// Rank the features of every blendshape by correlation, partial F and support vectors, as one HTML page
    Select(segments::SelectArgs),
    /// Render faces with known coefficients, find their landmarks, and write them as a dataset
    Synth(synth::run::Options),
    /// Compare the expressions that `synth` draws with recorded ones, as one HTML page
    Expressions(synth::describe::Options),
    /// Find the corrective terms of the model, or the best filters, from faces with true coefficients
    #[command(subcommand)]
    Tune(tune::Command),
    /// Print what knowing the wearer is worth, and whether blinks, winks, rest and a turned head look right, on clips of
    /// wearers
    Wearers(wearers::Options),
    /// Render a clip of one person with the truth of every frame
    Film(synth::film::Options),
}

/// Runs the command that the arguments of the program name.
pub fn main() -> ExitCode {
    match run(Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("facewire-fit: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(command: Command) -> Result<()> {
    match command {
        Command::Train { datasets, out, epochs, keep } => train(&datasets, &out, epochs, keep.as_deref()),
        Command::Fit(args) => compare::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Judge(args) => judge::run(&args),
        Command::Report(args) => report::run(&args),
        Command::Paper(args) => paper::page::run(&args),
        Command::Select(args) => segments::run(&args),
        Command::Synth(options) => synth::run::run(&options),
        Command::Expressions(options) => synth::describe::run(&options),
        Command::Tune(command) => tune::run(&command),
        Command::Wearers(options) => wearers::run(&options),
        Command::Film(options) => synth::film::run(&options),
    }
}

fn train(datasets: &[PathBuf], out: &Path, epochs: u32, keep: Option<&Path>) -> Result<()> {
    output::check(out)?;
    let samples = dataset::load_all(datasets)?;
    let how = keep.map_or_else(|| format!("--epochs {epochs}"), |path| format!("--keep {}", path.display()));
    let names = datasets.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(" ");
    let pictures: String = datasets.iter().map(|path| pictures_of(path)).collect();
    let made_by = format!("facewire-fit train {names} {how}{pictures}");
    let appearances = dataset::load_appearances(datasets, samples.len())?;
    let file = train::train(&samples, appearances.as_ref(), epochs as usize, keep, made_by)?;
    output::write_model(out, &file)?;
    let model = file.to_model()?;
    judge::judge_fitted(names, samples, appearances, &model)
}

fn pictures_of(dataset: &Path) -> String {
    let text = std::fs::read_to_string(dataset::provenance(dataset)).unwrap_or_default();
    text.lines().next().map(|line| format!("; pictures: {line}")).unwrap_or_default()
}
