//! `facewire-fit expressions`: compares the expressions that `synth` draws with recorded ones: density, distribution of
//! each blendshape, asymmetry, and correlations.

mod drawings;
mod figures;
mod page;

use std::{fmt::Write, path::PathBuf};

use anyhow::{Result, ensure};
use clap::Args;
use facewire::solve::BLENDSHAPES;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

use super::{
    acting_options::{Curves, MixOptions, mix_text},
    anatomy::enforce_limits,
    expression::Coefficients,
    set::Set,
};
use crate::{html, output};
use figures::Figures;

/// Arguments of `expressions`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  facewire-fit expressions expressions.html
  facewire-fit expressions speech.html --mix speech=1 --csv speech.csv
  facewire-fit expressions judge.html --set judge")]
pub struct Options {
    /// The page to write
    out: PathBuf,
    /// Number of expressions to draw
    #[arg(long, default_value_t = 20_000, value_parser = clap::value_parser!(u32).range(2..=1_000_000))]
    count: u32,
    /// Seed of the random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Set of recordings to draw from and to compare with
    #[arg(long, value_enum, default_value = "train")]
    set: Set,
    /// CSV file for the drawn expressions
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    #[command(flatten)]
    curves: Curves,
    #[command(flatten)]
    mix: MixOptions,
}

/// Runs the command.
pub fn run(options: &Options) -> Result<()> {
    options.csv.iter().chain([&options.out]).try_for_each(|path| output::check(path))?;
    let moments = options.curves.moments(options.set)?;
    let mut recorded = moments.frames().to_vec();
    ensure!(recorded.len() > 1, "the recordings have too few frames to compare with");
    recorded.iter_mut().for_each(enforce_limits);
    let expressions = options.mix.expressions(options.set, moments)?;
    let mut rng = ChaCha8Rng::seed_from_u64(options.set.seed(options.seed));
    let sampled: Vec<Coefficients> = (0..options.count).map(|_| expressions.draw(&mut rng)).collect();
    if let Some(path) = &options.csv {
        output::write(path, table(&sampled)?)?;
    }
    let [recorded, sampled] = [recorded, sampled].map(|faces| Figures::of(&faces));
    print!("{}", page::summary(&recorded, &sampled));
    html::write(&options.out, &page::html(&recorded, &sampled, &mix_text(options.mix.mix(options.set)))?)
}

/// Returns expressions as a table with the blendshapes' names in the header.
fn table(faces: &[Coefficients]) -> Result<String> {
    let mut text = BLENDSHAPES.join(",") + "\n";
    for face in faces {
        for (index, value) in face.iter().enumerate() {
            write!(text, "{}{value:.4}", if index > 0 { "," } else { "" })?;
        }
        text.push('\n');
    }
    Ok(text)
}
