//! The choice of the kind of model for a blendshape.

use std::collections::BTreeMap;

use anyhow::{Result, ensure};
use facewire_face::BLENDSHAPES;
use facewire_face::model::{Cases, FeatureId, FormulaSetTable, FormulaTable, ModelFile, Response, ScoreTable};
use serde::Serialize;
use serde_json::{Value, json};

use super::Split;
use super::trial::{Scale, Trial};
use crate::design::MODELLED;
use crate::kinds::{Form, Formula};
use crate::output::{Table, number};
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

    fn at(&self, index: Option<usize>) -> Option<&Trial> {
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
    let products =
        formula.pairs().map(|([one, other], weight)| (format!("{}*{}", names[one], names[other]), rounded(weight)));
    FormulaTable {
        kind: formula.kind,
        response: formula.response,
        score: ScoreTable { r: rounded(trial.r), mse: rounded(trial.mse) },
        offset: rounded(formula.offset),
        weights: names.iter().cloned().zip(formula.weights.iter().copied().map(rounded)).collect(),
        products: products.collect(),
    }
}

/// Rounds to seven digits, as many as the solver's single precision has.
fn rounded(value: f64) -> f64 {
    format!("{value:.6e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use facewire_face::Landmarks;
    use facewire_face::stages::{Features, normalise};

    use super::*;
    use crate::compare::trial::Trials;
    use crate::curves::tests::test_clip;
    use crate::dataset::Sample;
    use crate::faces::{Faces, estimates};
    use crate::kinds;

    fn trial(kind: &'static str, form: Form, validation: [f64; 2], bytes: usize) -> Trial {
        Trial { kind, form, validation, bytes, nanoseconds: 1.0, ..Trial::default() }
    }

    fn chosen(trials: Vec<Trial>) -> [Option<&'static str>; 2] {
        let choice = Choice::new("jawOpen", trials, &Budget { bytes: 100, nanoseconds: 10.0, formulas_only: false });
        [choice.chosen, choice.best_within_budget].map(|index| choice.at(index).map(|trial| trial.kind))
    }

    #[test]
    fn the_simplest_kind_in_the_budget_within_a_standard_error_of_the_best_is_chosen() {
        let trials = |affine| {
            vec![
                trial("ols", Form::Affine, [affine, 0.1], 10),
                trial("poly", Form::Quadratic, [1.0, 0.2], 10),
                trial("gp-rbf", Form::Large, [0.5, 0.1], 10),
            ]
        };
        assert_eq!(chosen(trials(1.19)), [Some("ols"), Some("poly")]);
        assert_eq!(chosen(trials(1.21))[0], Some("poly"));
        let equal = vec![trial("ols", Form::Affine, [1.1, 0.5], 10), trial("ridge", Form::Affine, [1.0, 0.5], 10)];
        assert_eq!(chosen(equal)[0], Some("ridge"), "the better of equally simple ones");
        let costly = vec![trial("ols", Form::Affine, [2.0, 0.1], 10), trial("poly", Form::Quadratic, [1.0, 0.1], 101)];
        assert_eq!(chosen(costly), [Some("ols"), Some("ols")]);
        assert_eq!(chosen(vec![trial("gp-rbf", Form::Large, [1.0, 0.1], 1)]), [None, None]);
    }

    const JAW_OPEN: usize = 17;

    /// The built-in clip as facewire tracks it. The truth of the jaw is the gap of the lips, stretched from 0 to 1.
    fn samples() -> Vec<Sample> {
        let gap = FeatureId::from_name("d13-14").unwrap().index();
        let sample = |(row, landmarks): (usize, Landmarks)| {
            let gap = Features::new(&normalise(&landmarks).unwrap(), None).values()[gap];
            let mut sample = Sample { neutral: row == 0, ..Sample::of_test(landmarks, row) };
            sample.truth[JAW_OPEN] = f64::from((4.0 * gap - 0.1).clamp(0.0, 1.0));
            sample
        };
        test_clip().into_iter().enumerate().map(sample).collect()
    }

    fn choice(trial: &Trial) -> Choice {
        let budget = Budget { bytes: usize::MAX, nanoseconds: f64::INFINITY, formulas_only: true };
        Choice::new("jawOpen", vec![trial.clone()], &budget)
    }

    #[test]
    fn solver_gives_what_every_exported_kind_gives_on_a_tracked_clip() {
        let samples = samples();
        let split = Split::new(&samples, 2, true).unwrap();
        let cases = [true, false].map(|known| Faces::new(&samples, known).unwrap());
        let trials = cases.each_ref().map(|faces| {
            let runner = Trials::new(faces, &split);
            let ranks = runner.rank(JAW_OPEN, 30);
            let kinds = kinds::ALL.iter().filter(|kind| kind.form.is_formula());
            let tried = kinds.flat_map(|kind| runner.run_kind(kind, JAW_OPEN, &ranks).unwrap());
            tried.map(|tried| runner.timed(tried).unwrap()).collect::<Vec<Trial>>()
        });
        assert_eq!(trials[0].len(), 4 * 3 + 2 + 3, "kinds with their responses");
        for (known, unknown) in trials[0].iter().zip(&trials[1]) {
            let file = model_file(&[choice(known)], &[choice(unknown)], String::new(), String::new()).unwrap();
            let model = ModelFile::parse(&toml::to_string(&file).unwrap()).unwrap().to_model().unwrap();
            for (trial, faces) in [known, unknown].into_iter().zip(&cases) {
                let solved = estimates(&model, faces, &split.held_out).unwrap();
                let differences =
                    solved[JAW_OPEN].iter().zip(&trial.predictions).map(|(one, other)| (one - other).abs());
                let largest = differences.fold(0.0, f64::max);
                assert!(largest < 1e-4, "{}: {largest}", trial.name());
                let most = trial.predictions.iter().fold(0.0_f64, |most, value| most.max(*value));
                let least = trial.predictions.iter().fold(1.0_f64, |least, value| least.min(*value));
                assert!(most - least > 0.1, "{}: {least} to {most}", trial.name());
            }
        }
    }
}
