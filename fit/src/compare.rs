//! `facewire-fit fit`: fits every kind of model to every blendshape and chooses one of them for each.
//!
//! A kind is chosen by its errors on seen subjects when fitted without them (cross-validation in folds of whole
//! subjects). The scores are on held-out subjects, which neither the fits nor the choice see. Features are selected
//! anew for every fold. The same data give the same results, except for times.

pub mod choice;
pub mod trial;

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use anyhow::{Result, ensure};
use clap::Args;
use facewire_face::{BLENDSHAPES, COEFFS};
use rayon::prelude::*;
use serde_json::json;

use self::choice::{Budget, Choice};
use self::trial::{Trial, Trials};
use crate::dataset::{self, Sample, held_out};
use crate::faces::Faces;
use crate::kinds::{self, Kind};
use crate::output::{self, Table};
use crate::paper::{Fitted, MODELS_TITLE, model_rows, with_papers};
use crate::shapes::{index_of, modelled};
use crate::train;

/// The budget of the whole solver: memory, and time for one face.
const ALL_BYTES: usize = 256 * 1024;
const ALL_NANOSECONDS: usize = 20_000;

const FOLDS: usize = 3;

#[derive(Debug, Args)]
pub struct FitArgs {
    /// Landmarks with true coefficients (npz archive with names.json beside it)
    dataset: PathBuf,
    #[command(flatten)]
    options: FitOptions,
    /// Memory budget for the model of one blendshape, in bytes. Formulas take as many features as it allows
    #[arg(long, default_value_t = ALL_BYTES / COEFFS)]
    bytes: usize,
    /// Time budget for the model of one blendshape on one face, on this machine
    #[arg(long, default_value_t = ALL_NANOSECONDS / COEFFS)]
    nanoseconds: usize,
    /// Hold out pictures instead of subjects; implied if the data are of one subject
    #[arg(long)]
    one_subject: bool,
    /// JSON file for all results
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Model file for the chosen formulas, which `facewire track --model FILE` runs. They are fitted with the neutral face
    /// known and not known, and only kinds that model files can hold are chosen
    #[arg(long, value_name = "FILE")]
    export: Option<PathBuf>,
}

#[derive(Debug, Clone, Args)]
pub struct FitOptions {
    /// Blendshapes by ARKit name, separated by commas [default: all]
    #[arg(long, value_delimiter = ',', value_parser = modelled)]
    pub blendshapes: Vec<usize>,
    /// Kinds of model, separated by commas [default: all]
    #[arg(long, value_delimiter = ',')]
    pub kinds: Vec<String>,
    /// Number of features that the models of all blendshapes together choose from [default: all]
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..))]
    pub features: Option<u16>,
    /// Number of folds for cross-validation
    #[arg(long, default_value_t = FOLDS)]
    pub folds: usize,
    /// Passes of the hidden layer over the training data
    #[arg(long, default_value_t = train::EPOCHS, value_parser = clap::value_parser!(u32).range(1..))]
    pub epochs: u32,
}

pub fn run(args: &FitArgs) -> Result<()> {
    args.json.iter().chain(&args.export).try_for_each(|path| output::check(path))?;
    let samples = dataset::load(&args.dataset)?;
    let split = Split::new(&samples, args.options.folds, args.one_subject)?;
    let known = args.choose(&samples, &split, true)?;
    let Some(path) = &args.export else {
        return output::write_json(args.json.as_deref(), &choice::json(&known, &split, &args.budget()));
    };
    let unknown = args.choose(&samples, &split, false)?;
    let file = choice::model_file(&known, &unknown, args.made_by(), split.described())?;
    output::write_model(path, &file)?;
    println!("model in memory: {} bytes", file.to_model()?.to_bytes().len());
    let [known, unknown] = [known, unknown].map(|choices| choice::json(&choices, &split, &args.budget()));
    output::write_json(args.json.as_deref(), &json!({ "neutral_known": known, "neutral_unknown": unknown }))
}

impl FitArgs {
    fn budget(&self) -> Budget {
        let (bytes, nanoseconds) = (self.bytes, self.nanoseconds as f64);
        Budget { bytes, nanoseconds, formulas_only: self.export.is_some() }
    }

    /// Returns the kinds to fit. An export without a list of kinds fits only those that model files can hold.
    pub fn kinds(&self) -> Result<Kinds> {
        let mut kinds = self.options.kinds()?;
        if self.export.is_some() && self.options.kinds.is_empty() {
            kinds.each.retain(|kind| kind.form.is_formula());
            kinds.hidden_layer = false;
        }
        kinds.each.iter_mut().for_each(|kind| *kind = kind.within(self.bytes));
        Ok(kinds)
    }

    fn choose(&self, samples: &[Sample], split: &Split, neutral_known: bool) -> Result<Vec<Choice>> {
        let faces = Faces::new(samples, neutral_known)?;
        let budget = self.budget();
        let tried = self.options.run_trials(samples, &faces, split, &self.kinds()?)?;
        let choose = |(blendshape, trials): (usize, Vec<Trial>)| Choice::new(BLENDSHAPES[blendshape], trials, &budget);
        let choices: Vec<Choice> = tried.into_iter().map(choose).collect();
        println!("neutral face {}", if neutral_known { "known" } else { "not known" });
        print!("{}", choice::text(&choices, split, &budget));
        let is_in_paper = |choice: &&Choice| split.one_subject && !model_rows(choice.blendshape).is_empty();
        for choice in choices.iter().filter(is_in_paper) {
            println!("\n{}; indented rows are the paper's ({MODELS_TITLE})", choice.blendshape);
            print!("{}", beside_the_paper(choice, &faces, split).text());
        }
        Ok(choices)
    }

    fn made_by(&self) -> String {
        let FitOptions { blendshapes, kinds, features, folds, .. } = &self.options;
        let blendshapes = blendshapes.iter().map(|shape| BLENDSHAPES[*shape].to_owned()).collect();
        let mut parts = vec![format!("facewire-fit fit {} --export", self.dataset.display())];
        let lists = [("blendshapes", &blendshapes), ("kinds", kinds)].into_iter().filter(|(_, list)| !list.is_empty());
        parts.extend(lists.map(|(name, list)| format!("--{name} {}", list.join(","))));
        parts.extend(features.map(|features| format!("--features {features}")));
        parts.push(format!("--folds {folds} --bytes {} --nanoseconds {}", self.bytes, self.nanoseconds));
        parts.extend(self.one_subject.then(|| "--one-subject".to_owned()));
        parts.join(" ")
    }
}

/// Fits kinds for a report and applies them to the held-out pictures of a split. Returns each model with its blendshape.
pub fn fitted(samples: &[Sample], faces: &Faces, options: &FitOptions, split: &Split) -> Result<Vec<(usize, Fitted)>> {
    let tried = options.run_trials(samples, faces, split, &options.kinds()?)?;
    let each = |(blendshape, trials): (usize, Vec<Trial>)| {
        let truth = faces.truth(blendshape, &split.held_out);
        trials.into_iter().map(|trial| (blendshape, as_fitted(&trial, &truth))).collect::<Vec<_>>()
    };
    Ok(tried.into_iter().flat_map(each).collect())
}

fn as_fitted(trial: &Trial, truth: &[f64]) -> Fitted {
    let costs = [trial.bytes as f64, trial.nanoseconds];
    Fitted::new(trial.name(), trial.predictions.clone(), truth, trial.weights, costs)
}

fn beside_the_paper(choice: &Choice, faces: &Faces, split: &Split) -> Table {
    let blendshape = index_of(choice.blendshape);
    let truth = faces.truth(blendshape, &split.held_out);
    let fitted: Vec<Fitted> = choice.trials.iter().map(|trial| as_fitted(trial, &truth)).collect();
    with_papers(&fitted.iter().collect::<Vec<_>>(), model_rows(choice.blendshape))
}

pub struct Kinds {
    each: Vec<Kind>,
    hidden_layer: bool,
}

impl FitOptions {
    pub fn to_kinds(kinds: Vec<String>) -> Self {
        Self { blendshapes: Vec::new(), kinds, features: None, folds: FOLDS, epochs: train::EPOCHS }
    }

    pub fn run_trials(
        &self,
        samples: &[Sample],
        faces: &Faces,
        split: &Split,
        kinds: &Kinds,
    ) -> Result<Vec<(usize, Vec<Trial>)>> {
        let trainings: Vec<Vec<usize>> = (0..split.folds).map(|fold| split.training(fold)).collect();
        let parts: Vec<&[usize]> = trainings.iter().chain([&split.held_out]).map(Vec::as_slice).collect();
        let blendshapes = faces.moving(&self.blendshapes, &parts)?;
        let runner = Trials::new(faces, split, self.features.map(usize::from));
        let widest = kinds.each.iter().map(|kind| kind.limits.features).max().unwrap_or(0);
        let done = AtomicUsize::new(0);
        let one = |blendshape: &usize| -> Result<(usize, Vec<_>)> {
            let ranks = runner.rank(*blendshape, widest);
            let trials = kinds.each.iter().map(|kind| runner.run_kind(kind, *blendshape, &ranks));
            let trials: Vec<_> = trials.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
            let done = 1 + done.fetch_add(1, Ordering::Relaxed);
            eprint!("\r{done} of {} blendshapes", blendshapes.len());
            Ok((*blendshape, trials))
        };
        let tried = blendshapes.par_iter().map(one).collect::<Result<Vec<_>>>()?;
        eprintln!();
        // Times are taken one after another while no fit loads the cores, because the choice depends on them.
        let timed = |(blendshape, tried): (usize, Vec<_>)| {
            Ok((blendshape, tried.into_iter().map(|tried| runner.timed(tried)).collect::<Result<_>>()?))
        };
        let mut tried = tried.into_iter().map(timed).collect::<Result<Vec<(_, Vec<_>)>>>()?;
        if kinds.hidden_layer && !split.one_subject {
            let layer = trial::hidden_layer_trials(samples, faces, split, self.epochs as usize)?;
            for (blendshape, trials) in &mut tried {
                trials.push(layer[*blendshape].clone());
            }
        }
        Ok(tried)
    }

    pub fn kinds(&self) -> Result<Kinds> {
        let mut each = kinds::ALL.to_vec();
        let known: Vec<&str> = each.iter().map(|kind| kind.name).chain([trial::HIDDEN_LAYER]).collect();
        for name in &self.kinds {
            ensure!(known.contains(&name.as_str()), "no kind of model {name}: the kinds are {}", known.join(", "));
        }
        let is_wanted = |name: &str| self.kinds.is_empty() || self.kinds.iter().any(|wanted| wanted == name);
        each.retain(|kind| is_wanted(kind.name));
        Ok(Kinds { each, hidden_layer: is_wanted(trial::HIDDEN_LAYER) })
    }
}

/// If all pictures are of one subject, one in this many pictures is held out.
const HOLD_OUT_EVERY: usize = 4;
const SEED: u64 = 1;

/// Indices of the pictures that the fit sees, that choose the kind, and on which it is scored.
pub struct Split {
    pub seen: Vec<usize>,
    pub held_out: Vec<usize>,
    pub folds: usize,
    pub one_subject: bool,
    /// The fold of every picture, without meaning for held-out pictures.
    fold: Vec<usize>,
    group: Vec<usize>,
}

impl Split {
    /// Splits by subject, or by picture if there is only one subject or if `one_subject` is set.
    pub fn new(samples: &[Sample], folds: usize, one_subject: bool) -> Result<Self> {
        let subjects: BTreeSet<usize> = samples.iter().map(|sample| sample.subject).collect();
        let split = if one_subject || subjects.len() == 1 {
            Self::by_picture(samples.len(), folds)
        } else {
            Self::by_subject(samples, folds)?
        };
        let filled = (0..folds).all(|fold| !split.validation(fold).is_empty());
        ensure!(folds > 1 && filled && !split.held_out.is_empty(), "too few subjects or pictures for {folds} folds");
        Ok(split)
    }

    fn by_subject(samples: &[Sample], folds: usize) -> Result<Self> {
        let held_out = held_out(samples)?;
        let seen: Vec<usize> = (0..samples.len()).filter(|row| !samples[*row].held_out()).collect();
        let subjects: BTreeSet<usize> = seen.iter().map(|row| samples[*row].subject).collect();
        let subjects: Vec<usize> = subjects.into_iter().collect();
        let fold = |sample: &Sample| subjects.partition_point(|subject| *subject < sample.subject) % folds.max(1);
        let group = samples.iter().map(|sample| sample.subject).collect();
        Ok(Self { seen, held_out, folds, one_subject: false, fold: samples.iter().map(fold).collect(), group })
    }

    fn by_picture(pictures: usize, folds: usize) -> Self {
        let mut order: Vec<usize> = (0..pictures).collect();
        fastrand::Rng::with_seed(SEED).shuffle(&mut order);
        let (held_out, seen) = (0..pictures).partition(|row| order[*row].is_multiple_of(HOLD_OUT_EVERY));
        let fold = order.iter().map(|index| index / HOLD_OUT_EVERY % folds.max(1)).collect();
        Self { seen, held_out, folds, one_subject: true, fold, group: (0..pictures).collect() }
    }

    pub fn training(&self, without: usize) -> Vec<usize> {
        self.seen.iter().copied().filter(|row| self.fold[*row] != without).collect()
    }

    pub fn described(&self) -> String {
        let of = if self.one_subject { "of the same subject" } else { "of other subjects" };
        let (seen, held_out) = (self.seen.len(), self.held_out.len());
        format!("{seen} pictures; r and mse are those of {held_out} pictures {of}")
    }

    pub fn validation(&self, fold: usize) -> Vec<usize> {
        self.seen.iter().copied().filter(|row| self.fold[*row] == fold).collect()
    }

    /// Returns the mean squared error on the seen pictures, and its standard error clustered by group.
    pub fn mean_error(&self, squared: &[f64]) -> [f64; 2] {
        let count = squared.len() as f64;
        let mean = squared.iter().sum::<f64>() / count;
        let mut sums = vec![0.0; self.group.iter().max().map_or(0, |last| last + 1)];
        self.seen.iter().zip(squared).for_each(|(row, error)| sums[self.group[*row]] += error - mean);
        [mean, sums.iter().map(|sum| sum * sum).sum::<f64>().sqrt() / count]
    }
}
