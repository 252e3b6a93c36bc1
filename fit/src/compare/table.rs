//! The output of `fit`: a table by blendshape, a table by kind, and a summary.

use std::fmt::Write as _;

use facewire::solve::Response;
use serde_json::{Value, json};

use super::{
    choice::{Budget, Choice},
    split::Split,
    trial::Trial,
};
use crate::{kinds::Form, statistics::mean};

/// Returns everything that the command prints.
pub fn text(choices: &[Choice], split: &Split, budget: &Budget) -> String {
    let parts = if split.one_subject { "pictures" } else { "whole subjects" };
    let mut text = format!(
        "kinds chosen on {} pictures in {} folds of {parts}, scored on {} held-out pictures\n",
        split.seen.len(),
        split.folds,
        split.held_out.len()
    );
    let _ = writeln!(
        text,
        "budget of one blendshape: {} bytes, {:.0} nanoseconds; - means that no kind is within it\n\n{}\n{}\n{}",
        budget.bytes,
        budget.nanoseconds,
        by_blendshape(choices),
        by_kind(choices),
        summary(choices)
    );
    text
}

fn by_blendshape(choices: &[Choice]) -> String {
    let mut text = "\
| blendshape          | chosen           |     r |   MSE  | best in budget   |   MSE  | best of all      |   MSE  | linear |
|---------------------|------------------|------:|-------:|------------------|-------:|------------------|-------:|-------:|
"
    .to_owned();
    for choice in choices {
        let [chosen, within, best, linear] =
            [choice.chosen, choice.best_within_budget, choice.best, choice.linear].map(|index| choice.at(index));
        let r = chosen.map_or("-".to_owned(), |trial| format!("{:.3}", trial.r));
        let _ = writeln!(
            text,
            "| {:<19} | {:<16} | {r:>5} | {} | {:<16} | {} | {:<16} | {} | {} |",
            choice.blendshape,
            name(chosen),
            mse(chosen),
            name(within),
            mse(within),
            name(best),
            mse(best),
            mse(linear)
        );
    }
    text
}

fn name(trial: Option<&Trial>) -> String {
    trial.map_or("-".to_owned(), Trial::name)
}

fn mse(trial: Option<&Trial>) -> String {
    trial.map_or("     -".to_owned(), |trial| format!("{:.4}", trial.mse))
}

/// Returns one line per kind and response, averaged over the blendshapes.
fn by_kind(choices: &[Choice]) -> String {
    let mut text = "\
| kind             | validation |     r |   MSE  |    bytes |       ns | features |  faces | chosen |
|------------------|-----------:|------:|-------:|---------:|---------:|---------:|-------:|-------:|
"
    .to_owned();
    let Some(first) = choices.first() else { return text };
    for (index, Trial { features, faces, .. }) in first.trials.iter().enumerate() {
        let chosen = choices.iter().filter(|choice| choice.chosen == Some(index)).count();
        let mean = |figure: fn(&Trial) -> f64| mean(choices.iter().map(|choice| figure(&choice.trials[index])));
        let _ = writeln!(
            text,
            "| {:<16} | {:>10.4} | {:>5.3} | {:.4} | {:>8.0} | {:>8.0} | {features:>8} | {faces:>6} | {chosen:>6} |",
            first.trials[index].name(),
            mean(|trial| trial.validation[0]),
            mean(|trial| trial.r),
            mean(|trial| trial.mse),
            mean(|trial| trial.bytes as f64),
            mean(|trial| trial.nanoseconds),
        );
    }
    text
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

/// Returns all results as JSON.
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
