//! The results for a single subject beside the paper's table of models for one avatar.

use std::fmt::Write as _;

use facewire::solve::BLENDSHAPES;

use super::{as_fitted, choice::Choice, split::Split};
use crate::{
    judge::Faces,
    paper::{CHEEK_PUFF, MODELS_TITLE, ModelRow, SMILE_LEFT},
    report::diagnostics::Diagnostics,
    statistics::TestResult,
};

/// Returns the tables of those of the paper's two blendshapes that were fitted.
pub fn text(choices: &[Choice], faces: &Faces, split: &Split) -> String {
    let papers: [(&str, &[ModelRow]); 2] = [("mouthSmileLeft", &SMILE_LEFT), ("cheekPuff", &CHEEK_PUFF)];
    let mut text = String::new();
    for (blendshape, paper) in papers {
        if let Some(choice) = choices.iter().find(|choice| choice.blendshape == blendshape) {
            let _ = writeln!(text, "\n{blendshape}; indented rows are the paper's ({MODELS_TITLE})\n{HEAD}");
            text.extend(lines(choice, faces, split));
            text.extend(paper.iter().map(paper_line));
        }
    }
    text
}

const HEAD: &str = "\
| kind             |     R2 |    xi |    MSE |   DW |     BP |  p(BP) |       F |    SW |    bytes |       ns |
|------------------|-------:|------:|-------:|-----:|-------:|-------:|--------:|------:|---------:|---------:|";

fn lines(choice: &Choice, faces: &Faces, split: &Split) -> Vec<String> {
    let blendshape = BLENDSHAPES.iter().position(|name| *name == choice.blendshape).unwrap_or(0);
    let truth = faces.truth(blendshape, &split.held_out);
    let line = |trial: &super::Trial| {
        let fitted = as_fitted(blendshape, trial.clone());
        let found = Diagnostics::new(&fitted, &truth);
        let statistic = |tested: Option<TestResult>, decimals: usize| {
            tested.map_or("-".to_owned(), |tested| format!("{:.decimals$}", tested.statistic))
        };
        format!(
            "| {:<16} | {:>6.4} | {:.3} | {:.4} | {:.2} | {:>6} | {:>6} | {:>7} | {:>5} | {:>8} | {:>8.0} |\n",
            fitted.kind,
            found.r_squared,
            found.xi,
            found.mse,
            found.durbin_watson,
            statistic(found.breusch_pagan, 1),
            found.breusch_pagan.map_or("-".to_owned(), |test| format!("{:.0e}", test.p)),
            statistic(found.f, 0),
            statistic(found.shapiro_wilk, 3),
            fitted.bytes,
            fitted.nanoseconds
        )
    };
    choice.trials.iter().map(line).collect()
}

fn paper_line(row: &ModelRow) -> String {
    let [r_squared, xi, mse, durbin_watson, shapiro_wilk] = row.figures;
    let (kind, bytes) = (format!("  {}", row.kind), row.bytes);
    format!(
        "| {kind:<16} | {r_squared:>6.4} | {xi:.3} | {mse:.4} | {durbin_watson:.2} |        |        |         | {shapiro_wilk:.3} | {bytes:>8} |          |\n"
    )
}
