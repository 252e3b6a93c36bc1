//! The workbench: fits and judges the blendshape models. Runs on a desk, never on the board.
#![allow(clippy::indexing_slicing, reason = "a matrix tool on a desk: an index out of range is a bug to be seen")]

mod dataset;
mod evaluate;
mod ridge;
mod train;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
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
    /// Fit both maps of the model and write them, with their scores on held-out subjects
    Train {
        /// Landmarks with true coefficients (NumPy archive, names.json beside it)
        dataset: PathBuf,
        /// Where the model is written
        #[arg(long, default_value = "models/blendshapes.toml")]
        out: PathBuf,
    },
    /// Print correlation and error of every blendshape, by facewire's own solver
    Evaluate {
        /// Landmarks with true coefficients (NumPy archive, names.json beside it)
        dataset: PathBuf,
        /// A model to judge instead of the built-in one
        #[arg(long)]
        model: Option<PathBuf>,
        /// Judge on all subjects: for data that the model was not fitted on
        #[arg(long)]
        all_subjects: bool,
    },
}

fn main() -> Result<()> {
    match Cli::parse().command {
        Command::Train { dataset, out } => train(&dataset, &out),
        Command::Evaluate { dataset, model, all_subjects } => evaluate(&dataset, model.as_deref(), all_subjects),
    }
}

fn train(dataset: &Path, out: &Path) -> Result<()> {
    let samples = dataset::load(dataset)?;
    let made_by = format!("facewire-fit train {}", dataset.display());
    let file = train::train(&samples, made_by)?;
    std::fs::write(out, toml::to_string(&file)?).with_context(|| format!("cannot write {}", out.display()))?;
    report(&file.to_model()?, &samples, false)
}

fn evaluate(dataset: &Path, model: Option<&Path>, all_subjects: bool) -> Result<()> {
    let model = model.map_or_else(Model::embedded, Model::load)?;
    report(&model, &dataset::load(dataset)?, all_subjects)
}

fn report(model: &Model, samples: &[dataset::Sample], all_subjects: bool) -> Result<()> {
    let scores = |neutral_known| -> Result<_> {
        let faces = evaluate::Faces::new(samples, neutral_known)?;
        evaluate::scores_of(model, &faces, |row| all_subjects || faces.held_out(row))
    };
    print!("{}", evaluate::table(&scores(true)?, &scores(false)?));
    let [yaw, pitch, roll] = evaluate::pose_error_deg(samples)?;
    println!("head pose, mean error over all pictures: yaw {yaw:.2}, pitch {pitch:.2}, roll {roll:.2} degrees");
    println!("model in memory: {} bytes", model.size_bytes());
    Ok(())
}
