//! `facewire-fit wearers`: what knowing the wearer is worth, and whether a face looks right, on clips of wearers.

mod film;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use rayon::prelude::*;

use self::film::{Checks, Knowledge};
use crate::judge::command::load_model;
use crate::judge::figures::{Judgement, Phase, Row};
use crate::judge::tables::{WITH_INTERVALS, with_intervals};
use crate::output::Table;

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

pub fn run(options: &Options) -> Result<()> {
    let model = load_model(options.model.as_deref())?;
    let films = film::load(&options.clips)?;
    let (mut rows, mut checks) = (Vec::new(), Vec::new());
    for knowledge in Knowledge::ALL {
        let learned = films.par_iter().map(|film| film.learn(&model, knowledge)).collect::<Result<Vec<_>>>()?;
        let people: Vec<_> = films.par_iter().zip(&learned).map(|(film, solver)| film.judged(solver)).collect();
        let judgement = Judgement::new(people, options.resamples);
        let cells = with_intervals(&judgement, Row::Blendshapes, Phase::All);
        rows.push([knowledge.name().to_owned()].into_iter().chain(cells).collect::<Vec<_>>());
        let known = learned.iter().filter(|learned| learned.is_known()).count();
        eprintln!("{}: something is known of {known} of {} people", knowledge.name(), films.len());
        let found: Vec<Checks> =
            films.par_iter().zip(&learned).map(|(film, learned)| Checks::new(film, learned)).collect();
        checks.push((knowledge, found));
    }
    println!("{}", Table::new(["known of the wearer"].into_iter().chain(WITH_INTERVALS), rows).text());
    println!("{}", film::table_of(&checks).text());
    print!("{}", film::turned(&checks));
    Ok(())
}
