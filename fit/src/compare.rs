//! `facewire-fit fit`: every kind of model on every blendshape, and which of them it gets.
//!
//! Kinds are chosen by the errors that they make on seen subjects when fitted without them (folds of whole subjects);
//! the scores are of held-out subjects, which neither the fits nor the choice have seen. Features are selected anew
//! for every fold. The same data give the same figures, but for times.

mod choice;
mod hidden_layer;
mod one_subject;
mod ranking;
mod split;
mod table;
mod trial;

use std::{
    path::PathBuf,
    sync::atomic::{AtomicUsize, Ordering},
};

use anyhow::{Context, Result, ensure};
use clap::Args;
use facewire::solve::{BLENDSHAPES, COEFFS};
use rayon::prelude::*;

use self::{
    choice::{Budget, Choice},
    split::Split,
    trial::{Bench, Trial, Tried},
};
use crate::{
    dataset::{self, Sample},
    design::MODELLED,
    fitted::Fitted,
    judge::Faces,
    kinds::{self, Kind},
    output, train,
};

/// Budget of the solver, over all blendshapes: memory, and time for one face.
const ALL_BYTES: usize = 256 * 1024;
const ALL_NANOSECONDS: usize = 20_000;

const FOLDS: usize = 3;

/// Arguments of `fit`.
#[derive(Debug, Args)]
pub struct FitArgs {
    /// Landmarks with true coefficients (npz archive, names beside it as JSON)
    dataset: PathBuf,
    #[command(flatten)]
    restrict: Restrict,
    /// Memory that the model of one blendshape may take, bytes
    #[arg(long, default_value_t = ALL_BYTES / COEFFS)]
    bytes: usize,
    /// Time that it may take for one face on this machine
    #[arg(long, default_value_t = ALL_NANOSECONDS / COEFFS)]
    nanoseconds: usize,
    /// Part pictures rather than subjects; done unasked where there is one subject only
    #[arg(long)]
    one_subject: bool,
    /// Write all figures
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// What is tried, and how.
#[derive(Debug, Clone, Args)]
pub struct Restrict {
    /// Blendshapes instead of all, by ARKit name, comma between
    #[arg(long, value_delimiter = ',')]
    pub blendshapes: Vec<String>,
    /// Kinds instead of all, comma between
    #[arg(long, value_delimiter = ',')]
    pub kinds: Vec<String>,
    /// Parts of the seen subjects, each of which is left out of a fit in its turn
    #[arg(long, default_value_t = FOLDS)]
    pub folds: usize,
    /// Looks of the hidden layer at every picture
    #[arg(long, default_value_t = train::EPOCHS, value_parser = clap::value_parser!(u32).range(1..))]
    pub epochs: u32,
}

/// Runs the command.
pub fn run(args: &FitArgs) -> Result<()> {
    args.json.iter().try_for_each(|path| output::check(path))?;
    let samples = dataset::load(&args.dataset)?;
    let faces = Faces::new(&samples, true)?;
    let split = Split::new(&samples, args.restrict.folds, args.one_subject)?;
    let budget = Budget { bytes: args.bytes, nanoseconds: args.nanoseconds as f64 };
    let tried = args.restrict.try_all(&samples, &faces, &split)?;
    let choose = |(blendshape, trials): (usize, Vec<Trial>)| Choice::new(BLENDSHAPES[blendshape], trials, &budget);
    let choices: Vec<Choice> = tried.into_iter().map(choose).collect();
    print!("{}", table::text(&choices, &split, &budget));
    if split.one_subject {
        print!("{}", one_subject::text(&choices, &faces, &split));
    }
    let Some(path) = &args.json else { return Ok(()) };
    let all = table::json(&choices, &split, &budget);
    output::write(path, serde_json::to_string_pretty(&all)?)
}

/// The kinds in `restrict`, as a report takes them: on the held-out subjects.
pub fn fitted(samples: &[Sample], faces: &Faces, restrict: &Restrict) -> Result<Vec<Fitted>> {
    let split = Split::new(samples, restrict.folds, false)?;
    ensure!(!split.one_subject, "a report of kinds takes several subjects");
    let tried = restrict.try_all(samples, faces, &split)?;
    let each = |(blendshape, trials): (usize, Vec<Trial>)| {
        trials.into_iter().map(move |trial| as_fitted(blendshape, trial)).collect::<Vec<_>>()
    };
    Ok(tried.into_iter().flat_map(each).collect())
}

fn as_fitted(blendshape: usize, trial: Trial) -> Fitted {
    Fitted {
        kind: trial.name(),
        blendshape,
        predictions: trial.predictions,
        degrees_of_freedom: trial.weights,
        bytes: trial.bytes,
        nanoseconds: trial.nanoseconds,
    }
}

impl Restrict {
    /// Some kinds on all blendshapes, otherwise as usual.
    pub fn to_kinds(kinds: Vec<String>) -> Self {
        Self { blendshapes: Vec::new(), kinds, folds: FOLDS, epochs: train::EPOCHS }
    }

    /// Tries the kinds on the blendshapes, which are named by their place.
    fn try_all(&self, samples: &[Sample], faces: &Faces, split: &Split) -> Result<Vec<(usize, Vec<Trial>)>> {
        let kinds = self.kinds()?;
        let trainings: Vec<Vec<usize>> = (0..split.folds).map(|fold| split.training(fold)).collect();
        let parts: Vec<&[usize]> = trainings.iter().chain([&split.held_out]).map(Vec::as_slice).collect();
        let blendshapes = faces.moving(&self.blendshapes()?, &parts)?;
        let bench = Bench::new(faces, split);
        let widest = kinds.iter().map(|kind| kind.limits().features).max().unwrap_or(0);
        let done = AtomicUsize::new(0);
        let one = |blendshape: &usize| -> Result<(usize, Vec<Tried>)> {
            let ranks = bench.rank(*blendshape, widest);
            let trials = kinds.iter().map(|kind| bench.try_kind(&**kind, *blendshape, &ranks));
            let trials = trials.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
            let done = 1 + done.fetch_add(1, Ordering::Relaxed);
            eprint!("\r{done} of {} blendshapes", blendshapes.len());
            Ok((*blendshape, trials))
        };
        let tried = blendshapes.par_iter().map(one).collect::<Result<Vec<_>>>()?;
        eprintln!();
        // One after another, when no fit loads the cores: the choice depends on the times.
        let timed = |tried: Vec<Tried>| tried.into_iter().map(|tried| bench.timed(tried)).collect();
        let mut tried: Vec<(usize, Vec<Trial>)> =
            tried.into_iter().map(|(place, tried)| (place, timed(tried))).collect();
        if self.has_hidden_layer() && !split.one_subject {
            let layer = hidden_layer::trials(samples, faces, split, self.epochs as usize)?;
            for (blendshape, trials) in &mut tried {
                trials.push(layer[*blendshape].clone());
            }
        }
        Ok(tried)
    }

    fn blendshapes(&self) -> Result<Vec<usize>> {
        let find = |name: &String| {
            let place = BLENDSHAPES.iter().take(MODELLED).position(|known| known == name);
            place.with_context(|| format!("no blendshape {name} that landmarks show"))
        };
        if self.blendshapes.is_empty() {
            Ok((0..MODELLED).collect())
        } else {
            self.blendshapes.iter().map(find).collect()
        }
    }

    fn has_hidden_layer(&self) -> bool {
        self.kinds.is_empty() || self.kinds.iter().any(|name| name == hidden_layer::NAME)
    }

    fn kinds(&self) -> Result<Vec<Box<dyn Kind>>> {
        let mut all = kinds::all();
        let known: Vec<&str> = all.iter().map(|kind| kind.name()).chain([hidden_layer::NAME]).collect();
        for name in &self.kinds {
            ensure!(known.contains(&name.as_str()), "no kind {name}; there are {}", known.join(", "));
        }
        all.retain(|kind| self.kinds.is_empty() || self.kinds.iter().any(|name| name == kind.name()));
        Ok(all)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;

    fn restrict(blendshapes: &[&str], kinds: &[&str]) -> Restrict {
        let owned = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect();
        Restrict { blendshapes: owned(blendshapes), ..Restrict::to_kinds(owned(kinds)) }
    }

    #[test]
    fn names_that_nothing_has_are_refused_with_the_known_ones() {
        let error = restrict(&[], &["ols", "lasso"]).kinds().err().unwrap().to_string();
        assert!(error.contains("lasso") && error.contains("ridge") && error.contains(hidden_layer::NAME), "{error}");
        assert!(restrict(&["tongueOut"], &[]).blendshapes().is_err());
    }

    #[test]
    fn jaw_of_unseen_subjects_is_found_by_an_affine_map_and_better_by_a_quadratic_one() {
        let Ok(samples) = dataset::load(&reference::folder().join("dataset/train.npz")) else {
            return reference::say_skipped("dataset/");
        };
        let faces = Faces::new(&samples, true).unwrap();
        let split = Split::new(&samples, 3, false).unwrap();
        let tried = restrict(&["jawOpen"], &["ols", "poly"]).try_all(&samples, &faces, &split).unwrap();
        let of = |kind: &str| tried[0].1.iter().find(|trial| trial.name() == kind).unwrap();
        assert!(of("ols").r > 0.93 && of("poly").mse < of("ols").mse, "{:?}", [of("ols").mse, of("poly").mse]);
        let [validation, error] = of("ols").validation;
        assert!((validation - of("ols").mse).abs() < 4.0 * error, "{validation} {error}");
    }
}
