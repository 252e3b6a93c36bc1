//! The choice of the kind of model for a blendshape.

use std::fmt::Write as _;

use facewire_face::model::Response;
use serde::Serialize;
use serde_json::{Value, json};

use super::split::Split;
use super::trial::Trial;
use crate::kinds::Form;
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
    /// Returns whether the model can run on a board within the budget.
    pub fn allows(&self, trial: &Trial) -> bool {
        let runs = trial.form != Form::Large && (trial.formula.is_some() || !self.formulas_only);
        runs && trial.bytes <= self.bytes && trial.nanoseconds <= self.nanoseconds
    }
}

/// The trials of one blendshape. Choices are indices into `trials`.
#[derive(Debug, Clone, Serialize)]
pub struct Choice {
    pub blendshape: &'static str,
    /// All trials, in the order of the kinds.
    pub trials: Vec<Trial>,
    /// The simplest trial within the budget whose validation error is within one standard error of the best trial's.
    pub chosen: Option<usize>,
    pub best_within_budget: Option<usize>,
    pub best: Option<usize>,
    /// The trial with the least validation error among affine maps of the features to the untransformed truth.
    pub linear: Option<usize>,
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
        let best = least(&|_| true);
        let linear = least(&|trial| simplicity(trial) == (Form::Affine, Response::Plain));
        Self { blendshape, trials, chosen, best_within_budget, best, linear }
    }

    pub fn at(&self, index: Option<usize>) -> Option<&Trial> {
        self.trials.get(index?)
    }
}

/// Returns a key that orders trials from simple to complex.
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
        let indices = [choice.chosen, choice.best_within_budget, choice.best, choice.linear];
        let [chosen, within, best, linear] = indices.map(|index| choice.at(index));
        let mut cells = vec![choice.blendshape.to_owned(), name(chosen), number(chosen.map(|trial| trial.r), 3)];
        cells.extend([mse(chosen), name(within), mse(within), name(best), mse(best), mse(linear)]);
        cells
    };
    let heads =
        ["blendshape", "chosen", "r", "MSE", "best in budget", "MSE", "best of all", "MSE", "MSE of the best linear"];
    Table::new(heads, choices.iter().map(row))
}

/// Returns one line per kind and response, averaged over the blendshapes.
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

/// Returns the mean scores of the chosen kinds, and the blendshapes for which each form was chosen.
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
    let _ = writeln!(
        text,
        "{nonlinear} of {} need more than an affine map, {transformed} an affine map of the transformed truth",
        chosen.len()
    );
    for (form, words) in FORMS {
        let names: Vec<&str> = chosen.iter().filter(|(_, trial)| trial.form == form).map(|(name, _)| *name).collect();
        if !names.is_empty() {
            let _ = writeln!(text, "{words}, {}: {}", names.len(), names.join(", "));
        }
    }
    text
}

/// The forms that can run on a board, in words.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(kind: &'static str, form: Form, validation: [f64; 2], bytes: usize) -> Trial {
        Trial {
            kind,
            response: Response::Plain,
            form,
            validation,
            r: 0.0,
            mse: 0.0,
            bytes,
            nanoseconds: 1.0,
            weights: 1,
            faces: 1,
            features: 1,
            predictions: Vec::new(),
            formula: None,
        }
    }

    fn chosen(trials: Vec<Trial>) -> [Option<&'static str>; 4] {
        let choice = Choice::new("jawOpen", trials, &Budget { bytes: 100, nanoseconds: 10.0, formulas_only: false });
        [choice.chosen, choice.best_within_budget, choice.best, choice.linear]
            .map(|index| choice.at(index).map(|trial| trial.kind))
    }

    #[test]
    fn the_simpler_kind_within_a_standard_error_of_the_best_is_chosen() {
        let trials = |affine| {
            vec![
                trial("ols", Form::Affine, [affine, 0.1], 10),
                trial("poly", Form::Quadratic, [1.0, 0.2], 10),
                trial("gp-rbf", Form::Large, [0.5, 0.1], 10),
            ]
        };
        assert_eq!(chosen(trials(1.19)), [Some("ols"), Some("poly"), Some("gp-rbf"), Some("ols")]);
        assert_eq!(chosen(trials(1.21))[0], Some("poly"));
    }

    #[test]
    fn among_equally_simple_kinds_the_better_is_chosen() {
        let trials = vec![trial("ols", Form::Affine, [1.1, 0.5], 10), trial("ridge", Form::Affine, [1.0, 0.5], 10)];
        assert_eq!(chosen(trials)[0], Some("ridge"));
    }

    #[test]
    fn a_kind_over_the_budget_is_not_chosen() {
        let trials = vec![trial("ols", Form::Affine, [2.0, 0.1], 10), trial("poly", Form::Quadratic, [1.0, 0.1], 101)];
        assert_eq!(chosen(trials), [Some("ols"), Some("ols"), Some("poly"), Some("ols")]);
        assert_eq!(chosen(vec![trial("gp-rbf", Form::Large, [1.0, 0.1], 1)])[..2], [None, None]);
    }
}
