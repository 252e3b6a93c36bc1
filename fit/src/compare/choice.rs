//! The choice of the kind of model for a blendshape.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use facewire_face::BLENDSHAPES;
use facewire_face::model::{Cases, FeatureId, FormulaSetTable, FormulaTable, ModelFile, Response};
use serde::Serialize;
use serde_json::{Value, json};

use super::Split;
use super::trial::{Scale, Trial};
use crate::kinds::{Form, Formula};
use crate::network;
use crate::output::{Table, number};
use crate::shapes::MODELLED;
use crate::statistics::mean;

#[derive(Debug, Clone, Copy, Serialize)]
pub struct Budget {
    pub bytes: usize,
    pub nanoseconds: f64,
    #[serde(skip)]
    pub formulas_only: bool,
}

impl Budget {
    fn allows(&self, trial: &Trial) -> bool {
        let runs = trial.form != Form::Large && (trial.formula.is_some() || !self.formulas_only);
        runs && trial.bytes <= self.bytes && trial.nanoseconds <= self.nanoseconds
    }
}

/// The trials of one blendshape. Choices are indices into `trials`.
#[derive(Debug, Clone, Serialize)]
pub struct Choice {
    pub blendshape: &'static str,
    pub trials: Vec<Trial>,
    /// The simplest trial within the budget whose validation error is within one standard error of the best trial's.
    pub chosen: Option<usize>,
    pub best_within_budget: Option<usize>,
}

impl Choice {
    pub fn new(blendshape: &'static str, trials: Vec<Trial>, budget: &Budget) -> Self {
        let least = |keep: &dyn Fn(&Trial) -> bool| {
            let kept = trials.iter().enumerate().filter(|(_, trial)| keep(trial));
            kept.min_by(|a, b| a.1.validation[0].total_cmp(&b.1.validation[0])).map(|(index, _)| index)
        };
        let best_within_budget = least(&|trial| budget.allows(trial));
        let chosen = best_within_budget.and_then(|best| {
            let most = trials[best].validation.iter().sum();
            let tied = |trial: &Trial| budget.allows(trial) && trial.validation[0] <= most;
            let simplest = trials.iter().filter(|trial| tied(trial)).map(simplicity).min()?;
            least(&|trial| tied(trial) && simplicity(trial) == simplest)
        });
        Self { blendshape, trials, chosen, best_within_budget }
    }

    pub fn at(&self, index: Option<usize>) -> Option<&Trial> {
        self.trials.get(index?)
    }
}

fn simplicity(trial: &Trial) -> (Form, Response) {
    (trial.form, trial.response)
}

pub fn text(choices: &[Choice], split: &Split, budget: &Budget) -> String {
    let parts = if split.one_subject { "pictures" } else { "whole subjects" };
    let (seen, folds, held_out) = (split.seen.len(), split.folds, split.held_out.len());
    let Budget { bytes, nanoseconds, .. } = budget;
    format!(
        "kinds chosen on {seen} pictures in {folds} folds of {parts}, scored on {held_out} held-out pictures\n\
         budget of one blendshape: {bytes} bytes, {nanoseconds:.0} nanoseconds; - means that no kind is within it\n\n\
         {}\n{}\n{}",
        by_blendshape(choices).text(),
        by_kind(choices).text(),
        summary(choices)
    )
}

fn by_blendshape(choices: &[Choice]) -> Table {
    let name = |trial: Option<&Trial>| trial.map_or("-".to_owned(), Trial::name);
    let mse = |trial: Option<&Trial>| number(trial.map(|trial| trial.mse), 4);
    let row = |choice: &Choice| {
        let [chosen, best] = [choice.chosen, choice.best_within_budget].map(|index| choice.at(index));
        let r = number(chosen.map(|trial| trial.r), 3);
        vec![choice.blendshape.to_owned(), name(chosen), r, mse(chosen), name(best), mse(best)]
    };
    Table::new(["blendshape", "chosen", "r", "MSE", "best in budget", "MSE"], choices.iter().map(row))
}

fn by_kind(choices: &[Choice]) -> Table {
    let row = |(index, first): (usize, &Trial)| {
        let chosen = choices.iter().filter(|choice| choice.chosen == Some(index)).count();
        let mean = |figure: fn(&Trial) -> f64, decimals| {
            number(Some(mean(choices.iter().map(|choice| figure(&choice.trials[index])))), decimals)
        };
        vec![
            first.name(),
            mean(|trial| trial.validation[0], 4),
            mean(|trial| trial.r, 3),
            mean(|trial| trial.mse, 4),
            mean(|trial| trial.bytes as f64, 0),
            mean(|trial| trial.nanoseconds, 0),
            first.features.to_string(),
            first.faces.to_string(),
            chosen.to_string(),
        ]
    };
    let heads = ["kind", "validation", "r", "MSE", "bytes", "ns", "features", "faces", "chosen"];
    Table::new(heads, choices.iter().take(1).flat_map(|first| &first.trials).enumerate().map(row))
}

fn summary(choices: &[Choice]) -> String {
    let chosen: Vec<(&str, &Trial)> =
        choices.iter().filter_map(|choice| Some((choice.blendshape, choice.at(choice.chosen)?))).collect();
    let trials = || chosen.iter().map(|(_, trial)| trial);
    let mut text = format!(
        "chosen: mean r {:.3}, mean MSE {:.4}, {} bytes in all\n",
        mean(trials().map(|trial| trial.r)),
        mean(trials().map(|trial| trial.mse)),
        trials().map(|trial| trial.bytes).sum::<usize>(),
    );
    let nonlinear = trials().filter(|trial| trial.form != Form::Affine).count();
    let transformed = trials().filter(|trial| trial.form == Form::Affine && trial.response != Response::Plain).count();
    text += &format!(
        "{nonlinear} of {} need more than an affine map, {transformed} an affine map of the transformed truth\n",
        chosen.len()
    );
    for (form, words) in FORMS {
        let names: Vec<&str> = chosen.iter().filter(|(_, trial)| trial.form == form).map(|(name, _)| *name).collect();
        if !names.is_empty() {
            text += &format!("{words}, {}: {}\n", names.len(), names.join(", "));
        }
    }
    text
}

const FORMS: [(Form, &str); 5] = [
    (Form::Affine, "affine"),
    (Form::Exponential, "exponential"),
    (Form::LogExponential, "log-exponential"),
    (Form::Quadratic, "quadratic"),
    (Form::HiddenLayer, "hidden layer"),
];

pub fn json(choices: &[Choice], split: &Split, budget: &Budget) -> Value {
    json!({
        "seen_pictures": split.seen.len(),
        "held_out_pictures": split.held_out.len(),
        "folds": split.folds,
        "one_subject": split.one_subject,
        "budget": budget,
        "blendshapes": choices,
    })
}

// The chosen formulas as a model file.

/// Returns the model of the chosen formulas. A blendshape without a choice is always 0, and its name is printed.
pub fn model_file(known: &[Choice], unknown: &[Choice], made_by: String, fitted_on: String) -> Result<ModelFile> {
    let formulas = Cases { neutral_known: set(known)?, neutral_unknown: set(unknown)? };
    Ok(ModelFile { formulas: Some(formulas), ..ModelFile::new(made_by, fitted_on) })
}

fn set(choices: &[Choice]) -> Result<FormulaSetTable> {
    let mut table = FormulaSetTable::default();
    let mut without = Vec::new();
    for name in &BLENDSHAPES[..MODELLED] {
        let choice = choices.iter().find(|choice| choice.blendshape == *name);
        let chosen = choice.and_then(|choice| choice.at(choice.chosen));
        let formula =
            if let Some((trial, (formula, scale))) = chosen.and_then(|trial| Some((trial, trial.formula.as_ref()?))) {
                add_inputs(&mut table.inputs, scale)?;
                formula_table(trial, formula, &names(scale))
            } else {
                without.push(*name);
                FormulaTable::default()
            };
        table.blendshapes.insert((*name).to_owned(), formula);
    }
    ensure!(without.len() < MODELLED, "no formula was chosen: allow more kinds, or a larger budget");
    if !without.is_empty() {
        eprintln!("always 0 in the model file, because no formula was chosen: {}", without.join(", "));
    }
    Ok(table)
}

fn names(scale: &Scale) -> Vec<String> {
    scale.features.iter().filter_map(|feature| FeatureId::from_index(*feature)).map(|id| id.to_string()).collect()
}

/// Adds mean and deviation of each feature of a formula.
fn add_inputs(inputs: &mut BTreeMap<String, [f64; 2]>, scale: &Scale) -> Result<()> {
    for (name, (mean, deviation)) in names(scale).into_iter().zip(scale.mean.iter().zip(&scale.deviation)) {
        let own = [rounded(*mean), rounded(*deviation)];
        let first = *inputs.entry(name).or_insert(own);
        ensure!(first.map(f64::to_bits) == own.map(f64::to_bits), "the formulas were fitted to different faces");
    }
    Ok(())
}

fn formula_table(trial: &Trial, formula: &Formula, names: &[String]) -> FormulaTable {
    let products = formula
        .pairs()
        .map(|([one, other], weight)| (format!("{}*{}", names[one], names[other]), rounded_weight(weight)));
    FormulaTable {
        kind: formula.kind,
        response: formula.response,
        score: trial.score,
        offset: rounded_weight(formula.offset),
        weights: names.iter().cloned().zip(formula.weights.iter().copied().map(rounded_weight)).collect(),
        products: products.collect(),
    }
}

/// Rounds the weight of a standardised feature, whose values are a few units. Sums of hundreds keep four decimals.
fn rounded_weight(value: f64) -> f64 {
    network::rounded(value, 6)
}

/// Rounds to seven digits, as many as the solver's single precision has.
fn rounded(value: f64) -> f64 {
    format!("{value:.6e}").parse().unwrap_or(value)
}
