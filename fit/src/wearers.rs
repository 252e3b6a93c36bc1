//! `facewire-fit wearers`: what knowing the wearer is worth, and whether a face looks right, on clips of wearers.

mod checks;
mod film;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use rayon::prelude::*;

use self::{checks::Checks, film::Knowledge};
use crate::judge::{
    command::load_model,
    people::Phase,
    sheet::{Figure, Judgement, Row},
    text::{number, table},
};

/// Arguments of `wearers`.
#[derive(Debug, Args)]
#[command(after_help = "The clips are of people whom no fit has seen, but what counts as at rest was chosen on such
clips. All rows are judged on the same 20 seconds.
  nothing             the mean face of many people
  watched             what facewire has found while it watched the minute before
  never at rest       what it has found in a wearer who holds the last expression instead of being at rest
  neutral face        the mean of half a second at rest is taken as the neutral face
  calibrated          the guided calibration
  smiled              the guided calibration of a wearer who smiles when asked for a neutral face. Where it is
                      refused, nothing is known

Examples:
  facewire-fit film wearers --count 20 --script wearer
  facewire-fit wearers wearers")]
pub struct Options {
    /// Folder of clips, as `film --script wearer` makes them
    clips: PathBuf,
    /// A model to judge instead of the built-in one
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Draws of people for the confidence intervals
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u64).range(40..=100_000))]
    resamples: u64,
}

/// Runs the command.
pub fn run(options: &Options) -> Result<()> {
    let model = load_model(options.model.as_deref())?;
    let films = film::load(&options.clips)?;
    let (mut rows, mut checks) = (Vec::new(), Vec::new());
    for knowledge in Knowledge::ALL {
        let learned = films.par_iter().map(|film| film.learn(&model, knowledge)).collect::<Result<Vec<_>>>()?;
        let people: Vec<_> = films.par_iter().zip(&learned).map(|(film, solver)| film.judged(solver)).collect();
        rows.push(row(knowledge, &Judgement::new(people, options.resamples)));
        let known = learned.iter().filter(|learned| learned.is_known()).count();
        eprintln!("{}: something is known of {known} of {} people", knowledge.name(), films.len());
        let found: Vec<Checks> =
            films.par_iter().zip(&learned).map(|(film, learned)| Checks::new(film, learned)).collect();
        checks.push((knowledge, found));
    }
    let heads = ["known of the wearer", "r", "95 %", "MSE", "95 %", "= bias", "+ gain", "+ rest", "bias"];
    println!("{}", table(&heads, &rows));
    println!("{}", checks::table_of(&checks));
    print!("{}", checks::turned(&checks));
    Ok(())
}

/// Returns the figures of all people together: means over the blendshapes.
fn row(knowledge: Knowledge, judgement: &Judgement) -> Vec<String> {
    let value = |figure| number(figure, judgement.sheet.get(Row::Blendshapes, Phase::All, figure));
    let ends = |figure| {
        let interval = judgement.interval(Row::Blendshapes, Phase::All, figure);
        format!("{} .. {}", number(figure, interval.low), number(figure, interval.high))
    };
    let mut cells = vec![knowledge.name().to_owned(), value(Figure::R), ends(Figure::R)];
    cells.extend([value(Figure::Mse), ends(Figure::Mse)]);
    cells.extend([Figure::MseOfBias, Figure::MseOfGain, Figure::MseOfRest, Figure::Bias].map(value));
    cells
}
