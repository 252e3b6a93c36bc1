//! What `fit` prints: a line for every blendshape, a line for every kind, and what they come to.

use std::fmt::Write as _;

use serde_json::{Value, json};

use super::{
    choice::{Budget, Choice},
    split::Split,
    trial::Trial,
};
use crate::{kinds::Form, statistics::mean};

/// Everything the command prints.
pub fn text(choices: &[Choice], split: &Split, budget: &Budget) -> String {
    let parts = if split.one_subject { "pictures" } else { "subjects" };
    let mut text = format!(
        "{} pictures in {} folds of {parts} choose, {} other {parts}' pictures score\n",
        split.seen.len(),
        split.folds,
        split.held_out.len()
    )
    .replace("other pictures' pictures", "other pictures");
    let _ = writeln!(
        text,
        "budget of one blendshape: {} bytes, {:.0} nanoseconds; - : none within it\n\n{}\n{}\n{}",
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
|                     | chosen                           || best within budget      || best of all             || linear  |
| blendshape          | kind             |     r |   MSE  | kind             |   MSE  | kind             |   MSE  |   MSE  |
|---------------------|------------------|------:|-------:|------------------|-------:|------------------|-------:|-------:|
"
    .to_owned();
    for choice in choices {
        let [chosen, within, best, linear] =
            [choice.chosen, choice.best_within_budget, choice.best, choice.linear].map(|place| choice.at(place));
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

/// A line for every kind: means over the blendshapes.
fn by_kind(choices: &[Choice]) -> String {
    let mut text = "\
| kind         | validation |     r |   MSE  |    bytes |       ns | features |  faces | chosen |
|--------------|-----------:|------:|-------:|---------:|---------:|---------:|-------:|-------:|
"
    .to_owned();
    let kinds = choices.first().map_or(0, |choice| choice.trials.len());
    for place in 0..kinds {
        let trials = || choices.iter().filter_map(|choice| choice.trials.get(place));
        let chosen = choices.iter().filter(|choice| choice.chosen == Some(place)).count();
        let first = trials().next();
        let _ = writeln!(
            text,
            "| {:<12} | {:>10.4} | {:.3} | {:.4} | {:>8.0} | {:>8.0} | {:>8} | {:>6} | {chosen:>6} |",
            first.map_or("", |trial| trial.kind),
            mean(trials().map(|trial| trial.validation[0])),
            mean(trials().map(|trial| trial.r)),
            mean(trials().map(|trial| trial.mse)),
            mean(trials().map(|trial| trial.bytes as f64)),
            mean(trials().map(|trial| trial.nanoseconds)),
            first.map_or(0, |trial| trial.features),
            first.map_or(0, |trial| trial.faces),
        );
    }
    text
}

fn summary(choices: &[Choice]) -> String {
    let chosen = || choices.iter().filter_map(|choice| choice.at(choice.chosen));
    let bent = choices.iter().filter(|choice| choice.at(choice.chosen).is_some_and(|trial| trial.form != Form::Affine));
    let bent: Vec<&str> = bent.map(|choice| choice.blendshape).collect();
    format!(
        "chosen: mean r {:.3}, mean MSE {:.4}, {} bytes in all\nmore than an affine map within the budget: {} of {}: {}",
        mean(chosen().map(|trial| trial.r)),
        mean(chosen().map(|trial| trial.mse)),
        chosen().map(|trial| trial.bytes).sum::<usize>(),
        bent.len(),
        choices.len(),
        bent.join(", ")
    )
}

/// All figures.
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
