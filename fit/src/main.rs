//! The workbench: renders faces with known coefficients, and fits and judges the blendshape models. It runs on a
//! desktop computer, never on the board.
#![allow(clippy::indexing_slicing, reason = "an index out of range is a bug, and a panic shows where")]
#![allow(clippy::cast_possible_truncation, reason = "sums are accumulated in f64 and stored as f32")]

mod arrays;
mod basis;
mod clip;
mod compare;
mod curves;
mod dataset;
mod design;
mod drawing;
mod evaluate;
mod fitted;
mod heat;
mod html;
mod judge;
mod kinds;
mod mirror;
mod network;
mod output;
mod paper;
mod recording;
#[cfg(test)]
mod reference;
mod report;
mod segments;
mod select;
mod statistics;
mod synth;
mod timecode;
mod train;

use std::{
    path::{Path, PathBuf},
    process::ExitCode,
};

use anyhow::Result;
use clap::{Parser, Subcommand};
use facewire::solve::Model;

#[derive(Parser)]
#[command(version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Fit the model, score it on held-out subjects, and write it
    Train {
        /// Landmarks with true coefficients (npz archive with names.json beside it)
        dataset: PathBuf,
        /// The model file to write
        #[arg(long, default_value = "models/blendshapes.toml")]
        out: PathBuf,
        /// Passes over the training data
        #[arg(long, default_value_t = train::EPOCHS, value_parser = clap::value_parser!(u32).range(1..))]
        epochs: u32,
    },
    /// Compare kinds of regression model on every blendshape, and choose one of them within a budget
    Fit(compare::FitArgs),
    /// Compare the curves in a CSV file of `facewire track` with true curves, or with those of another tracker
    Evaluate(evaluate::EvaluateArgs),
    /// Print correlation and error of a model on a dataset, computed by facewire's own solver
    Judge {
        /// Landmarks with true coefficients (npz archive with names.json beside it)
        dataset: PathBuf,
        /// A model to judge instead of the built-in one
        #[arg(long)]
        model: Option<PathBuf>,
        /// Judge on all subjects: only for data that the model was not fitted on
        #[arg(long)]
        all_subjects: bool,
    },
    /// Write the statistics of every blendshape and kind of model as one HTML page with charts
    Report(report::ReportArgs),
    /// Rank the features of every blendshape by correlation, partial F and support vectors, as one HTML page
    Select(segments::SelectArgs),
    /// Print correlation with the truth, pose error and jitter on a clip, with and without its neutral face
    Clip {
        /// Landmarks of every frame: a .npy file of `facewire track --landmarks`, or an npz archive with `landmarks`
        landmarks: PathBuf,
        /// CSV file of the true curves, one row per frame
        #[arg(long)]
        truth: Option<PathBuf>,
        /// Number of frames at the start of the clip in which the face is at rest
        #[arg(long, default_value_t = 1)]
        neutral_frames: usize,
        /// A model to judge instead of the built-in one
        #[arg(long)]
        model: Option<PathBuf>,
    },
    /// Render faces with known coefficients, find their landmarks, and write them as a dataset
    Synth(synth::run::Options),
    /// Render a clip of one person with the truth of every frame
    Film(synth::film::Options),
}

fn main() -> ExitCode {
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
        Command::Train { dataset, out, epochs } => train(&dataset, &out, epochs),
        Command::Fit(args) => compare::run(&args),
        Command::Evaluate(args) => evaluate::run(&args),
        Command::Judge { dataset, model, all_subjects } => judge(&dataset, model.as_deref(), all_subjects),
        Command::Report(args) => report::run(&args),
        Command::Select(args) => segments::run(&args),
        Command::Clip { landmarks, truth, neutral_frames, model } => {
            clip(&landmarks, truth.as_deref(), neutral_frames, model.as_deref())
        }
        Command::Synth(options) => synth::run::run(&options),
        Command::Film(options) => synth::film::run(&options),
    }
}

fn train(dataset: &Path, out: &Path, epochs: u32) -> Result<()> {
    output::check(out)?;
    let samples = dataset::load(dataset)?;
    let pictures = std::fs::read_to_string(synth::run::provenance(dataset)).unwrap_or_default();
    let pictures = pictures.lines().next().map(|line| format!("; pictures: {line}")).unwrap_or_default();
    let made_by = format!("facewire-fit train {} --epochs {epochs}{pictures}", dataset.display());
    let file = train::train(&mirror::with_mirrored(&samples)?, &samples, epochs as usize, made_by)?;
    output::write(out, toml::to_string(&file)?)?;
    judge_on(&file.to_model()?, &samples, false)
}

fn judge(dataset: &Path, model: Option<&Path>, all_subjects: bool) -> Result<()> {
    judge_on(&load_model(model)?, &dataset::load(dataset)?, all_subjects)
}

fn judge_on(model: &Model, samples: &[dataset::Sample], all_subjects: bool) -> Result<()> {
    let [known, unknown] = [judge::Faces::new(samples, true)?, judge::Faces::new(samples, false)?];
    let rows = known.rows(all_subjects)?;
    let scores = |faces| judge::scores_of(model, faces, &rows);
    print!("{}", judge::table(&scores(&known)?, &scores(&unknown)?));
    let resting = judge::resting(samples, &rows);
    for (name, faces) in [("known", &known), ("not known", &unknown)] {
        if !resting.is_empty() {
            println!("neutral {name}: {}", judge::rest_line(model, faces, &resting)?);
        }
    }
    let [yaw, pitch, roll] = judge::pose_error_deg(samples)?;
    println!("head pose, mean error over all pictures: yaw {yaw:.2}, pitch {pitch:.2}, roll {roll:.2} degrees");
    println!("model in memory: {} bytes", model.size_bytes());
    Ok(())
}

fn load_model(path: Option<&Path>) -> Result<Model> {
    Ok(path.map_or_else(|| Ok(Model::embedded()), Model::load)?)
}

fn clip(landmarks: &Path, truth: Option<&Path>, neutral_frames: usize, model: Option<&Path>) -> Result<()> {
    let (model, frames) = (load_model(model)?, clip::load(landmarks)?);
    let known = clip::solve(&model, &frames, Some(0..neutral_frames))?;
    let unknown = clip::solve(&model, &frames, None)?;
    for (name, solved) in [("known", &known), ("not known", &unknown)] {
        let [raw, smoothed] = clip::jitters(solved);
        println!("neutral {name}: mean second difference raw {raw:.4}, smoothed {smoothed:.4}");
    }
    let [p50, p99] = clip::cost_us(&model, &frames)?;
    println!("solver, landmarks to smoothed coefficients and head pose: p50 {p50:.1}, p99 {p99:.1} microseconds");
    let Some(path) = truth else { return Ok(()) };
    let truth = curves::Truth::load(path)?;
    truth.fits(path, frames.len())?;
    print!("{}", curves::table(&truth, &known, &unknown)?);
    let [yaw, pitch, roll] = curves::pose_error_deg(&truth, &known);
    println!("head pose, mean error: yaw {yaw:.2}, pitch {pitch:.2}, roll {roll:.2} degrees");
    Ok(())
}
