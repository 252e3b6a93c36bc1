//! The corrective terms (eq. 7) of every blendshape.
//!
//! A regression that minimises the squared error reads strong expressions too weak, because they are rare. Receivers
//! expect that a full expression arrives in full. Here strong expressions therefore count more than by their number:
//! the error is averaged over the pictures of each level of the truth, and then over the levels, weighted by a power of
//! their number of pictures ([`LEVELLING`]).

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use facewire_face::model::{Correction, CorrectiveTerms};
use facewire_face::{BLENDSHAPES, COEFFS, Model};
use rayon::prelude::*;

use crate::judge::set::{RawFaces, Set};
use crate::output::{self, Table};
use crate::statistics::{LEVELS, level_of};

/// The first steps of the search: shift, slope, lift, and the ends of the response.
const STEPS: [f64; 5] = [0.04, 0.2, 0.2, 0.1, 0.1];
/// Narrowest range of response, and bounds of shift, slope and lift. Beyond them a coefficient would be a switch: off for
/// most of its way, and then suddenly on.
const LEAST_WIDTH: f64 = 0.4;
const BOUNDS: [[f64; 2]; 3] = [[-0.05, 0.0], [0.8, 1.8], [0.0, 1.0]];
/// These keep their usual terms: the lids because blinks would not quite close, and the gaze because it has a fit of its own.
const KEPT: [&str; 2] = ["eyeBlink", "eyeLook"];
/// Power of a level's number of pictures that is its weight: with 1 all pictures count alike, with 0 all levels.
const LEVELLING: f64 = 0.55;
/// Terms that lower the error by less than this share are not worth their place.
const LEAST_GAIN: f64 = 0.02;
/// Introduces the sets in the model file's `made_by`.
const TUNED_BY: &str = "; corrective terms: facewire-fit tune correction ";

#[derive(Debug, Args)]
#[command(after_help = "Each half of the people judges the terms that were fitted to the other half.

Examples:
  facewire-fit tune correction faces/varied/faces.npz faces/halves/faces.npz
  facewire-fit judge clips --against before.toml --page tuned.html")]
pub struct Options {
    /// Landmarks with true coefficients (npz archives with names.json beside them), of which the held-out subjects count,
    /// or folders of clips
    #[arg(required = true, value_name = "SET")]
    sets: Vec<PathBuf>,
    /// The model to correct
    #[arg(long, value_name = "FILE", default_value = "models/blendshapes.toml")]
    model: PathBuf,
    /// The model file to write
    #[arg(long, value_name = "FILE", default_value = "models/blendshapes.toml")]
    out: PathBuf,
    /// Number of frames at the start of each clip in which the face is at rest
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    neutral_frames: u32,
}

pub type Pairs = Vec<[f64; 2]>;

pub fn run(options: &Options) -> Result<()> {
    output::check(&options.out)?;
    let mut file = output::read_model(&options.model)?;
    let people = people(options, &file.to_model()?)?;
    println!("error: squared, mean over the levels of the truth");
    let is_free = |stem: &String| !KEPT.iter().any(|kept| stem.starts_with(kept));
    let fitted: Vec<_> = stems().into_par_iter().filter(is_free).map(|stem| Fitted::new(stem, &people)).collect();
    file.correction = BTreeMap::new();
    let heads = ["blendshapes", "shift", "slope", "lift", "response", "error before", "after", "after, other people"];
    print!("{}", Table::new(heads, fitted.iter().map(Fitted::row)).text());
    for fitted in &fitted {
        if fitted.crossed < (1.0 - LEAST_GAIN) * fitted.before {
            let names = sides(&fitted.stem).into_iter().map(|shape| BLENDSHAPES[shape].to_owned());
            file.correction.extend(names.map(|name| (name, fitted.terms)));
        }
    }
    let sets: Vec<String> = options.sets.iter().map(|path| path.display().to_string()).collect();
    let before = file.made_by.split(TUNED_BY).next().unwrap_or_default();
    file.made_by = format!("{before}{TUNED_BY}{}", sets.join(" "));
    output::write_model(&options.out, &file)
}

fn people(options: &Options, model: &Model) -> Result<Vec<RawFaces>> {
    let mut people = Vec::new();
    for path in &options.sets {
        let set = Set::load(path, false, options.neutral_frames)?;
        let [known, unknown] = [set.raw(model, true)?, set.raw(model, false)?];
        people.extend(known.into_iter().zip(unknown).map(|(known, unknown)| [known, unknown].concat()));
    }
    Ok(people)
}

struct Fitted {
    stem: String,
    terms: CorrectiveTerms,
    before: f64,
    after: f64,
    crossed: f64,
}

impl Fitted {
    fn new(stem: String, people: &[RawFaces]) -> Self {
        let people: Vec<Pairs> = people.iter().map(|faces| pairs(faces, &stem)).collect();
        let all = people.concat();
        let terms = fit(&stem, &all);
        let [before, after] = [usual(&stem), terms].map(|terms| cost(&terms, &all));
        Self { before, after, crossed: crossed(&stem, &people), stem, terms }
    }

    fn row(&self) -> Vec<String> {
        let CorrectiveTerms { shift, slope, lift, response: [from, to] } = self.terms;
        let terms =
            [format!("{shift:+.3}"), format!("{slope:.2}"), format!("{lift:.2}"), format!("{from:.2} .. {to:.2}")];
        let errors = [self.before, self.after, self.crossed].map(|error| format!("{error:.4}"));
        [self.stem.clone()].into_iter().chain(terms).chain(errors).collect()
    }
}

/// Returns the names of the blendshapes without their side. Both sides have the same terms.
pub fn stems() -> Vec<String> {
    let mut known = BTreeSet::new();
    let shown = BLENDSHAPES.iter().filter(|name| **name != "tongueOut");
    shown.map(|name| stem(name)).filter(|stem| known.insert(stem.clone())).collect()
}

pub fn stem(name: &str) -> String {
    name.trim_end_matches("Left").trim_end_matches("Right").to_owned()
}

/// Returns the blendshapes of both sides.
pub fn sides(stem: &str) -> Vec<usize> {
    (0..COEFFS).filter(|shape| self::stem(BLENDSHAPES[*shape]) == stem).collect()
}

pub fn pairs(faces: &RawFaces, stem: &str) -> Pairs {
    let shapes = sides(stem);
    let pair = |(raw, truth): &([f32; COEFFS], [f64; COEFFS]), shape: usize| [f64::from(raw[shape]), truth[shape]];
    faces.iter().flat_map(|face| shapes.iter().map(move |shape| pair(face, *shape))).collect()
}

/// Returns the terms that a model without a table has.
fn usual(stem: &str) -> CorrectiveTerms {
    Correction::default().0[sides(stem)[0]]
}

pub fn fit(stem: &str, pairs: &Pairs) -> CorrectiveTerms {
    let CorrectiveTerms { shift, slope, lift, response: [from, to] } = usual(stem);
    let start = [shift, slope, lift, from, to].map(f64::from);
    let cost = |numbers: &[f64; 5]| {
        let terms = terms(numbers);
        let are_bounded =
            numbers.iter().copied().zip(BOUNDS).all(|(number, [least, most])| (least..=most).contains(&number));
        let is_wide = numbers[4] - numbers[3] >= LEAST_WIDTH;
        if terms.keep_order() && is_wide && are_bounded { cost(&terms, pairs) } else { f64::INFINITY }
    };
    let starts = [start, [0.0, 1.0, 0.3, 0.1, 0.6]];
    let found = starts.map(|start| minimum(start, STEPS, cost));
    let best = if found[0].1 <= found[1].1 { found[0].0 } else { found[1].0 };
    terms(&best)
}

fn terms(numbers: &[f64; 5]) -> CorrectiveTerms {
    let [shift, slope, lift, from, to] = numbers.map(|number| ((number * 1e3).round() / 1e3) as f32);
    CorrectiveTerms { shift, slope, lift, response: [from, to] }
}

/// Returns the mean over the levels of the truth, weighted, of the squared error after the terms.
fn cost(terms: &CorrectiveTerms, pairs: &Pairs) -> f64 {
    let (mut sums, mut counts) = ([0.0; LEVELS.len()], [0.0; LEVELS.len()]);
    for [raw, truth] in pairs {
        let level = level_of(*truth);
        sums[level] += (f64::from(terms.correct(*raw as f32, 0.0, 1.0)) - truth).powi(2);
        counts[level] += 1.0;
    }
    // An exponent of 1 counts all pictures alike, and 0 all levels alike.
    let weight = |level: usize| f64::powf(counts[level], LEVELLING);
    let levels = || 0..LEVELS.len();
    let sum: f64 = levels().map(|level| weight(level) * sums[level] / counts[level].max(1.0)).sum();
    sum / levels().map(weight).sum::<f64>().max(1.0)
}

/// Returns the error for people whom the fit has not seen: each half judges the terms of the other half.
fn crossed(stem: &str, people: &[Pairs]) -> f64 {
    let half = |parity: usize| people.iter().skip(parity).step_by(2).flatten().copied().collect::<Pairs>();
    let halves = [half(0), half(1)];
    let errors = [0, 1].map(|own: usize| cost(&fit(stem, &halves[1 - own]), &halves[own]));
    f64::midpoint(errors[0], errors[1])
}

const HALVINGS: usize = 9;
const MOST_ROUNDS: usize = 60;

/// Searches by coordinates for the point at which `cost` is lowest: from `start`, each coordinate goes up or down by its step
/// as long as that lowers the cost, and then the steps are halved.
fn minimum<const N: usize>(start: [f64; N], mut steps: [f64; N], cost: impl Fn(&[f64; N]) -> f64) -> ([f64; N], f64) {
    let mut best = (start, cost(&start));
    for _ in 0..HALVINGS {
        for _ in 0..MOST_ROUNDS {
            if !improve(&mut best, &steps, &cost) {
                break;
            }
        }
        steps = steps.map(|step| step / 2.0);
    }
    best
}

/// Tries a step up and a step down along each coordinate. Returns whether one was taken.
fn improve<const N: usize>(best: &mut ([f64; N], f64), steps: &[f64; N], cost: &impl Fn(&[f64; N]) -> f64) -> bool {
    let mut is_better = false;
    for (coordinate, step) in steps.iter().enumerate() {
        for signed in [*step, -step] {
            let mut point = best.0;
            point[coordinate] += signed;
            let found = cost(&point);
            if found < best.1 {
                (*best, is_better) = ((point, found), true);
            }
        }
    }
    is_better
}
