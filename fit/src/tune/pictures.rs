//! The shares of the networks that read pictures of mouth and brows.
//!
//! The share of a blendshape is the one at which the regression and the network together have the least squared error. Both sides
//! have the same share.

use std::collections::BTreeMap;
use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use facewire_face::{BLENDSHAPES, COEFFS, Model};

use super::correction::{Pairs, pairs, sides, stems};
use crate::judge::set::{RawFaces, Set};
use crate::output::{self, Table};

/// The blendshapes that the networks read, by how their names begin.
const READ: [&str; 6] = ["jaw", "mouth", "cheekPuff", "brow", "eyeWide", "eyeSquint"];
/// A smaller share is not worth its place.
const LEAST_SHARE: f64 = 0.1;

#[derive(Debug, Args)]
#[command(after_help = "\
Example:
  facewire-fit tune pictures faces/covered/faces.npz && facewire-fit tune correction faces/covered/faces.npz")]
pub struct Options {
    /// Landmarks with true coefficients (npz archives with names.json beside them), of which the held-out subjects count,
    /// or folders of clips
    #[arg(required = true, value_name = "SET")]
    sets: Vec<PathBuf>,
    /// The model whose shares to find
    #[arg(long, value_name = "FILE", default_value = "models/blendshapes.toml")]
    model: PathBuf,
    /// The model file to write
    #[arg(long, value_name = "FILE", default_value = "models/blendshapes.toml")]
    out: PathBuf,
    /// Number of frames at the start of each clip in which the face is at rest
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    neutral_frames: u32,
}

pub fn run(options: &Options) -> Result<()> {
    output::check(&options.out)?;
    let mut file = output::read_model(&options.model)?;
    let mut model = file.to_model()?;
    model.pictures = [0.0; COEFFS];
    let without = faces(options, &model)?;
    model.pictures = [1.0; COEFFS];
    let alone = faces(options, &model)?;
    file.pictures = BTreeMap::new();
    let mut rows = Vec::new();
    for stem in stems().into_iter().filter(|stem| READ.iter().any(|read| stem.starts_with(read))) {
        let [regression, network] = [&without, &alone].map(|faces| pairs(faces, &stem));
        let share = best_share(&regression, &network);
        let blend: Pairs = regression
            .iter()
            .zip(&network)
            .map(|([one, truth], [other, _])| [one + share * (other - one), *truth])
            .collect();
        let errors = [&regression, &network, &blend].map(|pairs| format!("{:.4}", mean_squared_error(pairs)));
        rows.push([stem.clone(), format!("{share:.2}")].into_iter().chain(errors).collect());
        if share >= LEAST_SHARE {
            let names = sides(&stem).into_iter().map(|shape| BLENDSHAPES[shape].to_owned());
            file.pictures.extend(names.map(|name| (name, (100.0 * share).round() / 100.0)));
        }
    }
    print!("{}", Table::new(["blendshapes", "share", "error: regression", "network", "both"], rows).text());
    output::write(&options.out, toml::to_string(&file)?)
}

fn faces(options: &Options, model: &Model) -> Result<RawFaces> {
    let mut all = RawFaces::new();
    for path in &options.sets {
        let set = Set::load(path, false, options.neutral_frames)?;
        for neutral_known in [true, false] {
            all.extend(set.raw(model, neutral_known)?.into_iter().flatten());
        }
    }
    Ok(all)
}

/// The share of the network, from 0 to 1, at which the squared error is least.
pub fn best_share(regression: &Pairs, network: &Pairs) -> f64 {
    let mut along = 0.0;
    let mut squares = 0.0;
    for ([one, truth], [other, _]) in regression.iter().zip(network) {
        along += (other - one) * (truth - one);
        squares += (other - one).powi(2);
    }
    if squares > 0.0 { (along / squares).clamp(0.0, 1.0) } else { 0.0 }
}

fn mean_squared_error(pairs: &Pairs) -> f64 {
    pairs.iter().map(|[value, truth]| (value - truth).powi(2)).sum::<f64>() / pairs.len().max(1) as f64
}
