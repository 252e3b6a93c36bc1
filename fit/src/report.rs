//! `facewire-fit report`: statistics of every blendshape and kind of model, as one HTML page with charts.

pub mod diagnostics;
mod drawings;
mod page;
mod table;

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;

use crate::{
    compare::{self, FitOptions},
    dataset,
    fitted::{self, Fitted},
    html,
    judge::{Faces, command::load_model},
    output,
};

/// Arguments of `report`.
#[derive(Debug, Args)]
pub struct ReportArgs {
    /// Landmarks with true coefficients (npz archive with names.json beside it)
    dataset: PathBuf,
    /// The page to write
    #[arg(long, value_name = "FILE", default_value = "report.html")]
    out: PathBuf,
    /// A model to judge instead of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Judge on all subjects: only for data that the model was not fitted on
    #[arg(long)]
    all_subjects: bool,
    /// Kinds of model to fit and show beside the shipped model, by their names in `fit`, separated by commas
    #[arg(long, value_delimiter = ',', conflicts_with = "all_subjects")]
    kinds: Vec<String>,
}

/// The pictures on which all models are judged.
pub struct Judged<'a> {
    /// Faces with features relative to the subjects' neutral faces.
    pub known: &'a Faces<'a>,
    /// Faces with features that are not relative to a neutral face.
    pub unknown: &'a Faces<'a>,
    /// Indices of the pictures.
    pub rows: Vec<usize>,
    /// A description of the pictures.
    pub described: String,
}

/// Runs the command.
pub fn run(args: &ReportArgs) -> Result<()> {
    output::check(&args.out)?;
    let samples = dataset::load(&args.dataset)?;
    let (known, unknown) = (Faces::new(&samples, true)?, Faces::new(&samples, false)?);
    let rows = known.rows(args.all_subjects)?;
    let described = describe(&args.dataset, rows.len(), args.all_subjects);
    let judged = Judged { known: &known, unknown: &unknown, rows, described };
    let mut fitted = fitted::shipped(&load_model(args.model.as_deref())?, &known, &unknown, &judged.rows)?;
    if !args.kinds.is_empty() {
        fitted.extend(compare::fitted(&samples, &known, &FitOptions::to_kinds(args.kinds.clone()))?);
    }
    write(&args.out, &judged, &fitted)
}

/// Writes the page. Charts are drawn for the first kind of model in `fitted`.
fn write(path: &Path, judged: &Judged, fitted: &[Fitted]) -> Result<()> {
    html::write(path, &page::html(judged, fitted)?)
}

fn describe(dataset: &Path, pictures: usize, all_subjects: bool) -> String {
    let subjects = if all_subjects { "all subjects" } else { "subjects that the fit never saw" };
    let name = dataset.file_name().unwrap_or_default().to_string_lossy();
    format!("{pictures} rendered pictures of {subjects}, from {name}")
}
